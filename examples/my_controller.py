# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Follow a path by touch, as long as the arm's pose is fresh: python examples/my_controller.py"""

import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image

import msg_adapters
from dotsim_ros import TactileSensor
from dotsim_ros.control.policy.network import load_policy
from dotsim_ros.nodes.tactile_policy.files import policy_folder


class MyController(Node):
    def __init__(self) -> None:
        super().__init__("my_controller")
        self.policy = load_policy(policy_folder("densetact2_sphere"), "line")
        self.idle, self.pose_ns = TactileSensor.load("densetact2").idle_image, 0
        self.commands = self.create_publisher(TwistStamped, "cmd_vel", 5)
        self.create_subscription(PoseStamped, "ee_pose", self.on_pose, 5)
        self.create_subscription(Image, "image_raw", self.on_image, 5)

    def on_pose(self, message: PoseStamped) -> None:
        self.pose_ns = msg_adapters.message_stamp_ns(message)

    def on_image(self, message: Image) -> None:
        stamp_ns = msg_adapters.message_stamp_ns(message)
        twist = self.policy(msg_adapters.decode_rgb(message), self.idle)
        twist *= stamp_ns - self.pose_ns < 100_000_000
        answer = {"stamp_ns": stamp_ns, "frame_id": "link_tcp"}
        self.commands.publish(msg_adapters.encode_twist_stamped(twist[:3], twist[3:], **answer))


rclpy.init()
try:
    rclpy.spin(MyController())
except (KeyboardInterrupt, ExternalShutdownException):
    rclpy.try_shutdown()
