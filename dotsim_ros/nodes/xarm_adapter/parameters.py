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

    service: str = quantity(
        "/xarm/vc_set_cartesian_velocity",
        help="The driver's service for Cartesian velocities.",
        fixed=READ_ONLY,
    )
    robot_states: str = quantity(
        "/xarm/robot_states", help="The driver's topic of the arm's state.", fixed=READ_ONLY
    )
    base_frame: str = quantity(
        "link_base",
        help="Frame of ee_pose; a velocity stamped with it is along its axes.",
        fixed=READ_ONLY,
    )
    tool_frame: str = quantity(
        "link_tcp",
        help="A velocity stamped with this frame is along the tool's axes.",
        fixed=READ_ONLY,
    )
    rate_hz: float = quantity(
        50.0,
        help="Rate at which calls may begin; at most one is pending at a time.",
        low=1.0,
        high=200.0,
        fixed=READ_ONLY,
    )
    duration_s: float = quantity(
        0.1,
        help="Time limit of the arm's own watchdog, sent with each call: the arm stops after this "
        "time without another call. Must not be 0, which disables the watchdog.",
        low=0.02,
        high=1.0,
    )
    stale_s: float = quantity(0.1, help="An older command counts as zero.", low=0.02, high=1.0)
    silence_s: float = quantity(
        0.5,
        help="No commands are sent after this time without the arm's state; its driver reports it "
        "at 5 Hz, with report_type dev at 100 Hz.",
        low=0.05,
        high=10.0,
    )
    answer_s: float = quantity(
        0.5, help="Longest wait for the response to a call.", low=0.05, high=10.0
    )
    speed_limit_m_s: float = quantity(
        0.1,
        help="Largest commanded speed of the tool; faster commands are scaled down.",
        low=0.001,
        high=1.0,
    )
    angular_speed_limit_rad_s: float = quantity(
        0.5,
        help="Largest commanded rate of turning; faster commands are scaled down.",
        low=0.001,
        high=3.14,
    )
    diagnostics_period_s: float = quantity(
        1.0, help="Period of the diagnostics.", low=0.05, high=60.0, fixed=READ_ONLY
    )

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
