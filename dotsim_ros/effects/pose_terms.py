# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Filters of the pose that several effects share."""

from __future__ import annotations

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, MotionFilter, Values
from dotsim_ros.effects.excitation import touches
from dotsim_ros.geometry.pose import Pose

OFFSET_M = 0.5e-3
"""Largest pose offset that is taken for an error of calibration; more is a wrong sensor file."""


def shifted(pose: Pose, shift_m: FloatArray) -> Pose:
    """Return a pose moved by (3,) in the frame that it is given in."""
    return Pose(pose.position_m + shift_m, pose.quaternion_xyzw)


def offset_effect(axis: str, *, name: str, protocol: str, taken_for: tuple[str, ...]) -> Effect:
    """Return the effect that moves every pose along an axis, x, y or z, of the base frame."""
    parameter = EffectParameter(f"{axis}_m", "m", 0.0, -OFFSET_M, OFFSET_M, (0.2e-3, -0.2e-3))
    direction = np.eye(3)["xyz".index(axis)]

    def motion(values: Values) -> MotionFilter:
        shift_m = values[parameter.name] * direction

        def moved(stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
            return shifted(pose, shift_m)

        return moved

    return Effect(
        name=name,
        title=f"A pose offset along {axis}",
        parameters=(parameter,),
        channels=(SKIN, FORCE),
        protocol=protocol,
        excited_by=touches,
        taken_for=taken_for,
        motion=motion,
    )
