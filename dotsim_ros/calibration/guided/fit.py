# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From photographs of a ball of known diameter to a sensor's file: scale, gel's shape, shading.

What photographs of a ball alone identify is the image: how the colour of the gel answers its slope,
at each place. The slope comes from this package's pad, pressed as deep as makes the circle that was
found. Force, stiffness, friction and time leave no trace in them, and a shape that does not depend
on stiffness cannot tell it; the scale must be given, or is bounded by the ball.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from dotsim_ros.calibration.calibrate import report_folder
from dotsim_ros.calibration.guided.photographs import GuidedPhotographs, read_guided_photographs
from dotsim_ros.geometry.camera import Camera, PinholeCamera
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.files import check_output_file, check_output_folder, write_image
from dotsim_ros.io.provenance import provenance
from dotsim_ros.learning.export import write_network
from dotsim_ros.learning.fitting import CPU_WIDTH, FittedNetwork
from dotsim_ros.learning.neighbourhood import KIND, NeighbourhoodRecipe, fit_neighbourhood
from dotsim_ros.specification import (
    CameraSpecification,
    GelSpecification,
    LightingSpecification,
    SensorSpecification,
    SolverSpecification,
    write_sensor,
)
from dotsim_ros.twin.ball_presses import (
    CAMERA_DISTANCE_M,
    UNCHANGING,
    flat_scene,
    gel_presses,
    press_profiles,
)
from dotsim_ros.twin.image_metrics import image_psnr_db

PAD_THICKNESS_M = 4.0e-3
"""Of a pad whose size is not given, as a GelSight Mini's."""
PAD_MARGIN_M = 1.0e-3
"""By which such a pad is wider than what the camera sees, all around."""
SKIN_SPACING_M, GRID_SPACING_M = 0.25e-3, 1.0e-3
"""Of the pad whose shape is laid under the photographs."""
COARSE_SPACING_M, COARSE_GRID_M = 0.5e-3, 2.0e-3
"""Of the sensor that is written, which runs in real time."""
ASSUMED_SHARE = 0.9
"""Radius of the widest circle over the ball's, where the scale is not given."""
LEAST_SHARE = 0.5
"""A press whose widest circle is narrower than this share of the ball is hardly a press."""
BEYOND = 1.05
"""A circle so many times wider than that of the deepest press is not a press of the pad; a rim is
found to some hundredths of its radius."""
EVERY = 4
"""Every fourth photograph is judged on."""


@dataclass(frozen=True)
class GuidedRequest:
    """What is asked.

    Attributes:
        folder: of the photographs.
        out: sensor's file to write, .yaml.
        ball_diameter_m: of the ball.
        pixels_per_metre: of the flat gel; None where it was not measured.
        pad_size_m: lengths along the image's x and y, and thickness; None where they are unknown.
        name: of the sensor; None for the file's stem.
        seed: of the training.
        recipe: of the training.

    Raises:
        ValueError: a length out of range.
    """

    folder: Path
    out: Path
    ball_diameter_m: float
    pixels_per_metre: float | None = None
    pad_size_m: tuple[float, float, float] | None = None
    name: str | None = None
    seed: int = 0
    recipe: NeighbourhoodRecipe = field(default_factory=NeighbourhoodRecipe)

    def __post_init__(self) -> None:
        if self.out.suffix not in (".yaml", ".yml"):
            raise ValueError(f"out is {self.out}, expected a file that ends in .yaml")
        if not 0.5e-3 <= self.ball_diameter_m <= 0.05:
            raise ValueError(
                f"the ball's diameter is {1e3 * self.ball_diameter_m:g} mm, expected 0.5 to 50 mm; "
                "give it in millimetres"
            )
        scale = self.pixels_per_metre
        if scale is not None and not 1e3 <= scale <= 1e6:
            raise ValueError(
                f"the scale is {scale / 1e3:g} pixels a millimetre, expected 1 to 1000: the pixels "
                "that a millimetre of the gel has, not the millimetres of a pixel"
            )


@dataclass(frozen=True)
class GuidedScale:
    """How large a pixel is, and how that is known.

    Attributes:
        pixels_per_metre: taken.
        measured: whether it was given, or is assumed.
        bounds: (least, most) that the circles and the ball allow.
    """

    pixels_per_metre: float
    measured: bool
    bounds: tuple[float, float]


