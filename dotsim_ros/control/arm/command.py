# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Velocity commands of a tool: their axes, their limits, and how they change from one to the next.

A command is a `Twist`: (6,) float64, the linear velocity of the tool's origin in m/s, then the
angular velocity in rad/s, both along the axes of one frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dotsim_ros.geometry.pose import Pose

Twist = NDArray[np.float64]

LINEAR, ANGULAR = slice(0, 3), slice(3, 6)
LARGEST_SPEED_M_S, LARGEST_RATE_RAD_S = 10.0, 100.0
"""No arm is commanded beyond: such a number is none of metres and radians a second."""
LARGEST_REACH_M = 5.0
"""Nor is its tool that far from its base."""


def check_plausible(twist: Twist) -> None:
    """Refuse what can be no velocity of an arm's tool; its limits are much lower.

    Raises:
        ValueError: a number is not finite, or far beyond what arms do.
    """
    if not np.isfinite(twist).all():
        raise ValueError(f"the velocity holds a number that is not finite: {twist.tolist()}")
    linear, angular = np.abs(twist[LINEAR]).max(), np.abs(twist[ANGULAR]).max()
    if linear > LARGEST_SPEED_M_S or angular > LARGEST_RATE_RAD_S:
        raise ValueError(
            f"the velocity is {twist.tolist()}, expected at most {LARGEST_SPEED_M_S:g} m/s and "
            f"{LARGEST_RATE_RAD_S:g} rad/s; is it in millimetres or degrees?"
        )


def check_reach(position_m: NDArray[np.float64]) -> None:
    """Refuse what can be no place (3,) of an arm's tool in its base.

    Raises:
        ValueError: a number is not finite, or beyond any arm's reach.
    """
    if not np.abs(position_m).max() <= LARGEST_REACH_M:
        raise ValueError(
            f"the tool is at {position_m.tolist()} m, expected within {LARGEST_REACH_M:g} m of the "
            "base; is it in millimetres?"
        )


def zero_twist() -> Twist:
    """Return the command to stand still."""
    return np.zeros(6)


def in_base_axes(twist: Twist, pose: Pose) -> Twist:
    """Return a command along the axes of a tool, whose pose in the base is given, along the
    base's."""
    return np.asarray((twist.reshape(2, 3) @ pose.rotation().T).reshape(6))


def turn_between(pose: Pose, wanted: Pose) -> NDArray[np.float64]:
    """Return the (3,) rotation vector (rad) along the tool's axes that turns it as is wanted."""
    present = Rotation.from_quat(pose.quaternion_xyzw)
    return np.asarray((present.inv() * Rotation.from_quat(wanted.quaternion_xyzw)).as_rotvec())


@dataclass(frozen=True)
class ToolLimits:
    """The most that the velocity of a tool may be, and may change by in a second."""

    linear_m_s: float = np.inf
    angular_rad_s: float = np.inf
    linear_m_s2: float = np.inf
    angular_rad_s2: float = np.inf

    def within_speed(self, twist: Twist) -> Twist:
        """Return a command whose two speeds are at most these; directions stay."""
        return _both_shortened(twist, self.linear_m_s, self.angular_rad_s)

    def approached(self, present: Twist, target: Twist, duration_s: float) -> Twist:
        """Return what a command may become within a time, on the straight way to the target."""
        largest = self.linear_m_s2 * duration_s, self.angular_rad_s2 * duration_s
        return present + _both_shortened(target - present, *largest)

    def brake_time_s(self, twist: Twist) -> float:
        """Return how long it takes to come to rest."""
        linear, angular = np.linalg.norm(twist[LINEAR]), np.linalg.norm(twist[ANGULAR])
        return float(max(linear / self.linear_m_s2, angular / self.angular_rad_s2))


RATE_SHARE = 0.5
"""How much of what a policy's commands have changed by counts as their rate at once."""
LONGEST_GAP_PERIODS = 3
"""Between images that are farther apart nobody knows how the commands went."""


class CommandPredictor:
    """Says what a policy will command a little later, from how its commands have been turning.

    A command answers an image, and takes effect only once that was exposed, sent and looked at. By
    then the tool has gone on, and on a curved path the command points outwards. The line through
    the newest commands (a first-order hold) makes up for it.
    """

    def __init__(self, lead_s: float, period_s: float) -> None:
        self._lead_s, self._period_s = lead_s, period_s
        self._command, self._image_s, self._rate = zero_twist(), -np.inf, zero_twist()

    def put(self, command: Twist, image_s: float) -> Twist:
        """Return what to command; each of its speeds is at most that of the last two commands."""
        before, gap_s = self._command, image_s - self._image_s
        self._command, self._image_s = command.copy(), image_s
        # Images are made at an even rate, whenever they arrive.
        periods = max(1, round(min(gap_s, 1.0) / self._period_s))
        if self._lead_s == 0.0 or gap_s <= 0.0 or periods > LONGEST_GAP_PERIODS:
            self._rate = zero_twist()
            return command
        rate = (command - before) / (periods * self._period_s)
        self._rate = self._rate + RATE_SHARE * (rate - self._rate)
        both = np.stack([command, before])
        limits = ToolLimits(
            float(np.linalg.norm(both[:, LINEAR], axis=1).max()),
            float(np.linalg.norm(both[:, ANGULAR], axis=1).max()),
        )
        return limits.within_speed(command + self._lead_s * self._rate)


class CommandInterpolator:
    """Goes from each command to the next on a straight line, never beyond.

    The line ends one period after its command has come, so it lags by half a period on average: the
    price of steps a quarter as large at four times the rate.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._start, self._end = zero_twist(), zero_twist()
        self._begun_s = -np.inf

    def put(self, command: Twist, now_s: float) -> None:
        """Begin to go to a command from wherever the line is."""
        self._start, self._end, self._begun_s = self.at(now_s), command.copy(), now_s

    def reset(self) -> None:
        """Go on from rest."""
        self._start, self._end, self._begun_s = zero_twist(), zero_twist(), -np.inf

    def at(self, now_s: float) -> Twist:
        """Return the command of a time."""
        share = min(1.0, max(0.0, (now_s - self._begun_s) / self._period_s))
        return self._start + share * (self._end - self._start)


def shortened(vector: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
    """Return a vector of at most a length; its direction stays."""
    length = float(np.linalg.norm(vector))
    return vector if length <= longest else vector * (longest / length)


def _both_shortened(twist: Twist, linear: float, angular: float) -> Twist:
    return np.concatenate([shortened(twist[LINEAR], linear), shortened(twist[ANGULAR], angular)])
