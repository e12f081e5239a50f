# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A fixed transform on /tf_static, where tf2 is installed."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from dotsim_ros.geometry.pose import Pose


def publish_static_frame(node: Node, pose: Pose, *, parent: str, child: str) -> Any | None:
    """Publish the pose of a child frame in its parent, once, kept for late readers.

    Returns:
        The broadcaster, to be kept alive; None where tf2_ros is not installed.
    """
    try:
        from tf2_ros import StaticTransformBroadcaster
    except ImportError:
        node.get_logger().info("tf2_ros is not installed: no transform on /tf_static")
        return None
    message = TransformStamped()
    message.header.stamp = node.get_clock().now().to_msg()
    message.header.frame_id, message.child_frame_id = parent, child
    x, y, z = pose.position_m.tolist()
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = x, y, z
    rotation.x, rotation.y, rotation.z, rotation.w = pose.quaternion_xyzw.tolist()
    broadcaster = StaticTransformBroadcaster(node)
    broadcaster.sendTransform(message)
    return broadcaster