@dataclass(frozen=True)
class GuidedCalibration:
    """What was found.

    Attributes:
        photographs: the presses, and what was left out.
        scale: of the image.
        sensor: as written.
        fitted_on, judged_on: names of photographs.
        psnr_db: of the sensor's images on those judged, `frame` and `contact`.
        idle_psnr_db: of the idle photograph on them, the floor.
        predicted: images (H, W, 3) by the names of those judged.
        origin: of the figures.
        too_wide: names of photographs whose circle is wider than the pad can be pressed to, and
            that are taken for its deepest press.
    """

    photographs: GuidedPhotographs
    scale: GuidedScale
    sensor: SensorSpecification
    fitted_on: tuple[str, ...]
    judged_on: tuple[str, ...]
    psnr_db: Mapping[str, float]
    idle_psnr_db: Mapping[str, float]
    predicted: Mapping[str, ImageArray]
    origin: Mapping[str, str]
    too_wide: tuple[str, ...] = ()


def scale_of(
    photographs: GuidedPhotographs, ball_radius_m: float, given: float | None
) -> GuidedScale:
    """Return the scale that was given, or one that the circles allow.

    No circle of contact is wider than the ball: the widest one bounds the scale from below. From
    above it is bounded by the assumption that the deepest press was one.

    Raises:
        ValueError: a circle is wider than the ball at the scale given.
    """
    widest = max(photographs.presses, key=lambda press: press.radius_px)
    bounds = (widest.radius_px / ball_radius_m, widest.radius_px / (LEAST_SHARE * ball_radius_m))
    if given is None:
        return GuidedScale(bounds[0] / ASSUMED_SHARE, False, bounds)
    # A rim is found to some hundredths of its radius.
    if given < 0.85 * bounds[0]:
        raise ValueError(
            f"at {given / 1e3:.2f} pixels a millimetre the circle of {widest.name} is "
            f"{2e3 * widest.radius_px / given:.2f} mm wide, more than the ball of "
            f"{2e3 * ball_radius_m:.2f} mm; check the ball's diameter and the scale"
        )
    return GuidedScale(given, True, bounds)


def guided_sensor(
    request: GuidedRequest, photographs: GuidedPhotographs, scale: GuidedScale
) -> SensorSpecification:
    """Return the sensor of the photographs: a flat pad, and a camera that looks straight at it.

    Raises:
        ValueError: a pad smaller than the image, or out of a sensor's ranges.
    """
    height, width = photographs.idle.shape[:2]
    seen = np.array([width, height]) / scale.pixels_per_metre + 2.0 * PAD_MARGIN_M
    pad = request.pad_size_m or (float(seen[0]), float(seen[1]), PAD_THICKNESS_M)
    focal_px = scale.pixels_per_metre * CAMERA_DISTANCE_M
    folder = report_folder(request.out).resolve()
    return SensorSpecification(
        name=request.name or request.out.stem,
        gel=GelSpecification(shape="flat_pad", pad_size_m=pad, skin_spacing_m=COARSE_SPACING_M),
        solver=SolverSpecification(grid_spacing_m=min(COARSE_GRID_M, 0.5 * pad[2])),
        camera=CameraSpecification(
            width=width,
            height=height,
            position_m=(0.0, 0.0, pad[2] - CAMERA_DISTANCE_M),
            projection=PinholeCamera.projection,
            half_height_angle_deg=float(np.degrees(np.arctan(0.5 * height / focal_px))),
            principal_point_px=(0.5 * (width - 1), 0.5 * (height - 1)),
            idle_image=str(folder / "idle.png"),
            residual=str(folder / "network"),
        ),
        # The network alone shades.
        lighting=LightingSpecification(ambient_fraction=UNCHANGING.ambient_fraction),
    )


