# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What an arm that is led by touch may do, and the states and reasons of its loop."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np

from dotsim_ros.control.arm.command import ToolLimits
from dotsim_ros.control.safety_layer.freshness import StreamReading
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.quantity import check_fields, quantity

POLICY_RATE_HZ, CONTROL_RATE_HZ = 25.0, 100.0
TICK_S = 1.0 / CONTROL_RATE_HZ
"""Period of the control loop, which a stop may have to wait for."""
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
class SafetyLimits:
    """What the arm may do, and how old the data that it acts on may be; each field says what it is.

    Raises:
        ValueError: a value out of its range, the arm could not stop in time, or a limit contradicts
            another.
    """

    maximum_linear_m_s: float = quantity(0.05, low=1e-4, high=1.0)
    """Speed limit of the tool."""
    maximum_angular_rad_s: float = quantity(0.4, low=1e-3, high=4.0)
    """Limit of the tool's angular speed."""
    maximum_linear_m_s2: float = quantity(2.5, low=0.01, high=50.0)
    """Limit of the tool's linear acceleration."""
    maximum_angular_rad_s2: float = quantity(20.0, low=0.1, high=500.0)
    """Limit of the tool's angular acceleration."""
    workspace_m: tuple[float, float, float] = quantity((0.12, 0.12, 0.04), low=1e-3, high=2.0)
    """Edges of the box that the tool may not leave, along the base's axes, around the pose at which
    the node was enabled."""
    maximum_turn_rad: float = quantity(0.35, low=1e-3, high=3.0)
    """Largest angle by which the tool may be turned from its orientation when the node was
    enabled."""
    reaction_s: float = quantity(0.1, low=0.0, high=1.0)
    """How long the arm continues before a command takes effect; the margin kept to the workspace's
    border follows from it."""
    stop_within_s: float = quantity(0.08, low=0.06, high=1.0)
    """The commands are zero at the latest this long after the last image, pose or force."""
    maximum_delay_s: float = quantity(0.25, low=0.01, high=1e9)
    """A message that arrives later than this after its stamp stops the arm."""
    resume_when_fresh: bool = quantity(True)
    """Resume without a call once messages that were late arrive again; otherwise set_enabled is
    needed."""
    force_limit_n: float = quantity(8.0, low=0.0, high=1000.0)
    """Force on the topic wrench above which the tool retreats. 0: the sensor measures no force, the
    topic is not read, and nothing limits the force."""
    force_release_share: float = quantity(0.8, low=0.01, high=1.0)
    """The retreat ends below this share of the limit."""
    retreat_m_s: float = quantity(0.01, low=1e-4, high=1.0)
    """Speed of the retreat, along -z of the tool."""
    retreat_m: float = quantity(0.02, low=1e-4, high=0.5)
    """If the force is still too large after a retreat of this length, the arm stops until it is
    enabled again."""

    def __post_init__(self) -> None:
        check_fields("", self)
        brake_s = self.longest_brake_s
        if self.timeout_s(brake_s) < SHORTEST_IMAGE_TIMEOUT_S:
            raise ValueError(
                f"from full speed the arm brakes for {brake_s:.3f} s: to stand still "
                f"{self.stop_within_s} s after the last image it would have to brake after "
                f"{self.timeout_s(brake_s):.3f} s, before the next image of a steady 25 Hz comes; "
                "lower the speeds, or raise the accelerations or the time to stop"
            )
        if self.retreat_m_s > self.maximum_linear_m_s:
            raise ValueError(
                f"the retreat's {self.retreat_m_s} m/s are faster than the arm's "
                f"{self.maximum_linear_m_s}"
            )

    @cached_property
    def tool(self) -> ToolLimits:
        """Limits of the tool's velocity."""
        return ToolLimits(
            self.maximum_linear_m_s,
            self.maximum_angular_rad_s,
            self.maximum_linear_m_s2,
            self.maximum_angular_rad_s2,
        )

    @cached_property
    def half_box_m(self) -> FloatArray:
        """Half the edges (3,) of the workspace."""
        return 0.5 * np.array(self.workspace_m)

    @property
    def force_n(self) -> float:
        """Force that the tool retreats above; infinite: the force is not looked at."""
        return self.force_limit_n or np.inf

    @property
    def release_n(self) -> float:
        """Force below which the retreat ends."""
        return self.force_release_share * self.force_n

    @property
    def longest_brake_s(self) -> float:
        """Return how long the arm takes to stand still from full speed."""
        return max(
            self.maximum_linear_m_s / self.maximum_linear_m_s2,
            self.maximum_angular_rad_s / self.maximum_angular_rad_s2,
        )

    def timeout_s(self, brake_s: float) -> float:
        """Return the age of a message at which braking must begin.

        One tick of the control loop goes by until its age is looked at, half a one is for the way
        of the command.
        """
        return self.stop_within_s - brake_s - 1.5 * TICK_S


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
