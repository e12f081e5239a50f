# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera and its lights as numbers that a fit can change.

A parameter is a change of a given model, in a unit of its own and with a prior deviation: how far
a sensor may be from what its maker states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.pose import Pose, quaternion_product
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.quantity import quantities_of
from dotsim_ros.optics.idle import stated_lights
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.optics.renderer import View
from dotsim_ros.specification import (
    CameraSpecification,
    LightingSpecification,
    SensorSpecification,
    VignettingSpecification,
)
from dotsim_ros.twin.ball_presses import UNCHANGING
from dotsim_ros.twin.footage import FilmedData

REFERENCE_HEIGHT_PX = 240.0
"""Image height that parameters in pixels are stated for."""

RIM_MARGIN_PX = 9
"""What lies nearer to the rim of the lit disc is neither fitted nor judged."""

CENTRE_NAMES = ("centre_x_px", "centre_y_px")

FIRST_GLOSS = 1.0
"""Where a fit starts that is given a dull coat: without a gloss its exponent has no effect."""


@dataclass(frozen=True)
class CameraModel:
    """A camera, at the resolution of the images, with its lights.

    Attributes:
        camera: place, direction and lens.
        lights: the LEDs and the coat.
        falloff: of the vignetting.
    """

    camera: Camera
    lights: LightingSpecification
    falloff: tuple[float, ...] = ()

    def images(self, filmed: FilmedData, *, is_shaded: bool = True) -> ImageRenderer:
        """Return what warps an idle image by skins, with or without shading."""
        return ImageRenderer(
            self.camera,
            filmed.skin,
            filmed.idle,
            lighting=Lighting.from_specification(self.lights) if is_shaded else UNCHANGING,
            vignetting=Vignetting(self.falloff),
        )


def read_lights(sensor: SensorSpecification) -> tuple[LightingSpecification, tuple[float, ...]]:
    """Return a sensor's lights and falloff: of the file next to its idle image, or its own.

    Raises:
        FileNotFoundError: the sensor names an image that is not there.
        ValueError: the file describes no idle image.
    """
    lighting, vignetting = stated_lights(sensor)
    return lighting, vignetting.falloff


def seen_motion_px(view: View, rest: View, triangles: NDArray[np.int32]) -> FloatArray:
    """Return how far (H, W) the skin that each pixel of a view shows has moved in the image."""
    motion = np.linalg.norm(view.vertex_pixel - rest.vertex_pixel, axis=1)
    return np.asarray(motion[triangles[np.maximum(view.triangle, 0)]].mean(axis=-1))


def describe_lights(model: CameraModel) -> dict[str, dict[str, Any]]:
    """Return the sections of the file next to an idle image.

    Raises:
        ValueError: a number is out of the range that such a file takes.
    """
    sections: dict[str, dict[str, Any]] = {
        "lighting": {name: _plain(value) for name, value in asdict(model.lights).items()}
    }
    if model.falloff:
        sections["vignetting"] = {"falloff": _plain(model.falloff)}
        VignettingSpecification(**sections["vignetting"])
    return sections


def _plain(value: float | tuple[float, ...]) -> float | list[float]:
    return [round(v, 6) for v in value] if isinstance(value, tuple) else round(value, 6)


def camera_section(
    model: CameraModel, stated: CameraSpecification, idle_image: str
) -> CameraSpecification:
    """Return the section of a sensor's file, at the size that it states.

    Args:
        model: the camera at the images' resolution.
        stated: the section before.
        idle_image: file of the idle image, as the section names it.

    Raises:
        ValueError: the size has another aspect ratio than the model's, or a number is out of the
            section's range.
    """
    camera = model.camera.scaled(stated.width, stated.height)
    x, y = (round(float(v), 3) for v in camera.principal_point_px)
    k1, k2, k3, k4 = (round(float(v), 6) for v in camera.distortion)
    px, py, pz = (round(float(v), 7) for v in camera.pose.position_m)
    qx, qy, qz, qw = (round(float(v), 8) for v in camera.pose.quaternion_xyzw)
    return replace(
        stated,
        projection=camera.projection,
        position_m=(px, py, pz),
        quaternion_xyzw=(qx, qy, qz, qw),
        half_height_angle_deg=round(float(np.degrees(camera.half_height_angle_rad)), 5),
        principal_point_px=(x, y),
        distortion=(k1, k2, k3, k4),
        idle_image=idle_image,
        # A network that was trained with the camera before would be refused.
        residual="",
    )


@dataclass(frozen=True)
class CameraParameter:
    """One number of the model.

    Attributes:
        name: how reports call it.
        step: change that differences are taken with, and the unit of the fit.
        prior: standard deviation around the model that is given.
        moved: returns a model with the number moved by an amount.
        value: returns the number, as reports show it.
    """

    name: str
    step: float
    prior: float
    moved: Callable[[CameraModel, float], CameraModel]
    value: Callable[[CameraModel], float]


def moved(
    model: CameraModel, parameters: Sequence[CameraParameter], steps: FloatArray
) -> CameraModel:
    """Return a model with parameters (P,) moved by so many of their steps."""
    for parameter, count in zip(parameters, steps.tolist(), strict=True):
        model = parameter.moved(model, count * parameter.step)
    return model


def _with_camera(model: CameraModel, **changes: Any) -> CameraModel:
    return replace(model, camera=replace(model.camera, **changes))