def network_width_px(camera: Camera) -> int:
    """Return the width of the network's images: the largest that networks take up to the camera's.

    Raises:
        ValueError: there is none; photographs of another size have one.
    """
    for width in range(min(camera.width, CPU_WIDTH[KIND]) // 16 * 16, 63, -16):
        if round(camera.height * width / camera.width) % 8 == 0:
            return width
    raise ValueError(
        f"the photographs are {camera.width}x{camera.height}, from which no network's images can "
        "be made; crop them all alike to a width that is a multiple of 16, from 64 on, and a "
        "height that is a multiple of 8"
    )


def calibrate_guided(
    request: GuidedRequest, progress: Callable[[str], None] = lambda _line: None
) -> GuidedCalibration:
    """Write the sensor of a folder of photographs, its idle image and its network.

    The sensor's file is written last: what it names is there when it is.

    Args:
        request: what is asked.
        progress: called with a line that says what was found.

    Raises:
        FileNotFoundError, ValueError: as `read_guided_photographs`, `scale_of`, `guided_sensor`,
            `network_width_px` and `press_profiles`, before anything is written.
        OSError: the files cannot be written, before anything is fitted.
    """
    check_output_file(request.out)
    check_output_folder(report_folder(request.out))
    photographs = read_guided_photographs(request.folder)
    told = "by its name" if photographs.idle_was_named else "the one with the least contrast"
    progress(f"idle photograph: {photographs.idle_name} ({told})")
    radii = [press.radius_px for press in photographs.presses]
    progress(
        f"{len(radii)} photographs show one ball, in circles of {min(radii):.0f} to "
        f"{max(radii):.0f} pixels radius"
    )
    for reason in photographs.left_out.values():
        progress(f"left out: {reason}")
    ball_radius_m = 0.5 * request.ball_diameter_m
    scale = scale_of(photographs, ball_radius_m, request.pixels_per_metre)
    least, most = (1e-3 * bound for bound in scale.bounds)
    progress(
        f"scale: {1e-3 * scale.pixels_per_metre:.2f} pixels a millimetre "
        f"({'as given' if scale.measured else 'assumed'}; the ball allows {least:.2f} to "
        f"{most:.2f})"
    )
    sensor = guided_sensor(request, photographs, scale)
    camera = Camera.from_specification(sensor.camera)
    size = network_width_px(camera)
    progress("pressing the ball into a pad, and fitting what its slopes do to the colour")
    fine = replace(
        sensor,
        gel=replace(sensor.gel, skin_spacing_m=SKIN_SPACING_M),
        solver=replace(
            sensor.solver,
            grid_spacing_m=min(GRID_SPACING_M, sensor.solver.grid_spacing_m),
            refined=False,
        ),
    )
    scene = flat_scene(photographs.idle, fine, scale.pixels_per_metre)
    presses = photographs.presses
    profiles = press_profiles(fine, ball_radius_m, max(radii) / scale.pixels_per_metre)
    deepest_px = float(profiles.contact_radius_m[-1]) * scale.pixels_per_metre
    too_wide = tuple(press.name for press in presses if press.radius_px > BEYOND * deepest_px)
    if too_wide:
        progress(
            f"{len(too_wide)} photographs show circles of more than {deepest_px:.0f} pixels "
            f"radius, that of the deepest press of a pad {1e3 * sensor.gel.pad_size_m[2]:g} mm "
            "thick, and are taken for that press; check the pad's thickness, or press less deep"
        )
    shapes = gel_presses(presses, scene, profiles)
    judged = range(EVERY - 1, len(presses), EVERY)
    network = fit_neighbourhood(
        [shape for k, shape in enumerate(shapes) if k not in judged],
        scene.rest,
        camera,
        seed=request.seed,
        size=size,
        recipe=request.recipe,
    )
    predicted = {presses[k].name: network.predict(shapes[k], scene.rest)[0] for k in judged}
    idle = dict.fromkeys(predicted, photographs.idle)
    found = GuidedCalibration(
        photographs,
        scale,
        sensor,
        tuple(press.name for k, press in enumerate(presses) if k not in judged),
        tuple(predicted),
        _psnr(photographs, predicted),
        _psnr(photographs, idle),
        predicted,
        provenance(),
        too_wide,
    )
    _write(request, found, network)
    return found


def _psnr(photographs: GuidedPhotographs, images: Mapping[str, ImageArray]) -> dict[str, float]:
    frame, contact = [], []
    for press in photographs.presses:
        if press.name in images:
            near, image = press.near_contact(), images[press.name]
            frame.append(image_psnr_db(image, press.image))
            contact.append(image_psnr_db(image[near], press.image[near]))
    return {"frame": float(np.mean(frame)), "contact": float(np.mean(contact))}


def _write(request: GuidedRequest, found: GuidedCalibration, network: FittedNetwork) -> None:
    folder = report_folder(request.out)
    folder.mkdir(parents=True, exist_ok=True)
    write_image(folder / "idle.png", found.photographs.idle)
    data = {
        "name": request.folder.resolve().name,
        "train": list(found.fitted_on),
        "held_out": list(found.judged_on),
        "seed": request.seed,
    }
    card = replace(
        network.card(found.sensor.name),
        data=data,
        commit=found.origin["commit"],
        date=found.origin["date"],
        command=found.origin["command"],
        metrics={f"{region}_psnr_db": level for region, level in found.psnr_db.items()},
    )
    write_network(folder / "network", network.trained.network, card)
    held = "given" if found.scale.measured else "assumed"
    write_sensor(
        request.out,
        found.sensor,
        f"From {len(found.fitted_on)} photographs of a ball of "
        f"{1e3 * request.ball_diameter_m:g} mm, by dotsim_ros calibrate --guided.\n"
        f"The scale is {held}. Not told by photographs: the material, the contact, the thickness.",
    )
