"""Renders an idle frame for a sensor without a photograph: a DenseTact's random pattern on a dome.

    python -m dotsim_ros.optics.pattern params/images/densetact2_idle.png

writes the image that `params/sensors/densetact2.yaml` names, the same for one seed. LEDs and
vignetting are those of the YAML file beside the image, which the shading uses later.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import warp as wp
from scipy import ndimage

from dotsim_ros.arrays import FloatArray, ImageArray
from dotsim_ros.files import write_image
from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.optics.idle import read_description
from dotsim_ros.optics.image import direct_light, leds_of
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.specification import load_sensor


@dataclass(frozen=True)
class PatternStyle:
    """How the dome's coat and the camera look.

    Attributes:
        blotch_m: size of the dark blotches.
        dark_share: part of the coat that is dark.
        contrast: how much darker a blotch is than the coat, 0 to 1.
        grain: standard deviation of the coat's fine texture, relative.
        rim_angle_deg: angle from the axis where the lit disc ends.
        noise_levels: standard deviation of the camera's noise, grey levels of 255.
        supersampling: rays a pixel along each axis.
    """

    blotch_m: float = 0.00022
    dark_share: float = 0.45
    contrast: float = 0.45
    grain: float = 0.06
    rim_angle_deg: float = 92.0
    noise_levels: float = 1.0
    supersampling: int = 3


def _smooth_noise(
    points_m: FloatArray, extent_m: float, size_m: float, random: np.random.Generator
) -> FloatArray:
    """Return noise of unit variance at points (N, 3), with features of a size."""
    count = int(np.ceil(2.0 * extent_m / size_m)) + 4
    volume = ndimage.gaussian_filter(random.standard_normal((count, count, count)), 0.9)
    volume /= volume.std()
    index = (points_m + extent_m) / size_m + 2.0
    return np.asarray(ndimage.map_coordinates(volume, index.T, order=3, mode="nearest"))


def _albedo(
    points_m: FloatArray, radius_m: float, style: PatternStyle, random: np.random.Generator
) -> FloatArray:
    blotches = _smooth_noise(points_m, radius_m, style.blotch_m, random)
    clusters = _smooth_noise(points_m, radius_m, 4.0 * style.blotch_m, random)
    field = blotches + 0.35 * clusters
    edge = np.quantile(field, style.dark_share)
    coat = 1.0 - style.contrast / (1.0 + np.exp((field - edge) / 0.2))
    grain = _smooth_noise(points_m, radius_m, 0.6 * style.blotch_m, random)
    return np.clip(coat * (1.0 + style.grain * grain), 0.0, None)


def render_idle_image(
    camera: FisheyeCamera,
    radius_m: float,
    *,
    lighting: Lighting,
    vignetting: Vignetting,
    style: PatternStyle,
    seed: int,
) -> ImageArray:
    """Return (H, W, 3) uint8: a dome of this radius, its centre at the base frame's origin, painted
    with a random pattern and lit by the LEDs.

    Raises:
        ValueError: the camera is not inside the dome.
    """
    random = np.random.default_rng(seed)
    origin = camera.pose.position_m
    depth_of_centre = float(origin @ origin) - radius_m**2
    if depth_of_centre >= 0.0:
        raise ValueError(
            f"the camera at {origin.tolist()} m is outside of the dome of {radius_m} m radius"
        )
    fine = camera.scaled(camera.width * style.supersampling, camera.height * style.supersampling)
    optical_rays, imaged = fine.rays()
    rays = optical_rays @ camera.pose.rotation().T
    along = rays @ origin
    depth = -along + np.sqrt(along**2 - depth_of_centre)
    points = origin + depth[..., None] * rays
    rim = np.radians(style.rim_angle_deg)
    angle = np.arccos(np.clip(optical_rays[..., 2], -1.0, 1.0))
    # The lens mount shades the rim over half a degree.
    open_share = np.clip((rim - angle) / np.radians(0.5) + 0.5, 0.0, 1.0)
    lit = imaged & (points[..., 2] >= 0.0) & (open_share > 0.0)

    seen = points[lit]
    device = wp.get_device("cpu")
    light = direct_light(
        wp.array(camera.to_optical(seen).astype(np.float32), dtype=wp.vec3, device=device),
        wp.array(
            (seen / radius_m @ camera.pose.rotation()).astype(np.float32),
            dtype=wp.vec3,
            device=device,
        ),
        leds_of(lighting, camera, device),
        lighting,
    ).numpy()
    light = light + lighting.ambient_fraction * light.mean(axis=0)
    # Each colour of LED is driven to the same brightness.
    light = (light / light.mean(axis=0)) ** lighting.exponent
    radiance = np.zeros((*depth.shape, 3))
    radiance[lit] = (_albedo(seen, radius_m, style, random) * open_share[lit])[:, None] * light
    radiance = (
        cv2.resize(radiance, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        * vignetting.brightness(camera)[..., None]
    )
    radiance = cv2.GaussianBlur(radiance, (0, 0), 0.6)
    levels = 225.0 * radiance / np.quantile(radiance.max(axis=2), 0.99)
    # Highlights roll off instead of clipping, as on a sensor with a knee in its response.
    levels = np.where(levels > 180.0, 180.0 + 75.0 * np.tanh((levels - 180.0) / 75.0), levels)
    levels += style.noise_levels * random.standard_normal(levels.shape) * (levels > 0.5)
    return np.clip(np.rint(levels), 0.0, 255.0).astype(np.uint8)


def main() -> None:
    """Render the idle frame of a sensor's file."""
    parser = argparse.ArgumentParser(
        description="Render an idle frame for a dome without a photograph.",
        epilog="example: python -m dotsim_ros.optics.pattern params/images/densetact2_idle.png",
    )
    parser.add_argument("out", type=Path, help="PNG file to write")
    parser.add_argument("--sensor", default="densetact2", help="name or YAML file of the sensor")
    parser.add_argument("--seed", type=int, default=0, help="of pattern and noise")
    arguments = parser.parse_args()
    sensor = load_sensor(arguments.sensor)
    description = arguments.out.with_suffix(".yaml")
    lighting, vignetting = Lighting(), Vignetting()
    if description.exists():
        _, lighting, vignetting = read_description(description)
    image = render_idle_image(
        FisheyeCamera.from_specification(sensor.camera),
        sensor.gel.outer_radius_m,
        lighting=lighting,
        vignetting=vignetting,
        style=PatternStyle(),
        seed=arguments.seed,
    )
    write_image(arguments.out, image)


if __name__ == "__main__":
    main()
