# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Print the force and the size of the image of each frame of a running `tactile_sim`.

python examples/ros_subscriber.py
"""

import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image

from msg_adapters import decode_rgb


class Subscriber(Node):
    def __init__(self) -> None:
        super().__init__("subscriber")
        self.image, self.wrench = Image(), WrenchStamped()
        self.create_subscription(Image, "image_raw", self.on_message, 5)
        self.create_subscription(WrenchStamped, "wrench", self.on_message, 5)

    def on_message(self, message: Image | WrenchStamped) -> None:
        if isinstance(message, Image):
            self.image = message
        else:
            self.wrench = message
        # All messages of one frame carry the same stamp.
        if self.image.header.stamp == self.wrench.header.stamp:
            force, pixels = self.wrench.wrench.force, decode_rgb(self.image)
            print(f"{force.x:.3f} {force.y:.3f} {force.z:.3f} N, image {pixels.shape}", flush=True)


rclpy.init()
try:
    rclpy.spin(Subscriber())
except (KeyboardInterrupt, ExternalShutdownException):
    rclpy.try_shutdown()