def _camera_entry(
    name: str, field: str, index: int, step: float, prior: float, *, at_reference: bool = False
) -> CameraParameter:
    """Return an entry of a list of the camera, moved by pixels of `REFERENCE_HEIGHT_PX` or as it
    is."""

    def move(model: CameraModel, amount: float) -> CameraModel:
        entries = np.array(getattr(model.camera, field))
        entries[index] += (
            amount * model.camera.height / REFERENCE_HEIGHT_PX if at_reference else amount
        )
        return _with_camera(model, **{field: entries})

    return CameraParameter(
        name, step, prior, move, lambda model: float(getattr(model.camera, field)[index])
    )


def _turned(model: CameraModel, axis: int, angle_rad: float) -> CameraModel:
    """Return the model turned about an axis of its own optical frame."""
    turn = np.zeros(4)
    turn[axis], turn[3] = np.sin(0.5 * angle_rad), np.cos(0.5 * angle_rad)
    before = model.camera.pose
    turned = Pose(before.position_m, quaternion_product(before.quaternion_xyzw, turn))
    return _with_camera(model, pose=turned)


def _turn(name: str, axis: int, prior_rad: float) -> CameraParameter:
    return CameraParameter(
        name,
        0.004,
        prior_rad,
        lambda model, amount: _turned(model, axis, amount),
        lambda model: 2.0 * float(model.camera.pose.quaternion_xyzw[axis]),
    )


def _place(axis: int) -> CameraParameter:
    def move(model: CameraModel, amount: float) -> CameraModel:
        place = np.array(model.camera.pose.position_m)
        place[axis] += amount
        return _with_camera(model, pose=Pose(place, model.camera.pose.quaternion_xyzw))

    return CameraParameter(
        f"position_{'xyz'[axis]}_m",
        0.1e-3,
        0.2e-3,
        move,
        lambda model: float(model.camera.pose.position_m[axis]),
    )


LENS = (
    # A few pixels, as makers state.
    _camera_entry(CENTRE_NAMES[0], "principal_point_px", 0, 0.25, 3.0, at_reference=True),
    _camera_entry(CENTRE_NAMES[1], "principal_point_px", 1, 0.25, 3.0, at_reference=True),
    CameraParameter(
        "focal_px",
        0.003,
        0.01,
        lambda model, amount: _with_camera(
            model, focal_px=model.camera.focal_px * float(np.exp(amount))
        ),
        lambda model: model.camera.focal_px,
    ),
    _camera_entry("k1", "distortion", 0, 0.004, 0.03),
    _turn("tilt_x_rad", 0, 0.02),
    _turn("tilt_y_rad", 1, 0.02),
    _turn("roll_rad", 2, 0.005),
)
"""Where the camera looks, and how; the focal length moves by its logarithm."""

POSITION = (_place(0), _place(1), _place(2))
"""Where the camera stands, which a few presses hardly identify."""


def _with_light(model: CameraModel, name: str, value: float) -> CameraModel:
    """Return the model with a number of its lights, kept within what a sensor's file takes."""
    known = quantities_of(LightingSpecification)[name][1]
    changes: dict[str, Any] = {name: min(max(value, known.low), known.high)}
    return replace(model, lights=replace(model.lights, **changes))


def _light(name: str, step: float, prior: float) -> CameraParameter:
    def move(model: CameraModel, amount: float) -> CameraModel:
        return _with_light(model, name, getattr(model.lights, name) + amount)

    return CameraParameter(
        name, step, prior, move, lambda model: float(getattr(model.lights, name))
    )


def _light_factor(name: str, prior: float) -> CameraParameter:
    def move(model: CameraModel, amount: float) -> CameraModel:
        return _with_light(model, name, getattr(model.lights, name) * float(np.exp(amount)))

    return replace(_light(name, 0.1, prior), moved=move)


def _azimuth(colour: int) -> CameraParameter:
    def move(model: CameraModel, amount: float) -> CameraModel:
        azimuth = list(model.lights.azimuth_deg)
        azimuth[colour] += amount
        red, green, blue = azimuth
        return replace(model, lights=replace(model.lights, azimuth_deg=(red, green, blue)))

    return CameraParameter(
        f"azimuth_{('red', 'green', 'blue')[colour]}_deg",
        2.0,
        10.0,
        move,
        lambda model: model.lights.azimuth_deg[colour],
    )


def _falloff() -> CameraParameter:
    def move(model: CameraModel, amount: float) -> CameraModel:
        first, *others = model.falloff or (0.0,)
        # A lens loses light towards the edge, and not all of it within the image.
        return replace(model, falloff=(float(np.clip(first + amount, -0.6, 0.0)), *others))

    return CameraParameter(
        "falloff", 0.05, 0.2, move, lambda model: model.falloff[0] if model.falloff else 0.0
    )


LIGHTS = (
    _light_factor("ambient_fraction", 1.5),
    _light_factor("exponent", 0.7),
    _light("gloss", 0.3, 3.0),
    _light_factor("gloss_exponent", 1.0),
    _light("radius_m", 0.2e-3, 2.0e-3),
    _light("height_m", 0.2e-3, 1.0e-3),
    _light("spread_deg", 2.0, 20.0),
    _light("crosstalk", 0.02, 0.1),
    _azimuth(0),
    _azimuth(1),
    _azimuth(2),
    _falloff(),
)
"""What the coat is lit by, and how the camera responds."""


def with_gloss(model: CameraModel) -> CameraModel:
    """Return the model with a gloss to start a fit from."""
    if model.lights.gloss > 0.0:
        return model
    return replace(model, lights=replace(model.lights, gloss=FIRST_GLOSS))
