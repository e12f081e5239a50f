# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Move the indenter of a running `tactile_sim` until it presses with a force, and keep that force.

python examples/ros_controller.py --ros-args -p force_n:=1.5
"""

import rclpy
from geometry_msgs.msg import TwistStamped, WrenchStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

GAIN_M_S_N = 0.003
FASTEST_M_S = 0.008


class ForceController(Node):
    """Answers each wrench with a velocity of the indenter along the sensor's axis."""

    def __init__(self) -> None:
        super().__init__("force_controller")
        self.force_n = self.declare_parameter("force_n", 1.0).value
        self.twist = self.create_publisher(TwistStamped, "indenter/twist", 5)
        self.create_subscription(WrenchStamped, "wrench", self.on_wrench, 5)

    def on_wrench(self, message: WrenchStamped) -> None:
        too_much_n = message.wrench.force.z - self.force_n
        speed_m_s = min(FASTEST_M_S, max(-FASTEST_M_S, GAIN_M_S_N * too_much_n))
        answer = TwistStamped()
        answer.header.stamp = self.get_clock().now().to_msg()
        answer.header.frame_id = message.header.frame_id
        answer.twist.linear.z = speed_m_s
        self.twist.publish(answer)


rclpy.init()
try:
    rclpy.spin(ForceController())
except (KeyboardInterrupt, ExternalShutdownException):
    rclpy.try_shutdown()
