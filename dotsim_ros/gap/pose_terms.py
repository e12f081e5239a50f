"""Filters of the pose that several effects share."""

from __future__ import annotations

import numpy as np

from dotsim_ros.gap.effect import Array, MotionFilter
from dotsim_ros.geometry.pose import Pose

OFFSET_M = 0.5e-3
"""Largest error of an arm's calibration that is taken for one; more is a wrong sensor file."""


def shifted(pose: Pose, shift_m: Array) -> Pose:
    """Return a pose moved by (3,) in the frame that it is given in."""
    return Pose(pose.position_m + shift_m, pose.quaternion_xyzw)


def shift_along(axis: int, distance_m: float) -> MotionFilter:
    """Return a filter that moves every pose along an axis, 0 to 2, of the base frame."""
    shift_m = np.zeros(3)
    shift_m[axis] = distance_m

    def moved(stamp_s: float, pose: Pose, force_n: Array) -> Pose:
        return shifted(pose, shift_m)

    return moved
