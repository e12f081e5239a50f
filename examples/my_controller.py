"""Follow a path by touch: a ROS 2 node that answers each image with a velocity of the tool.

It reads image_raw and ee_pose, writes cmd_vel, and stands still while the arm's pose is old.
test_my_controller.py tests it in simulated time.
"""

import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import Image

import msg_adapters
from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.nodes.tactile_policy.files import policy_folder
from dotsim_ros.optics.pattern import idle_frame_of
from dotsim_ros.specification import load_sensor
from dotsim_ros.tasks.policy.network import load_policy

OLDEST_POSE_NS = 100_000_000


class MyController(Node):
    """Asks a policy, as long as it knows where the arm is."""

    def __init__(self) -> None:
        super().__init__("my_controller")
        sensor = load_sensor("densetact2")
        self.idle = idle_frame_of(sensor, FisheyeCamera.from_specification(sensor.camera)).image
        self.policy = load_policy(policy_folder("densetact2_sphere"), "line")
        self.pose_ns = 0
        self.commands = self.create_publisher(TwistStamped, "cmd_vel", 5)
        self.create_subscription(PoseStamped, "ee_pose", self.on_pose, 5)
        self.create_subscription(Image, "image_raw", self.on_image, 5)

    def on_pose(self, message: PoseStamped) -> None:
        self.pose_ns = msg_adapters.message_stamp_ns(message)

    def on_image(self, message: Image) -> None:
        twist = self.policy(msg_adapters.decode_rgb(message), self.idle)
        if msg_adapters.message_stamp_ns(message) - self.pose_ns > OLDEST_POSE_NS:
            twist *= 0.0
        stamp_ns = self.get_clock().now().nanoseconds
        self.commands.publish(
            msg_adapters.encode_twist_stamped(
                twist[:3], twist[3:], stamp_ns=stamp_ns, frame_id="link_tcp"
            )
        )


if __name__ == "__main__":
    rclpy.init()
    try:
        rclpy.spin(MyController())
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()
