# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where an indenter must be for a force: for recordings that have a force and no depth.

The depth is solved by secants along the indenter's own axis, on the gel itself: each trial is a
step of it, so that friction and relaxation are those of a press that crept to its place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray

LARGEST_STEP_M = 0.25e-3
"""Of the indenter between two trials."""
REACH_M = 0.02
"""How far the indenter is moved in all: more than any gel is thick."""
TOLERANCE_SHARE = 1e-3
TOLERANCE_N = 1e-3
TRIALS = 200


class ForceNotReachedError(ValueError):
    """The gel does not give the force that was asked for."""


@dataclass(frozen=True)
class ForcedPose:
    """The pose where a force along the indenter's +z is reached, and how many steps it took."""

    pose: Pose
    force_n: float
    trials: int


def pose_at_force(press: Callable[[Pose], FloatArray], start: Pose, force_n: float) -> ForcedPose:
    """Return the pose, from a start along the indenter's z axis, at which the gel's normal force is
    the one that is asked for; the gel stands there.

    Args:
        press: moves the indenter to a pose and returns the gel's force (3,) on it, base frame.
        start: in contact or outside of the gel; the tilt and the place across the axis are kept.
        force_n: normal force, above 0; 0 needs no search.

    Raises:
        ForceNotReachedError: it is not reached on a way of 20 mm, or the force jumps over it.
        ValueError: the force is not above 0, or what `press` refuses, such as a press too deep.
    """
    if not 0.0 < force_n < np.inf:
        raise ValueError(f"a normal force of {force_n} N is to be reached, expected one above 0")
    axis = start.rotation()[:, 2]
    tolerance = max(TOLERANCE_N, TOLERANCE_SHARE * force_n)
    trials = 0

    def at(depth_m: float) -> float:
        nonlocal trials
        trials += 1
        moved = Pose(start.position_m - depth_m * axis, start.quaternion_xyzw)
        return float(press(moved) @ axis)

    here, found = 0.0, at(0.0)
    below: tuple[float, float] | None = None
    above: tuple[float, float] | None = None
    while abs(found - force_n) > tolerance:
        if trials >= TRIALS or abs(here) > REACH_M:
            raise ForceNotReachedError(
                f"the gel gives {found:.3g} N, {1e3 * here:+.2f} mm from the start along the "
                f"indenter's axis, and not {force_n:g} N; start nearer to the gel, or check that "
                "the force is in newtons"
            )
        if found < force_n:
            below = (here, found)
        else:
            above = (here, found)
        here = _next(below, above, force_n)
        found = at(here)
    return ForcedPose(Pose(start.position_m - here * axis, start.quaternion_xyzw), found, trials)


def _next(
    below: tuple[float, float] | None, above: tuple[float, float] | None, force_n: float
) -> float:
    """Return the next depth to try, between the nearest that gave less and more, if there are."""
    if above is None:
        assert below is not None
        return below[0] + LARGEST_STEP_M
    if below is None:
        return above[0] - LARGEST_STEP_M
    share = (force_n - below[1]) / (above[1] - below[1])
    # A force that grows as a power of depth lets plain secants creep up from one side.
    share = float(np.clip(share, 0.1, 0.9))
    return below[0] + share * (above[0] - below[0])
