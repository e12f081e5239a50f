# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `xarm_sim`. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from dotsim_ros.control.arm.command import ToolLimits
from dotsim_ros.control.arm.simulated import ArmFaults, ArmResponse
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.parameters import FREE, READ_ONLY


@dataclass(frozen=True)
class XarmSimParameters:
    """Parameters of `xarm_sim`; each field says what it is.

    The greatest speeds and accelerations are by default those that UFACTORY states for the tool of
    its arms and, for its turning, those of a joint (180 degrees/s, 1146 degrees/s^2).

    Raises:
        ValueError: a value out of its range, a pose that is none, or frames that are the same.
    """

    FIXED: ClassVar[str] = READ_ONLY

    response: ArmResponse = field(default=ArmResponse())
    faults: ArmFaults = field(default=ArmFaults())

    rate_hz: float = quantity(100.0, low=1.0, high=200.0)
    """Rate of the feedback; the arm's driver publishes at 100 Hz with report_type dev."""
    base_frame: str = quantity("link_base")
    """Frame of the poses and of velocities."""
    tool_frame: str = quantity("link_tcp")
    """A velocity stamped with this frame is taken along the tool's axes."""
    sensor_frame: str = quantity("densetact_base")
    """Frame of indenter/pose: the base of the sensor."""
    start_pose: tuple[float, ...] = quantity(
        (0.35, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0), low=-10.0, high=10.0
    )
    """Pose of the tool in the base at the start and after ~/reset: x, y, z in metres, then the
    quaternion x, y, z, w. The default points down."""
    tool_from_sensor: tuple[float, ...] = quantity(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), low=-10.0, high=10.0
    )
    """Pose of the sensor's base in the tool's frame, numbers as in start_pose."""
    indenter_pose: tuple[float, ...] = quantity(
        (0.35, 0.0, 0.28, 1.0, 0.0, 0.0, 0.0), low=-10.0, high=10.0, fixed=FREE
    )
    """Pose in the base of a fixed indenter that the sensor is moved against, numbers as in
    start_pose; its +z points away from the gel. The default is 4.25 mm before the dome."""
    publish_indenter: bool = quantity(True, fixed=FREE)
    """Publish indenter/pose, which moves the indenter of tactile_sim."""
    seed: int = quantity(0, low=0, high=2**31 - 1)
    """Seed of the jitter."""
    speed_limit_m_s: float = quantity(1.0, low=0.001, high=1.0)
    """Speed limit of the tool."""
    angular_speed_limit_rad_s: float = quantity(3.14, low=0.001, high=10.0)
    """Limit of the tool's angular speed."""
    acceleration_limit_m_s2: float = quantity(50.0, low=0.01, high=50.0)
    """Limit of the tool's linear acceleration."""
    angular_acceleration_limit_rad_s2: float = quantity(20.0, low=0.01, high=200.0)
    """Limit of the tool's angular acceleration."""
    joint_speed_limit_rad_s: float = quantity(4.0, low=0.01, high=10.0)
    """Speed limit of each joint; where one would exceed it, all are scaled down alike. UFACTORY
    allows 3.14."""
    diagnostics_period_s: float = quantity(1.0, low=0.05, high=60.0)
    """Period of the diagnostics."""

    def __post_init__(self) -> None:
        check_fields("", self)
        for name in ("start_pose", "tool_from_sensor", "indenter_pose"):
            self.pose(name)
        frames = (self.base_frame, self.tool_frame, self.sensor_frame)
        if "" in frames or len(set(frames)) < 3:
            raise ValueError(
                f"base_frame, tool_frame and sensor_frame are {frames}: they must differ and must "
                "not be empty"
            )

    @property
    def tool(self) -> ToolLimits:
        """What the tool may do, whatever it is commanded."""
        return ToolLimits(
            self.speed_limit_m_s,
            self.angular_speed_limit_rad_s,
            self.acceleration_limit_m_s2,
            self.angular_acceleration_limit_rad_s2,
        )

    def pose(self, name: str) -> Pose:
        """Return the pose that a parameter gives as x, y, z and a quaternion x, y, z, w.

        Raises:
            ValueError: the quaternion is not of unit length.
        """
        numbers = np.array(getattr(self, name))
        try:
            return Pose(numbers[:3], numbers[3:])
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
