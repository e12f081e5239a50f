# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What an arm that is led by touch may do, and the states and reasons of its loop."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from dotsim_ros.control.arm.command import ToolLimits
from dotsim_ros.control.safety_layer.freshness import StreamReading
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray

SHORTEST_IMAGE_TIMEOUT_S = 0.045
"""A steady stream of 25 Hz must not count as cut, at any speed."""


class State(StrEnum):
    """What the loop does."""

    DISABLED = "disabled"
    STARTING = "starting"
    RUNNING = "running"
    RETREATING = "retreating"
    STOPPED = "stopped"
    LATCHED = "latched"


class Reason(StrEnum):
    """Why the loop does not follow the policy."""

    NONE = "none"
    IMAGE_STALE = "image_stale"
    IMAGE_DELAYED = "image_delayed"
    POSE_STALE = "pose_stale"
    POSE_DELAYED = "pose_delayed"
    FORCE_STALE = "force_stale"
    POLICY_LATE = "policy_late"
    FORCE_LIMIT = "force_limit"
    RETREAT_FAILED = "retreat_failed"
    NOT_FINITE = "not_finite"
    POLICY_FAILED = "policy_failed"
    WRONG_SENSOR = "wrong_sensor"
    WORKSPACE = "workspace"
    CLOCK_JUMP = "clock_jump"


@dataclass(frozen=True)
class SafetyLimits(ToolLimits):
    """What the arm may do, and how old the data that it acts on may be.

    Attributes:
        stop_within_s: from the last message of a stream to a command of zero.
        tick_s: period of the control loop, which a stop may have to wait for.
        delay_s: oldest that a message may be when it comes, by its stamp.
        half_box_m: (3,) half the edges of the workspace, along the base's axes, around the pose at
            which the loop was enabled.
        turn_rad: furthest that the tool may be turned from there.
        reaction_s: how long the arm continues before a command takes effect.
        force_n: force that the tool retreats above; infinite: the force is not looked at.
        release_n: force below which the retreat ends.
        retreat_m_s, retreat_m: speed of the retreat, along -z of the tool, and the furthest that
            it may go before it counts as failed.
        resumes: whether a stop for old data ends by itself.

    Raises:
        ValueError: the arm could not stop in time, or a limit contradicts another.
    """

    linear_m_s: float = 0.05
    angular_rad_s: float = 0.4
    linear_m_s2: float = 2.5
    angular_rad_s2: float = 20.0
    stop_within_s: float = 0.08
    tick_s: float = 0.01
    delay_s: float = 0.25
    half_box_m: FloatArray = field(default_factory=lambda: np.array([0.06, 0.06, 0.02]))
    turn_rad: float = 0.35
    reaction_s: float = 0.1
    force_n: float = 8.0
    release_n: float = 6.4
    retreat_m_s: float = 0.01
    retreat_m: float = 0.02
    resumes: bool = True

    def __post_init__(self) -> None:
        brake_s = self.longest_brake_s
        if self.timeout_s(brake_s) < SHORTEST_IMAGE_TIMEOUT_S:
            raise ValueError(
                f"from full speed the arm brakes for {brake_s:.3f} s: to stand still "
                f"{self.stop_within_s} s after the last image it would have to brake after "
                f"{self.timeout_s(brake_s):.3f} s, before the next image of a steady 25 Hz comes; "
                "lower the speeds, or raise the accelerations or the time to stop"
            )
        if self.release_n > self.force_n:
            raise ValueError(
                f"the retreat would end at {self.release_n} N, above the {self.force_n} N at which "
                "it begins"
            )
        if self.retreat_m_s > self.linear_m_s:
            raise ValueError(
                f"the retreat's {self.retreat_m_s} m/s are faster than the arm's {self.linear_m_s}"
            )

    @property
    def longest_brake_s(self) -> float:
        """Return how long the arm takes to stand still from full speed."""
        return max(self.linear_m_s / self.linear_m_s2, self.angular_rad_s / self.angular_rad_s2)

    def timeout_s(self, brake_s: float) -> float:
        """Return the age of a message at which braking must begin.

        One tick of the control loop goes by until its age is looked at, half a one is for the way
        of the command.
        """
        return self.stop_within_s - brake_s - 1.5 * self.tick_s


@dataclass(frozen=True)
class Readings:
    """What is known at one tick of the control loop: the streams, the pose of the tool in the base
    (None before the first) and the size of the newest force."""

    now_s: float
    image: StreamReading
    pose: StreamReading
    force: StreamReading
    tool: Pose | None
    force_n: float = 0.0
