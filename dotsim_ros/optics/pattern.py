# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Idle frames for sensors without a photograph: a random pattern on the gel, lit by the LEDs.

    python -m dotsim_ros.optics.pattern params/images/densetact2_idle.png

writes the image that `params/sensors/densetact2.yaml` names, the same for one seed. LEDs and
vignetting are those of the YAML file next to the image, which the shading uses later; without one
they are the sensor's own, and are written next to it.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import cv2
import numpy as np
import yaml
from scipy import ndimage

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.pad_face import face_normal, meet_face
from dotsim_ros.io.arrays import BoolArray, FloatArray, ImageArray
from dotsim_ros.io.files import given_path, write_image, write_text
from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.optics.idle import IdleFrame, lights_of, read_description, read_idle_frame
from dotsim_ros.optics.image import direct_light, leds_of
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.specification import (
    GelSpecification,
    MarkerSpecification,
    PatternSpecification,
    SensorSpecification,
    load_sensor,
)
from dotsim_ros.specification.sensor import GRAIN_SHARE, check_drawable

SUPERSAMPLING = 3
"""Rays a pixel along each axis."""
CLUSTER_BLOTCHES = 4.0
"""Size of the clusters of blotches, in blotches."""


def _smooth_noise(
    points_m: FloatArray, extent_m: float, size_m: float, random: np.random.Generator
) -> FloatArray:
    """Return noise of unit variance at points (N, 3) or (N, 2), with features of a size."""
    count = int(np.ceil(2.0 * extent_m / size_m)) + 4
    block = random.standard_normal((count,) * points_m.shape[1])
    block = ndimage.gaussian_filter(block, 0.9)
    block /= block.std()
    index = (points_m + extent_m) / size_m + 2.0
    return np.asarray(ndimage.map_coordinates(block, index.T, order=3, mode="nearest"))


def _albedo(
    points_m: FloatArray,
    extent_m: float,
    pattern: PatternSpecification,
    random: np.random.Generator,
) -> FloatArray:
    blotches = _smooth_noise(points_m, extent_m, pattern.blotch_m, random)
    clusters = _smooth_noise(points_m, extent_m, CLUSTER_BLOTCHES * pattern.blotch_m, random)
    field = blotches + 0.35 * clusters
    edge = np.quantile(field, pattern.dark_share)
    coat = 1.0 - pattern.contrast / (1.0 + np.exp((field - edge) / 0.2))
    grain = _smooth_noise(points_m, extent_m, GRAIN_SHARE * pattern.blotch_m, random)
    return np.clip(coat * (1.0 + pattern.grain * grain), 0.0, None)


