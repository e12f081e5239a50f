"""What `tactile_policy` receives: images, the arm's pose, the force; the newest and its age."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CompressedImage, Image

import msg_adapters
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.tactile_policy.parameters import (
    BASE_FRAME,
    RAW,
    TactilePolicyParameters,
)
from dotsim_ros.tasks.control.freshness import HeardMessage, StreamWatch
from dotsim_ros.tasks.control.safety import Readings, Reason

# Best effort loses images between processes; of several that wait, only the newest counts.
IMAGE_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
STATE_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)


@dataclass(frozen=True)
class HeardImage:
    """An image as it came.

    Attributes:
        message: Image or CompressedImage.
        stamp_ns: its time.
        arrival_s: when it came, on the steady clock.
    """

    message: Any
    stamp_ns: int
    arrival_s: float

    def pixels(self) -> NDArray[np.uint8]:
        """Return (H, W, 3) uint8, red, green, blue, contiguous.

        Raises:
            ValueError: it is no image that can be read.
        """
        if not isinstance(self.message, CompressedImage):
            return np.ascontiguousarray(msg_adapters.decode_rgb(self.message))
        pixels = msg_adapters.decode_compressed_image(self.message)
        if pixels.ndim == 2:
            pixels = np.repeat(pixels[..., None], 3, axis=2)
        return np.ascontiguousarray(pixels)


class PolicyInputs:
    """The subscriptions; messages come on the executor's thread, others read.

    Args:
        node: owns the subscriptions.
        parameters: transport, limits.
        latch: takes a fault that stops the arm for good: reason and words.
    """

    def __init__(
        self,
        node: Node,
        parameters: TactilePolicyParameters,
        *,
        latch: Callable[[Reason, str], None],
    ) -> None:
        self._node = node
        self._latch = latch
        jump_s = parameters.clock_jump_s
        self.image = StreamWatch("image", jump_s=jump_s)
        self.pose = StreamWatch("pose", jump_s=jump_s)
        self.force = StreamWatch("force", jump_s=jump_s)
        self.refused = 0
        self._came = Condition()
        self._image: HeardImage | None = None
        self._tool: Pose | None = None
        self._force_n = 0.0
        self._refusal_logged_s = -np.inf
        subscriptions = [
            self._subscribe(Image, "image_raw", self._on_image, IMAGE_QOS)
            if parameters.image_transport == RAW
            else self._subscribe(
                CompressedImage, "image_raw/compressed", self._on_image, IMAGE_QOS
            ),
            self._subscribe(PoseStamped, "ee_pose", self._on_pose, STATE_QOS),
        ]
        if parameters.force_limit_n > 0.0:
            subscriptions.append(
                self._subscribe(WrenchStamped, "wrench", self._on_wrench, STATE_QOS)
            )
        self.topics = [str(subscription.topic_name) for subscription in subscriptions]

    def readings(self, now_s: float) -> Readings:
        """Return what is known at a time."""
        return Readings(
            now_s=now_s,
            image=self.image.reading(now_s),
            pose=self.pose.reading(now_s),
            force=self.force.reading(now_s),
            tool=self._tool,
            force_n=self._force_n,
        )

    def newest_image(self) -> HeardImage | None:
        """Return the newest image."""
        return self._image

    def image_after(self, last: HeardImage | None, *, until_s: float) -> HeardImage | None:
        """Wait for an image that is not `last`; None where none comes in time."""
        with self._came:
            self._came.wait_for(
                lambda: self._image is not last, max(0.0, until_s - time.monotonic())
            )
            return None if self._image is last else self._image

    def refuse(self, what: str, error: ValueError) -> None:
        """Count and log a message that cannot be used."""
        self.refused += 1
        now_s = time.monotonic()
        if now_s - self._refusal_logged_s > 1.0:
            self._refusal_logged_s = now_s
            self._node.get_logger().warning(f"{what} refused: {error}")

    def _subscribe(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile
    ) -> Any:
        def hear(message: Any) -> None:
            try:
                callback(message)
            except ValueError as error:
                self.refuse(topic, error)

        return self._node.create_subscription(
            kind,
            topic,
            hear,
            qos,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _is_new(self, watch: StreamWatch, message: Any, arrival_s: float) -> bool:
        stamp_ns = msg_adapters.message_stamp_ns(message)
        if stamp_ns == 0:
            raise ValueError("its stamp is 0, expected the time that it was taken at")
        heard, why = watch.hear(
            stamp_ns, arrival_s=arrival_s, clock_ns=self._node.get_clock().now().nanoseconds
        )
        if heard is HeardMessage.JUMPED:
            self._latch(Reason.CLOCK_JUMP, why)
        return heard is not HeardMessage.NOTHING_NEW

    def _on_image(self, message: Any) -> None:
        arrival_s = time.monotonic()
        image = HeardImage(message, msg_adapters.message_stamp_ns(message), arrival_s)
        if isinstance(message, Image):
            # It costs nothing to look, and what cannot be read must not count as fresh.
            msg_adapters.decode_image(message)
        before = self._image
        if not self._is_new(self.image, message, arrival_s):
            return
        if before is not None and before.message.header.frame_id != message.header.frame_id:
            self._latch(
                Reason.WRONG_SENSOR,
                f"the images' frame changes from {before.message.header.frame_id!r} to "
                f"{message.header.frame_id!r}",
            )
        with self._came:
            self._image = image
            self._came.notify_all()

    def _on_pose(self, message: PoseStamped) -> None:
        if message.header.frame_id != BASE_FRAME:
            raise ValueError(
                f"its frame is {message.header.frame_id!r}, expected {BASE_FRAME!r}: transform the "
                "tool's pose into the arm's base"
            )
        # Before it counts as fresh: the control loop may look at any moment.
        self._tool = Pose(*msg_adapters.decode_pose_stamped(message))
        self._is_new(self.pose, message, time.monotonic())

    def _on_wrench(self, message: WrenchStamped) -> None:
        force, _ = msg_adapters.decode_wrench_stamped(message)
        self._force_n = float(np.linalg.norm(force))
        self._is_new(self.force, message, time.monotonic())
