# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `xarm_adapter`. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass

from dotsim_ros.nodes.common.options import check_options, option
from dotsim_ros.nodes.xarm_adapter.link import LinkLimits


@dataclass(frozen=True)
class XarmAdapterParameters:
    """Parameters of `xarm_adapter`; each field says what it is.

    Raises:
        ValueError: a value out of its range, or two that contradict each other.
    """

    service: str = option(
        "/xarm/vc_set_cartesian_velocity",
        "The driver's service for Cartesian velocities.",
        read_only=True,
    )
    robot_states: str = option(
        "/xarm/robot_states", "The driver's topic of the arm's state.", read_only=True
    )
    base_frame: str = option(
        "link_base",
        "Frame of ee_pose; a velocity stamped with it is along its axes.",
        read_only=True,
    )
    tool_frame: str = option(
        "link_tcp", "A velocity stamped with this frame is along the tool's axes.", read_only=True
    )
    rate_hz: float = option(
        50.0,
        "Rate at which calls may begin; at most one is pending at a time.",
        minimum=1.0,
        maximum=200.0,
        read_only=True,
    )
    duration_s: float = option(
        0.1,
        "Time limit of the arm's own watchdog, sent with each call: the arm stops after this time "
        "without another call. Must not be 0, which disables the watchdog.",
        minimum=0.02,
        maximum=1.0,
    )
    stale_s: float = option(0.1, "An older command counts as zero.", minimum=0.02, maximum=1.0)
    silence_s: float = option(
        0.5,
        "No commands are sent after this time without the arm's state; its driver reports it at "
        "5 Hz, with report_type dev at 100 Hz.",
        minimum=0.05,
        maximum=10.0,
    )
    answer_s: float = option(
        0.5, "Longest wait for the response to a call.", minimum=0.05, maximum=10.0
    )
    speed_limit_m_s: float = option(
        0.1,
        "Largest commanded speed of the tool; faster commands are scaled down.",
        minimum=0.001,
        maximum=1.0,
    )
    angular_speed_limit_rad_s: float = option(
        0.5,
        "Largest commanded rate of turning; faster commands are scaled down.",
        minimum=0.001,
        maximum=3.14,
    )
    diagnostics_period_s: float = option(
        1.0, "Period of the diagnostics.", minimum=0.05, maximum=60.0, read_only=True
    )

    def __post_init__(self) -> None:
        check_options(self)
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

    def limits(self) -> LinkLimits:
        """Return what may be sent."""
        return LinkLimits(
            linear_m_s=self.speed_limit_m_s,
            angular_rad_s=self.angular_speed_limit_rad_s,
            stale_s=self.stale_s,
            silence_s=self.silence_s,
            answer_s=self.answer_s,
        )
