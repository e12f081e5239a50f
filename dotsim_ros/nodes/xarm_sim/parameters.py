# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `xarm_sim`. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.control.arm.simulated import LONGEST_DELAY_S, ArmFaults, ArmLimits, ArmResponse
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.common.options import check_options, option


@dataclass(frozen=True)
class XarmSimParameters:
    """Parameters of `xarm_sim`; each field says what it is.

    Raises:
        ValueError: a value out of its range, a pose that is none, or frames that are the same.
    """

    rate_hz: float = option(
        100.0,
        "Rate of the feedback; the arm's driver publishes at 100 Hz with report_type dev.",
        minimum=1.0,
        maximum=200.0,
        read_only=True,
    )
    base_frame: str = option("link_base", "Frame of the poses and of velocities.", read_only=True)
    tool_frame: str = option(
        "link_tcp",
        "A velocity stamped with this frame is taken along the tool's axes.",
        read_only=True,
    )
    sensor_frame: str = option(
        "densetact_base", "Frame of indenter/pose: the base of the sensor.", read_only=True
    )
    start_pose: tuple[float, ...] = option(
        (0.35, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0),
        "Pose of the tool in the base at the start and after ~/reset: x, y, z in metres, then the "
        "quaternion x, y, z, w. The default points down.",
        minimum=-10.0,
        maximum=10.0,
        read_only=True,
    )
    tool_from_sensor: tuple[float, ...] = option(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        "Pose of the sensor's base in the tool's frame, numbers as in start_pose.",
        minimum=-10.0,
        maximum=10.0,
        read_only=True,
    )
    indenter_pose: tuple[float, ...] = option(
        (0.35, 0.0, 0.28, 1.0, 0.0, 0.0, 0.0),
        "Pose in the base of a fixed indenter that the sensor is moved against, numbers as in "
        "start_pose; its +z points away from the gel. The default is 4.25 mm before the dome.",
        minimum=-10.0,
        maximum=10.0,
    )
    publish_indenter: bool = option(
        True, "Publish indenter/pose, which moves the indenter of tactile_sim."
    )
    latency_s: float = option(
        0.01,
        "Latency from a command to its first effect.",
        minimum=0.0,
        maximum=1.0,
        read_only=True,
    )
    jitter_s: float = option(
        0.002,
        "Standard deviation of the random delay added to the latency; the delay is never negative.",
        minimum=0.0,
        maximum=1.0,
        read_only=True,
    )
    time_constant_s: float = option(
        0.02,
        "Time constant of the first-order lag of the velocity behind the commanded one.",
        minimum=0.001,
        maximum=10.0,
        read_only=True,
    )
    stale_s: float = option(
        0.2,
        "The arm stops after this time without a command.",
        minimum=0.02,
        maximum=10.0,
        read_only=True,
    )
    seed: int = option(0, "Seed of the jitter.", minimum=0, maximum=2**31 - 1, read_only=True)
    speed_limit_m_s: float = option(
        1.0, "Speed limit of the tool.", minimum=0.001, maximum=1.0, read_only=True
    )
    angular_speed_limit_rad_s: float = option(
        3.14, "Limit of the tool's angular speed.", minimum=0.001, maximum=10.0, read_only=True
    )
    acceleration_limit_m_s2: float = option(
        50.0,
        "Limit of the tool's linear acceleration.",
        minimum=0.01,
        maximum=50.0,
        read_only=True,
    )
    angular_acceleration_limit_rad_s2: float = option(
        20.0,
        "Limit of the tool's angular acceleration.",
        minimum=0.01,
        maximum=200.0,
        read_only=True,
    )
    joint_speed_limit_rad_s: float = option(
        4.0,
        "Speed limit of each joint; where one would exceed it, all are scaled down alike. UFACTORY "
        "allows 3.14.",
        minimum=0.01,
        maximum=10.0,
        read_only=True,
    )
    fail_drop_feedback: bool = option(
        False, "Injected failure: poses, velocities and joints are not published."
    )
    fail_delay_s: float = option(
        0.0,
        "Injected failure: commands act, and feedback is published, this much later.",
        minimum=0.0,
        maximum=LONGEST_DELAY_S,
    )
    fail_stop: bool = option(False, "Injected failure: the arm brakes and stays at rest.")
    diagnostics_period_s: float = option(
        1.0, "Period of the diagnostics.", minimum=0.05, maximum=60.0, read_only=True
    )

    def __post_init__(self) -> None:
        check_options(self)
        for name in ("start_pose", "tool_from_sensor", "indenter_pose"):
            pose_of(getattr(self, name), name)
        frames = (self.base_frame, self.tool_frame, self.sensor_frame)
        if "" in frames or len(set(frames)) < 3:
            raise ValueError(
                f"base_frame, tool_frame and sensor_frame are {frames}: they must differ and must "
                "not be empty"
            )

    def limits(self) -> ArmLimits:
        """Return what the tool may do."""
        return ArmLimits(
            linear_m_s=self.speed_limit_m_s,
            angular_rad_s=self.angular_speed_limit_rad_s,
            linear_m_s2=self.acceleration_limit_m_s2,
            angular_rad_s2=self.angular_acceleration_limit_rad_s2,
        )

    def response(self) -> ArmResponse:
        """Return how the arm answers a command."""
        return ArmResponse(
            latency_s=self.latency_s,
            jitter_s=self.jitter_s,
            time_constant_s=self.time_constant_s,
            stale_s=self.stale_s,
        )

    def faults(self) -> ArmFaults:
        """Return what shall fail."""
        return ArmFaults(
            drops_feedback=self.fail_drop_feedback,
            delay_s=self.fail_delay_s,
            is_stopped=self.fail_stop,
        )


def pose_of(numbers: tuple[float, ...], name: str) -> Pose:
    """Return the pose of x, y, z and a quaternion x, y, z, w.

    Raises:
        ValueError: another count of numbers, or a quaternion that is not of unit length.
    """
    if len(numbers) != 7:
        raise ValueError(
            f"{name} needs 7 numbers, x, y, z and the quaternion x, y, z, w; got {len(numbers)}"
        )
    try:
        return Pose(np.array(numbers[:3]), np.array(numbers[3:]))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
