# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects at work in a live sensor: what goes in and comes out frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dotsim_ros.effects.effect import (
    Active,
    Response,
    image_filters,
    motion_filters,
    response_filters,
    seen_through,
)
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.geometry.skin_mesh import tip_depth_m
from dotsim_ros.io.arrays import FloatArray, ImageArray

if TYPE_CHECKING:
    from dotsim_ros.gel.make import GelFrame
    from dotsim_ros.sensor import Frame, TactileSensor

NO_FORCE_N = 1e-9
"""A force below this has no direction."""


def wrench_with_force(wrench: Wrench, force_n: FloatArray, tip_m: FloatArray) -> Wrench:
    """Return a wrench about the frame's origin with another force (3,).

    What of it lies along the force before acts where that did; the rest acts at the tip (3,).
    """
    before = wrench.force_n
    square = float(before @ before)
    share = float(force_n @ before) / square if square > NO_FORCE_N**2 else 0.0
    torque = share * wrench.torque_nm + np.cross(tip_m, force_n - share * before)
    return Wrench(force_n, torque)


class LiveEffects:
    """The filters of pose, response and image of one sensor.

    Args:
        effects: at work.
        sensor: whose gel has the effects already.

    Attributes:
        act_in_time: whether a frame may differ from the one before without a new command.
    """

    def __init__(self, effects: Sequence[Active], sensor: TactileSensor) -> None:
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
    ) -> Callable[[Frame], ImageArray] | None:
        """Return what the camera makes of this moment's rendered frame, whenever that is; None
        where no effect acts on it. The skin (V, 3) of the frame before, `step_s` ago, is None where
        nothing leads here."""
        if not self._has_image:
            return None
        image, stamp_s, session_s = self._image, self._stamp_s, self._session_s
        sensor = self._sensor

        def seen(frame: Frame) -> ImageArray:
            flow = None
            if before_m is not None:
                flow = sensor.image_motion_px(before_m, frame.skin_position_m) / step_s
            return seen_through(
                image,
                sensor.camera,
                stamp_s=stamp_s,
                session_s=session_s,
                image=frame.image,
                idle=sensor.idle_image,
                depth_m=frame.depth_m,
                normal=frame.normal,
                flow_px_s=flow,
            )

        return seen
