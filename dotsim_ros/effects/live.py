# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects at work in a live sensor: its gel, and what goes in and comes out frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from dotsim_ros.effects.effect import (
    Active,
    GelTerm,
    Response,
    SeenImage,
    gel_with,
    image_filters,
    motion_filters,
    response_filters,
)
from dotsim_ros.gel.make import GelFrame
from dotsim_ros.gel.values import specification_with, values_of
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.io.arrays import Float32Array, FloatArray, ImageArray
from dotsim_ros.specification import SensorSpecification

NO_FORCE_N = 1e-9
"""A force below this has no direction."""


def specification_with_effects(
    specification: SensorSpecification, effects: Sequence[Active]
) -> SensorSpecification:
    """Return a sensor whose gel is what the effects make of it.

    Raises:
        ValueError: an effect acts on a gel that has another law than neo-Hooke's or Yeoh's, or
            gives it a value that it cannot have, or makes a pad thicker or thinner.
    """
    if not any(active.effect.gel for active in effects):
        return specification
    own = specification.material
    term = gel_with(
        effects, GelTerm(values_of(specification), own.prony_shares, own.prony_times_s), None
    )
    changed = specification_with(specification, term.values)
    if specification.gel.shape != "dome" and changed.gel != specification.gel:
        raise ValueError(
            "an effect changes the thickness of a pad; its base would come up and its face stay, "
            "which a sensor whose base is at z = 0 cannot show: set gel.pad_size_m in the sensor's "
            "file, whose face is then at another height"
        )
    material = replace(
        changed.material, prony_shares=term.prony_shares, prony_times_s=term.prony_times_s
    )
    return replace(changed, material=material)


def wrench_with_force(wrench: Wrench, force_n: FloatArray, tip_m: FloatArray) -> Wrench:
    """Return a wrench about the frame's origin with another force (3,).

    What of it lies along the force before acts where that did; the rest acts at the tip (3,).
    """
    before = wrench.force_n
    square = float(before @ before)
    share = float(force_n @ before) / square if square > NO_FORCE_N**2 else 0.0
    torque = share * wrench.torque_nm + np.cross(tip_m, force_n - share * before)
    return Wrench(force_n, torque)


class FilteredSensor(Protocol):
    """What the filters need of a live sensor, as `dotsim_ros.sensor.TactileSensor`."""

    @property
    def skin(self) -> SkinMesh:
        """The skin at rest."""

    @property
    def camera(self) -> Camera:
        """That the images are of."""

    @property
    def idle_image(self) -> ImageArray:
        """The image without contact, (H, W, 3) uint8."""

    def image_motion_px(self, before_m: FloatArray, after_m: FloatArray) -> FloatArray:
        """Return how far (H, W, 2) what each pixel shows has moved in the image, x then y."""


class FilteredFrame(Protocol):
    """What the filters of the image need of a rendered frame, as `dotsim_ros.sensor.Frame`."""

    @property
    def image(self) -> ImageArray:
        """Of the camera, (H, W, 3) uint8."""

    @property
    def skin_position_m(self) -> FloatArray:
        """The skin (V, 3), base frame."""

    @property
    def depth_m(self) -> Float32Array:
        """Distance (H, W) along the ray, NaN where no skin is seen."""

    @property
    def normal(self) -> Float32Array:
        """Unit normal (H, W, 3) in the optical frame, towards the camera."""


class LiveEffects:
    """The filters of pose, response and image of one sensor.

    Args:
        effects: at work.
        sensor: whose gel has the effects already.

    Attributes:
        act_in_time: whether a frame may differ from the one before without a new command.
    """

    def __init__(self, effects: Sequence[Active], sensor: FilteredSensor) -> None:
        self._effects, self._sensor = tuple(effects), sensor
        self._has_response = any(active.effect.response for active in effects)
        self._has_image = any(active.effect.image for active in effects)
        has_motion = any(active.effect.motion for active in effects)
        self.act_in_time = self._has_response or self._has_image or has_motion
        self.restart()

    def restart(self) -> None:
        """Begin a session: no time has passed, and nothing is remembered."""
        self._session_s = 0.0
        self.begin()

    def begin(self) -> None:
        """Begin a trajectory: nothing is remembered; the session's time continues."""
        self._stamp_s = 0.0
        self._motion = motion_filters(self._effects)
        self._response = response_filters(self._effects)
        self._image = image_filters(self._effects)

    def moved(self, pose: Pose, force_n: FloatArray, step_s: float) -> Pose:
        """Return the indenter's true pose for a commanded one, `step_s` after the frame before, in
        which the gel pushed the indenter with a force (3,)."""
        self._stamp_s += step_s
        self._session_s += step_s
        return self._motion(self._stamp_s, pose, force_n)

    def answered(self, gel: GelFrame, pose: Pose | None) -> GelFrame:
        """Return what is measured of a gel; without an indenter, the gel as it is."""
        if pose is None or not self._has_response:
            return gel
        rest_m = self._sensor.skin.rest_position_m
        answer = self._response(
            Response(
                stamp_s=self._stamp_s,
                session_s=self._session_s,
                pose=pose,
                depth_m=float(tip_depth_m(self._sensor.skin, [pose])[0]),
                rest_position_m=rest_m,
                skin_position_m=gel.skin_position_m,
                force_n=gel.wrench.force_n,
            )
        )
        return replace(
            gel,
            skin_position_m=answer.skin_position_m,
            wrench=wrench_with_force(gel.wrench, answer.force_n, pose.position_m),
        )

    def camera(
        self, before_m: FloatArray | None, step_s: float
    ) -> Callable[[FilteredFrame], ImageArray] | None:
        """Return what the camera makes of this moment's rendered frame, whenever that is; None
        where no effect acts on it. The skin (V, 3) of the frame before, `step_s` ago, is None where
        nothing leads here."""
        if not self._has_image:
            return None
        image, stamp_s, session_s = self._image, self._stamp_s, self._session_s
        sensor = self._sensor

        def seen(frame: FilteredFrame) -> ImageArray:
            if before_m is None:
                flow = np.zeros((*frame.image.shape[:2], 2))
            else:
                flow = sensor.image_motion_px(before_m, frame.skin_position_m) / step_s
            pixels = image(
                SeenImage(
                    stamp_s=stamp_s,
                    session_s=session_s,
                    pixels=frame.image.astype(np.float64),
                    idle=sensor.idle_image.astype(np.float64),
                    centre_px=sensor.camera.principal_point_px,
                    focal_px=sensor.camera.focal_px,
                    flow_px_s=flow,
                    depth_m=frame.depth_m.astype(np.float64),
                    normal=frame.normal.astype(np.float64),
                    projection=sensor.camera.projection,
                    pixel_aspect=sensor.camera.pixel_aspect,
                )
            )
            return np.clip(np.rint(pixels), 0.0, 255.0).astype(np.uint8)

        return seen
