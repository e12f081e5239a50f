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


def _number(
    name: str,
    part: str,
    field: str,
    step: float,
    prior: float,
    *,
    index: int | None = None,
    is_factor: bool = False,
    at_reference: bool = False,
) -> CameraParameter:
    """Return a number of the camera or the lights, or an entry of a list of them.

    Args:
        name, step, prior: as `CameraParameter`.
        part: "camera" or "lights".
        field: of the part.
        index: of the entry; None for a field that is a number, which among the lights is kept
            within what a sensor's file takes.
        is_factor: whether its logarithm is moved.
        at_reference: whether it is moved by pixels of `REFERENCE_HEIGHT_PX`.
    """

    def value(model: CameraModel) -> float:
        found = getattr(getattr(model, part), field)
        return float(found if index is None else found[index])

    def move(model: CameraModel, amount: float) -> CameraModel:
        if at_reference:
            amount = amount * model.camera.height / REFERENCE_HEIGHT_PX
        before = value(model)
        after: Any = before * float(np.exp(amount)) if is_factor else before + amount
        if index is not None:
            entries = list(getattr(getattr(model, part), field))
            entries[index] = after
            after = np.array(entries) if part == "camera" else tuple(entries)
        elif part == "lights":
            known = quantities_of(LightingSpecification)[field][1]
            after = min(max(after, known.low), known.high)
        return replace(model, **{part: replace(getattr(model, part), **{field: after})})

    return CameraParameter(name, step, prior, move, value)


def _posed(model: CameraModel, pose: Pose) -> CameraModel:
    return replace(model, camera=replace(model.camera, pose=pose))


def _turn(name: str, axis: int, prior_rad: float) -> CameraParameter:
    """Return the angle about an axis of the camera's own optical frame."""

    def move(model: CameraModel, angle_rad: float) -> CameraModel:
        turn = np.zeros(4)
        turn[axis], turn[3] = np.sin(0.5 * angle_rad), np.cos(0.5 * angle_rad)
        before = model.camera.pose
        turned = quaternion_product(before.quaternion_xyzw, turn)
        return _posed(model, Pose(before.position_m, turned))

    return CameraParameter(
        name,
        0.004,
        prior_rad,
        move,
        lambda model: 2.0 * float(model.camera.pose.quaternion_xyzw[axis]),
    )


def _place(axis: int) -> CameraParameter:
    def move(model: CameraModel, amount: float) -> CameraModel:
        before = model.camera.pose
        place = before.position_m + amount * np.eye(3)[axis]
        return _posed(model, Pose(place, before.quaternion_xyzw))

    return CameraParameter(
        f"position_{'xyz'[axis]}_m",
        0.1e-3,
        0.2e-3,
        move,
        lambda model: float(model.camera.pose.position_m[axis]),
    )


def _with_falloff(model: CameraModel, amount: float) -> CameraModel:
    first, *others = model.falloff or (0.0,)
    # A lens loses light towards the edge, and not all of it within the image.
    return replace(model, falloff=(float(np.clip(first + amount, -0.6, 0.0)), *others))


LENS = (
    # A few pixels, as makers state.
    *(
        _number(name, "camera", "principal_point_px", 0.25, 3.0, index=index, at_reference=True)
        for index, name in enumerate(CENTRE_NAMES)
    ),
    _number("focal_px", "camera", "focal_px", 0.003, 0.01, is_factor=True),
    _number("k1", "camera", "distortion", 0.004, 0.03, index=0),
    _turn("tilt_x_rad", 0, 0.02),
    _turn("tilt_y_rad", 1, 0.02),
    _turn("roll_rad", 2, 0.005),
)
"""Where the camera looks, and how."""

POSITION = (_place(0), _place(1), _place(2))
"""Where the camera stands, which a few presses hardly identify."""

LIGHTS = (
    *(
        _number(name, "lights", name, step, prior, is_factor=is_factor)
        for name, step, prior, is_factor in (
            ("ambient_fraction", 0.1, 1.5, True),
            ("exponent", 0.1, 0.7, True),
            ("gloss", 0.3, 3.0, False),
            ("gloss_exponent", 0.1, 1.0, True),
            ("radius_m", 0.2e-3, 2.0e-3, False),
            ("height_m", 0.2e-3, 1.0e-3, False),
            ("spread_deg", 2.0, 20.0, False),
            ("crosstalk", 0.02, 0.1, False),
        )
    ),
    *(
        _number(f"azimuth_{colour}_deg", "lights", "azimuth_deg", 2.0, 10.0, index=index)
        for index, colour in enumerate(("red", "green", "blue"))
    ),
    CameraParameter(
        "falloff",
        0.05,
        0.2,
        _with_falloff,
        lambda model: model.falloff[0] if model.falloff else 0.0,
    ),
)
"""What the coat is lit by, and how the camera responds."""


def with_gloss(model: CameraModel) -> CameraModel:
    """Return the model with a gloss to start a fit from."""
    if model.lights.gloss > 0.0:
        return model
    return replace(model, lights=replace(model.lights, gloss=FIRST_GLOSS))
