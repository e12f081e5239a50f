# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""xarm_msgs of UFACTORY's driver (xArm-Developer/xarm_ros2), whose units are mm, mm/s and rad.

The package is not on PyPI: it is looked for only when a message of it is made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msg_adapters.checks import finite_vector
from msg_adapters.types import Message, message_class

MM_PER_M = 1000.0


@dataclass(frozen=True)
class RobotState:
    """An arm as its driver reports it (xarm_msgs/RobotMsg).

    Attributes:
        position_m: (3,) tool centre point in the arm's base.
        quaternion_xyzw: (4,) rotation from the tool to the base.
        joints_rad: one angle a joint.
        state: 1 in motion, 2 ready, 3 paused, 4 stopped, 5 set up again and not ready.
        mode: 5 takes Cartesian velocities.
        error: code of the controller, 0 for none.
        warning: the same of warnings.
    """

    position_m: NDArray[np.float64]
    quaternion_xyzw: NDArray[np.float64]
    joints_rad: NDArray[np.float64]
    state: int
    mode: int
    error: int
    warning: int


def quaternion_of_roll_pitch_yaw(
    roll_rad: float, pitch_rad: float, yaw_rad: float
) -> NDArray[np.float64]:
    """Return the quaternion x, y, z, w of turns about the fixed axes x, then y, then z.

    This is what UFACTORY means by roll, pitch and yaw: R = Rz(yaw) Ry(pitch) Rx(roll) (xArm user
    manual, "RPY").
    """
    cr, cp, cy = np.cos(0.5 * np.array([roll_rad, pitch_rad, yaw_rad]))
    sr, sp, sy = np.sin(0.5 * np.array([roll_rad, pitch_rad, yaw_rad]))
    return np.array(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ]
    )


def decode_robot_state(message: Message) -> RobotState:
    """Return the state in a xarm_msgs/RobotMsg.

    Raises:
        ValueError: a number of the pose or of a joint is not finite.
    """
    pose = finite_vector(message.pose, 6, "pose of the arm")
    angles = np.array(message.angle, dtype=np.float64)
    return RobotState(
        position_m=pose[:3] / MM_PER_M,
        quaternion_xyzw=quaternion_of_roll_pitch_yaw(*pose[3:].tolist()),
        joints_rad=finite_vector(angles, len(angles), "joint angles of the arm"),
        state=int(message.state),
        mode=int(message.mode),
        error=int(message.err),
        warning=int(message.warn),
    )


def move_velocity_service() -> type:
    """Return the class xarm_msgs/srv/MoveVelocity.

    Raises:
        ImportError: xarm_msgs is not installed.
    """
    service: type = message_class("xarm_msgs/srv/MoveVelocity")
    return service


def robot_state_message() -> type:
    """Return the class xarm_msgs/msg/RobotMsg.

    Raises:
        ImportError: xarm_msgs is not installed.
    """
    message: type = message_class("xarm_msgs/msg/RobotMsg")
    return message


def encode_move_velocity(
    linear_m_s: ArrayLike, angular_rad_s: ArrayLike, *, along_tool: bool, duration_s: float
) -> Message:
    """Return a request of xarm_msgs/srv/MoveVelocity for `vc_set_cartesian_velocity`.

    Args:
        linear_m_s: (3,) velocity of the tool centre point.
        angular_rad_s: (3,) axis times rate.
        along_tool: the axes of both are those of the tool, else those of the base.
        duration_s: after this time without another call the arm stops.

    Raises:
        ValueError: wrong lengths, numbers that are not finite, or a duration that is not above 0:
            to the driver that means for ever.
        ImportError: xarm_msgs is not installed.
    """
    linear = finite_vector(linear_m_s, 3, "linear velocity") * MM_PER_M
    angular = finite_vector(angular_rad_s, 3, "angular velocity")
    if not (np.isfinite(duration_s) and duration_s > 0.0):
        raise ValueError(
            f"the duration is {duration_s} s, expected more than 0: at 0 or below the arm would "
            "keep the velocity for ever"
        )
    request: type = move_velocity_service().Request  # type: ignore[attr-defined]
    return request(
        speeds=[*linear.tolist(), *angular.tolist()],
        is_sync=True,
        is_tool_coord=along_tool,
        duration=float(duration_s),
    )
