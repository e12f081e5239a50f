# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `xarm_adapter`. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass

from dotsim_ros.control.arm.command import ToolLimits
from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.parameters import READ_ONLY


@dataclass(frozen=True)
class XarmAdapterParameters:
    """Parameters of `xarm_adapter`; each field says what it is.

    Raises:
        ValueError: a value out of its range, or two that contradict each other.
    """

    service: str = quantity("/xarm/vc_set_cartesian_velocity", fixed=READ_ONLY)
    """The driver's service for Cartesian velocities."""
    robot_states: str = quantity("/xarm/robot_states", fixed=READ_ONLY)
    """The driver's topic of the arm's state."""
    base_frame: str = quantity("link_base", fixed=READ_ONLY)
    """Frame of ee_pose; a velocity stamped with it is along its axes."""
    tool_frame: str = quantity("link_tcp", fixed=READ_ONLY)
    """A velocity stamped with this frame is along the tool's axes."""
    rate_hz: float = quantity(50.0, low=1.0, high=200.0, fixed=READ_ONLY)
    """Rate at which calls may begin; at most one is pending at a time."""
    duration_s: float = quantity(0.1, low=0.02, high=1.0)
    """Time limit of the arm's own watchdog, sent with each call: the arm stops after this time
    without another call. Must not be 0, which disables the watchdog."""
    stale_s: float = quantity(0.1, low=0.02, high=1.0)
    """An older command counts as zero."""
    silence_s: float = quantity(0.5, low=0.05, high=10.0)
    """No commands are sent after this time without the arm's state; its driver reports it at 5 Hz,
    with report_type dev at 100 Hz."""
    answer_s: float = quantity(0.5, low=0.05, high=10.0)
    """Longest wait for the response to a call."""
    speed_limit_m_s: float = quantity(0.1, low=0.001, high=1.0)
    """Largest commanded speed of the tool; faster commands are scaled down."""
    angular_speed_limit_rad_s: float = quantity(0.5, low=0.001, high=3.14)
    """Largest commanded rate of turning; faster commands are scaled down."""
    diagnostics_period_s: float = quantity(1.0, low=0.05, high=60.0, fixed=READ_ONLY)
    """Period of the diagnostics."""

    def __post_init__(self) -> None:
        check_fields("", self)
        if "" in (self.service, self.robot_states):
            raise ValueError("service and robot_states must not be empty")
        if "" in (self.base_frame, self.tool_frame) or self.base_frame == self.tool_frame:
            raise ValueError(
                f"base_frame and tool_frame are {self.base_frame!r} and {self.tool_frame!r}: they "
                "must differ and must not be empty"
            )
        if self.duration_s < 1.5 / self.rate_hz:
            raise ValueError(
                f"duration_s is {self.duration_s:g}, shorter than one and a half periods of "
                f"{self.rate_hz:g} Hz: the arm would stop between two calls"
            )

    @property
    def tool(self) -> ToolLimits:
        """What may be sent; faster commands are scaled down."""
        return ToolLimits(self.speed_limit_m_s, self.angular_speed_limit_rad_s)