def _seen_skin(
    gel: GelSpecification, origin: FloatArray, rays: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return where rays (..., 3) from behind the skin meet it, and which (...,) do."""
    if gel.shape != "dome":
        return meet_face(origin, rays, gel.pad_size_m, gel.face_curvature_per_m)
    along = rays @ origin
    below = float(origin @ origin) - gel.outer_radius_m**2
    # A ray that meets no skin has no such place.
    with np.errstate(invalid="ignore"):
        depth = -along + np.sqrt(along**2 - below)
    points = origin + depth[..., None] * rays
    return points, points[..., 2] >= 0.0


def _on_marker(points_m: FloatArray, markers: MarkerSpecification) -> BoolArray:
    """Return which of points (N, 3) of the skin lie on a printed marker."""
    distance = np.zeros(len(points_m))
    for axis, (spacing, count) in enumerate(
        zip(markers.spacing_m, (markers.columns, markers.rows), strict=True)
    ):
        number = points_m[:, axis] / spacing + 0.5 * (count - 1)
        nearest = np.clip(np.rint(number), 0, count - 1)
        distance = np.hypot(distance, spacing * (number - nearest))
    return np.asarray(distance <= markers.radius_m)


def render_idle_image(
    camera: Camera,
    gel: GelSpecification,
    *,
    lighting: Lighting,
    vignetting: Vignetting,
    pattern: PatternSpecification,
    markers: MarkerSpecification | None = None,
    supersampling: int = SUPERSAMPLING,
) -> ImageArray:
    """Return (H, W, 3) uint8: a gel painted with a random pattern and lit by the LEDs.

    Args:
        camera: that sees it.
        gel: its shape.
        lighting: the LEDs.
        vignetting: of the camera.
        pattern: of the coat.
        markers: printed on it; None for none.
        supersampling: rays a pixel along each axis.

    Raises:
        ValueError: the camera is in front of the skin or sees none of it, or the pattern is too
            fine to be drawn.
    """
    origin = camera.pose.position_m
    if not gel.has_behind(origin):
        raise ValueError(
            f"the camera at {origin.tolist()} m is outside of the gel, in front of its skin; "
            "expected a place behind the skin"
        )
    check_drawable(gel, pattern)
    random = np.random.default_rng(pattern.seed)
    fine = camera.scaled(camera.width * supersampling, camera.height * supersampling)
    optical_rays, imaged = fine.rays()
    points, on_skin = _seen_skin(gel, origin, optical_rays @ camera.pose.rotation().T)
    rim = np.radians(pattern.rim_angle_deg)
    angle = np.arccos(np.clip(optical_rays[..., 2], -1.0, 1.0))
    # The lens mount shades the rim over half a degree.
    open_share = np.clip((rim - angle) / np.radians(0.5) + 0.5, 0.0, 1.0)
    lit = imaged & on_skin & (open_share > 0.0)
    if not lit.any():
        raise ValueError(
            f"the camera at {origin.tolist()} m sees nothing of the gel; turn it towards the skin"
        )

    seen = points[lit]
    is_dome = gel.shape == "dome"
    if is_dome:
        normal = seen / gel.outer_radius_m
    else:
        normal = face_normal(seen[:, 0], seen[:, 1], gel.face_curvature_per_m)
    device = wp.get_device("cpu")
    light = direct_light(
        wp.array(camera.to_optical(seen).astype(np.float32), dtype=wp.vec3, device=device),
        wp.array(
            (normal @ camera.pose.rotation()).astype(np.float32), dtype=wp.vec3, device=device
        ),
        leds_of(lighting, camera, device),
        lighting,
    ).numpy()
    light = light + lighting.ambient_fraction * light.mean(axis=0)
    mean = light.mean(axis=0)
    if not (np.all(np.isfinite(light)) and np.all(mean > 0.0)):
        raise ValueError(
            "the LEDs do not light the skin from behind in all three colours; lower "
            "lighting.height_m, or give the LEDs some crosstalk"
        )
    # Each colour of LED is driven to the same brightness.
    light = (light / mean) ** lighting.exponent
    albedo = _albedo(seen if is_dome else seen[:, :2], gel.extent_m, pattern, random)
    if markers is not None and markers.columns:
        albedo = albedo * (1.0 - markers.darkness * _on_marker(seen, markers))
    radiance = np.zeros((*on_skin.shape, 3))
    radiance[lit] = (albedo * open_share[lit])[:, None] * light
    radiance = (
        cv2.resize(radiance, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        * vignetting.brightness(camera)[..., None]
    )
    radiance = cv2.GaussianBlur(radiance, (0, 0), 0.6)
    brightest = radiance.max(axis=2)
    # A gel that fills less than a hundredth of the image is not to be blown out.
    levels = 225.0 * radiance / (np.quantile(brightest, 0.99) or brightest.max())
    # Highlights roll off instead of clipping, as on a sensor with a knee in its response.
    levels = np.where(levels > 180.0, 180.0 + 75.0 * np.tanh((levels - 180.0) / 75.0), levels)
    levels += pattern.noise_levels * random.standard_normal(levels.shape) * (levels > 0.5)
    return np.clip(np.rint(levels), 0.0, 255.0).astype(np.uint8)


def idle_frame_of(sensor: SensorSpecification, camera: Camera) -> IdleFrame:
    """Return a sensor's idle frame in a camera: read from the file that it names, or drawn where it
    names none; grey where the camera is.

    Args:
        sensor: the sensor.
        camera: its own, or one of another size or direction at the same place.

    Raises:
        FileNotFoundError: no such image.
        ValueError: as `read_idle_frame` and `render_idle_image`.
    """
    lighting, vignetting = lights_of(sensor)
    if sensor.camera.idle_image:
        path = given_path(sensor.camera.idle_image)
        frame = read_idle_frame(path, camera, lighting=lighting, vignetting=vignetting)
        return frame if sensor.camera.colour != "grey" else frame.as_grey()
    image = render_idle_image(
        camera,
        sensor.gel,
        lighting=lighting,
        vignetting=vignetting,
        pattern=sensor.pattern,
        markers=sensor.markers,
    )
    frame = IdleFrame(image, lighting, vignetting)
    return frame if sensor.camera.colour != "grey" else frame.as_grey()


def _describe(sensor: SensorSpecification, path: Path) -> None:
    """Write a sensor's own lights and vignetting next to an image that is drawn with them."""
    sections = {
        "lighting": dataclasses.asdict(sensor.lighting),
        "vignetting": dataclasses.asdict(sensor.vignetting),
    }
    head = f"# LEDs, coat and vignetting that {path.with_suffix('.png').name} was drawn with.\n"
    write_text(path, head + yaml.safe_dump(sections, sort_keys=False))


def main() -> None:
    """Render the idle frame of a sensor's file."""
    parser = argparse.ArgumentParser(
        description="Render an idle frame for a sensor without a photograph.",
        epilog="example: python -m dotsim_ros.optics.pattern params/images/densetact2_idle.png",
    )
    parser.add_argument("out", type=Path, help="PNG file to write")
    parser.add_argument("--sensor", default="densetact2", help="name or YAML file of the sensor")
    parser.add_argument(
        "--seed", type=int, help="of pattern and noise, in place of the sensor's pattern.seed"
    )
    arguments = parser.parse_args()
    sensor = load_sensor(arguments.sensor)
    pattern = sensor.pattern
    if arguments.seed is not None:
        pattern = dataclasses.replace(pattern, seed=arguments.seed)
    description = arguments.out.with_suffix(".yaml")
    if not description.exists():
        _describe(sensor, description)
    lighting, vignetting = read_description(description).lights()
    image = render_idle_image(
        Camera.from_specification(sensor.camera),
        sensor.gel,
        lighting=lighting,
        vignetting=vignetting,
        pattern=pattern,
        markers=sensor.markers,
    )
    if sensor.camera.colour == "grey":
        image = IdleFrame(image, lighting, vignetting).as_grey().image
    write_image(arguments.out, image)


if __name__ == "__main__":
    main()
