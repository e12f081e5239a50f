# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where an indenter presses so that the gel's normal force is one that is asked for. Needs no ROS.

The pose says where the indenter's axis lies and how it is turned; what it says along that axis, the
indenter's own z, is not used.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dotsim_ros.gel.implicit.gel import LARGEST_SUBSTEP_M
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.nodes.common.health import Report
from dotsim_ros.nodes.common.ingest import Fault, RefusedInputError
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.twin.force_following import ForceFollower, is_met
from msg_adapters import Level

TRAVEL_M = LARGEST_SUBSTEP_M
"""How far the indenter moves in the gel in one frame at most, in every profile."""
NEAR_M = 2e-6
"""Of the skin: it counts as touched."""
TOUCH_STEP_COUNT = 64
HALVING_COUNT = 8
"""How often the way to a depth that the gel refuses is halved."""
MISSED_COUNT = 25
"""Frames in a row that do not give the force that is asked for: it is warned of from then on."""


def touch_m(pose: Pose, sensor: TactileSensor) -> float:
    """Return how far along the indenter's z axis from a pose an indenter that comes along that axis
    first touches the skin at rest: the depth of the pose, negative above the skin.

    Raises:
        RefusedInputError: an indenter on this axis passes the gel by.
    """
    skin_m = sensor.skin.rest_position_m
    axis = pose.rotation()[:, 2]
    heights_m = (skin_m - pose.position_m) @ axis
    here_m = float(heights_m.max())
    # An indenter's side may touch where its tip is below all of the skin.
    lowest_m = float(heights_m.min() - np.ptp(sensor.indenter.bounds_m()[:, 2]))
    for _ in range(TOUCH_STEP_COUNT):
        there = _moved(pose, here_m)
        gap_m = float(sensor.indenter.distance_from(skin_m, there).min())
        if gap_m < NEAR_M:
            return here_m
        here_m -= gap_m
        if here_m < lowest_m:
            break
    raise RefusedInputError(
        Fault.GEL,
        f"the indenter at {np.round(pose.position_m * 1e3, 2).tolist()} mm passes the gel by along "
        "its z axis, so that no depth gives a force: move it across, or turn it towards the gel",
    )


def _moved(pose: Pose, along_m: float) -> Pose:
    return Pose(pose.position_m + along_m * pose.rotation()[:, 2], pose.quaternion_xyzw)


class ForceDrive:
    """Moves the indenter of one sensor along its axis from frame to frame, after the force.

    Args:
        sensor: that is pressed.
        asked_n: returns the normal force that is asked for, of the gel on an indenter at a pose.
    """

    def __init__(self, sensor: TactileSensor, asked_n: Callable[[Pose], float]) -> None:
        self._sensor, self._ask = sensor, asked_n
        self._follower = ForceFollower(travel_m=TRAVEL_M)
        self.forget()

    def forget(self) -> None:
        """Begin again, clear of the gel, with nothing known of it: it may be another indenter."""
        self._follower.forget()
        self._asked_n = self._reached_n = 0.0
        self._missed_count, self._is_deepest = 0, False

    def is_met(self, pose: Pose) -> bool:
        """Return whether the last frame gave what is asked for at a pose, so that the indenter may
        stay there."""
        return is_met(self._reached_n, self._ask(pose))

    def pose(self, commanded: Pose) -> Pose:
        """Return where the indenter presses in the next frame.

        Args:
            commanded: gives the axis, and the turn about it.

        Raises:
            RefusedInputError: the axis passes the gel by.
        """
        self._asked_n = self._ask(commanded)
        touch = _moved(commanded, touch_m(commanded, self._sensor))
        depth_m = self._follower.next_m(self._asked_n)
        self._is_deepest = not self._is_allowed(touch, depth_m)
        if self._is_deepest:
            depth_m = self._deepest_m(touch, depth_m)
        return _moved(touch, -depth_m)

    def _is_allowed(self, touch: Pose, depth_m: float) -> bool:
        try:
            self._sensor.check_depth(_moved(touch, -depth_m))
        except ValueError:
            return False
        return True

    def _deepest_m(self, touch: Pose, refused_m: float) -> float:
        """Return the largest depth that the gel allows, from the last one to a refused one."""
        depth_m = min(self._follower.depth_m, refused_m)
        # At another place the last depth may be too large, too.
        while depth_m > 0.0 and not self._is_allowed(touch, depth_m):
            depth_m -= TRAVEL_M
        for _ in range(HALVING_COUNT):
            middle_m = 0.5 * (depth_m + refused_m)
            if self._is_allowed(touch, middle_m):
                depth_m = middle_m
            else:
                refused_m = middle_m
        return depth_m

    def answer(self, pose: Pose, force_n: FloatArray) -> None:
        """Take what the gel gave.

        Args:
            pose: where the indenter got, which may be short of where it was to go.
            force_n: (3,) of the gel on it, base frame.
        """
        self._reached_n = float(force_n @ pose.rotation()[:, 2])
        self._follower.answer(touch_m(pose, self._sensor), self._reached_n)
        is_missed = not is_met(self._reached_n, self._asked_n)
        self._missed_count = self._missed_count + 1 if is_missed else 0

    def report(self) -> Report:
        """Return how the force is followed, for the diagnostics."""
        values = {
            "asked_n": f"{self._asked_n:.4f}",
            "reached_n": f"{self._reached_n:.4f}",
            "depth_mm": f"{1e3 * self._follower.depth_m:.4f}",
            "missed_frames": str(self._missed_count),
        }
        is_missed = self._missed_count >= MISSED_COUNT
        if not (is_missed or (self._is_deepest and self._missed_count)):
            return Level.OK, "the force is followed", values
        why = f"it has been missed for {self._missed_count} frames"
        if self._is_deepest:
            why = "the gel allows no deeper press"
        gap = f"{self._asked_n:.3f} N are asked for and {self._reached_n:.3f} N reached: {why}"
        return Level.WARN, gap, values
