# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How far an indenter that may not move freely gets on its way to a pose. Needs no ROS."""

from __future__ import annotations

from dotsim_ros.arrays import FloatArray
from dotsim_ros.geometry.indenter import Indenter, way_m
from dotsim_ros.geometry.pose import Pose, interpolate

TOUCH_M = 0.05e-3
"""Closer to the skin than this the free way ends."""
FREE_STEP_COUNT = 32
"""A way that grazes the skin is looked at no more often."""


def clearance_m(pose: Pose, indenter: Indenter, skin_position_m: FloatArray) -> float:
    """Return the distance of an indenter from skin markers (V, 3), negative in contact."""
    return float(indenter.distance_from(skin_position_m, pose).min())


def pursue(
    start: Pose, target: Pose, *, indenter: Indenter, skin_position_m: FloatArray, limit_m: float
) -> Pose:
    """Return the pose on the way to a target that is `limit_m` behind the free way.

    The free way, where the indenter does not touch the skin, costs a gel nothing and counts for
    nothing. It is followed by as much as the indenter is clear of the skin, again and again.

    Args:
        start: of the way.
        target: its end; returned itself where it is within reach.
        indenter: what moves.
        skin_position_m: (V, 3) markers of the skin, base frame.
        limit_m: how far the indenter may move in contact.
    """
    length_m = way_m(start, target, indenter)
    free_m = 0.0
    for _ in range(FREE_STEP_COUNT):
        if free_m + limit_m >= length_m:
            return target
        here = interpolate(start, target, free_m / length_m)
        gap_m = clearance_m(here, indenter, skin_position_m)
        if gap_m < TOUCH_M:
            break
        free_m += gap_m
    if free_m + limit_m >= length_m:
        return target
    return interpolate(start, target, (free_m + limit_m) / length_m)
