# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""geometry_msgs of rigid bodies: poses, twists and wrenches as vectors.

Other lengths, numbers that are not finite and quaternions that are not of unit length are refused
by ValueError, both ways.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msg_adapters.checks import finite_vector, unit_quaternion
from msg_adapters.stamps import encode_header
from msg_adapters.types import ROS, Message, MessageTypes

GAZEBO_LINK = 3
"""ros_gz_interfaces/Entity.LINK."""

Vectors = tuple[NDArray[np.float64], NDArray[np.float64]]


def _encode_vector3(values: NDArray[np.float64], types: MessageTypes) -> Message:
    x, y, z = values.tolist()
    return types.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _decode_vector3(vector: Message, name: str) -> NDArray[np.float64]:
    return finite_vector((vector.x, vector.y, vector.z), 3, name)


def encode_pose_stamped(
    position_m: ArrayLike,
    quaternion_xyzw: ArrayLike,
    *,
    stamp_ns: int,
    frame_id: str,
    types: MessageTypes = ROS,
) -> Message:
    """Return a geometry_msgs/PoseStamped of a (3,) position and a (4,) unit quaternion."""
    x, y, z = finite_vector(position_m, 3, "position").tolist()
    qx, qy, qz, qw = unit_quaternion(quaternion_xyzw, "quaternion").tolist()
    pose = types.make(
        "geometry_msgs/msg/Pose",
        position=types.make("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=types.make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
    )
    header = encode_header(stamp_ns, frame_id, types=types)
    return types.make("geometry_msgs/msg/PoseStamped", header=header, pose=pose)


def decode_pose_stamped(message: Message) -> Vectors:
    """Return the (3,) position in metres and (4,) quaternion x, y, z, w of a PoseStamped."""
    point, rotation = message.pose.position, message.pose.orientation
    position = finite_vector((point.x, point.y, point.z), 3, "position")
    components = (rotation.x, rotation.y, rotation.z, rotation.w)
    return position, unit_quaternion(components, "quaternion")


def decode_transform(message: Message) -> Vectors:
    """Return the (3,) translation (m) and (4,) quaternion x, y, z, w of a TransformStamped."""
    rotation = message.transform.rotation
    translation = _decode_vector3(message.transform.translation, "translation")
    components = (rotation.x, rotation.y, rotation.z, rotation.w)
    return translation, unit_quaternion(components, "quaternion")


def decode_odometry(message: Message) -> tuple[Vectors, Vectors]:
    """Return the pose of a nav_msgs/Odometry, as `decode_pose_stamped` does, in the frame of its
    header, and the velocities, as `decode_twist` does, along the axes of its `child_frame_id`."""
    return decode_pose_stamped(message.pose), decode_twist(message.twist.twist)


def encode_twist(
    linear_m_s: ArrayLike, angular_rad_s: ArrayLike, *, types: MessageTypes = ROS
) -> Message:
    """Return a geometry_msgs/Twist of two (3,) velocities."""
    return types.make(
        "geometry_msgs/msg/Twist",
        linear=_encode_vector3(finite_vector(linear_m_s, 3, "linear velocity"), types),
        angular=_encode_vector3(finite_vector(angular_rad_s, 3, "angular velocity"), types),
    )


def decode_twist(message: Message) -> Vectors:
    """Return the (3,) linear (m/s) and (3,) angular (rad/s) velocity of a Twist."""
    return (
        _decode_vector3(message.linear, "linear velocity"),
        _decode_vector3(message.angular, "angular velocity"),
    )


def encode_twist_stamped(
    linear_m_s: ArrayLike,
    angular_rad_s: ArrayLike,
    *,
    stamp_ns: int,
    frame_id: str,
    types: MessageTypes = ROS,
) -> Message:
    """Return a geometry_msgs/TwistStamped; see `encode_twist`."""
    return types.make(
        "geometry_msgs/msg/TwistStamped",
        header=encode_header(stamp_ns, frame_id, types=types),
        twist=encode_twist(linear_m_s, angular_rad_s, types=types),
    )


def decode_twist_stamped(message: Message) -> Vectors:
    """Return the velocities of a TwistStamped; see `decode_twist`."""
    return decode_twist(message.twist)


def _encode_wrench(force_n: ArrayLike, torque_nm: ArrayLike, types: MessageTypes) -> Message:
    return types.make(
        "geometry_msgs/msg/Wrench",
        force=_encode_vector3(finite_vector(force_n, 3, "force"), types),
        torque=_encode_vector3(finite_vector(torque_nm, 3, "torque"), types),
    )


def encode_wrench_stamped(
    force_n: ArrayLike,
    torque_nm: ArrayLike,
    *,
    stamp_ns: int,
    frame_id: str,
    types: MessageTypes = ROS,
) -> Message:
    """Return a geometry_msgs/WrenchStamped of a (3,) force and a (3,) torque."""
    header = encode_header(stamp_ns, frame_id, types=types)
    wrench = _encode_wrench(force_n, torque_nm, types)
    return types.make("geometry_msgs/msg/WrenchStamped", header=header, wrench=wrench)


def decode_wrench_stamped(message: Message) -> Vectors:
    """Return the (3,) force (N) and (3,) torque (N m) of a WrenchStamped."""
    return (
        _decode_vector3(message.wrench.force, "force"),
        _decode_vector3(message.wrench.torque, "torque"),
    )


def encode_entity_wrench(
    force_n: ArrayLike,
    torque_nm: ArrayLike,
    *,
    link: str,
    stamp_ns: int,
    frame_id: str,
    types: MessageTypes = ROS,
) -> Message:
    """Return a ros_gz_interfaces/EntityWrench on a link of Gazebo's.

    Gazebo's ApplyLinkWrench takes the force (3,) and the torque (3,) along the axes of its world,
    and lets the force act at the link's centre of mass.

    Raises:
        ValueError: wrong lengths, or numbers that are not finite.
        ImportError: ros_gz_interfaces is not installed.
    """
    return types.make(
        "ros_gz_interfaces/msg/EntityWrench",
        header=encode_header(stamp_ns, frame_id, types=types),
        entity=types.make("ros_gz_interfaces/msg/Entity", id=0, name=link, type=GAZEBO_LINK),
        wrench=_encode_wrench(force_n, torque_nm, types),
    )
