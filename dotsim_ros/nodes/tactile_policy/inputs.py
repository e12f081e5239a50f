# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `tactile_policy` receives: images, the arm's pose, the force; the newest and its age."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition, Lock
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image

import msg_adapters
from dotsim_ros.control.arm.command import check_reach
from dotsim_ros.control.safety_layer.arm_control import BASE_FRAME
from dotsim_ros.control.safety_layer.freshness import HeardMessage, StreamWatch
from dotsim_ros.control.safety_layer.limits import Readings, Reason
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.documents import value_text
from dotsim_ros.nodes.common.counters import milliseconds
from dotsim_ros.nodes.common.health import Report
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.reasons import reason_of
from dotsim_ros.nodes.tactile_policy.parameters import RAW, TactilePolicyParameters
from msg_adapters import Level

# Best effort loses images between processes; of several that wait, only the newest counts.
IMAGE_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
STATE_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)

NO_FORCE_LIMIT = "force_limit_n is 0: nothing limits the force"
NO_FORCE = (
    "no force has come on the topic wrench: the arm does not move without; for a sensor that "
    "measures none set force_limit_n to 0"
)


@dataclass(frozen=True)
class HeardImage:
    """An Image or CompressedImage, its stamp, and when it came by the time of the node."""

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

    A message is checked as a whole before any of it counts: what is refused leaves no trace but the
    count, and the stream grows old.

    Args:
        latch: takes a fault that stops the arm for good: reason and words.

    Attributes:
        hears_force: whether a force is expected, without which the arm does not move.
    """

    def __init__(
        self,
        node: WorkingNode,
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
        # A message's content and that it is fresh become known together.
        self._lock = Lock()
        self._tool: Pose | None = None
        self._force_n = 0.0
        self._wrench_frame: str | None = None
        self._refusal_logged_s = -np.inf
        subscriptions = [
            self._subscribe(Image, "image_raw", self._on_image, IMAGE_QOS)
            if parameters.image_transport == RAW
            else self._subscribe(
                CompressedImage, "image_raw/compressed", self._on_image, IMAGE_QOS
            ),
            self._subscribe(PoseStamped, "ee_pose", self._on_pose, STATE_QOS),
        ]
        self.hears_force = parameters.limits.force_limit_n > 0.0
        if self.hears_force:
            subscriptions.append(
                self._subscribe(WrenchStamped, "wrench", self._on_wrench, STATE_QOS)
            )
        self.topics = [str(subscription.topic_name) for subscription in subscriptions]

    def readings(self, now_s: float) -> Readings:
        """Return what is known at a time."""
        with self._lock:
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

    def image_after(self, last: HeardImage | None, until_s: float) -> HeardImage | None:
        """Wait for an image that is not `last`; None where none comes in time.

        In simulated time nothing comes while anybody waits.
        """
        left_s = 0.0 if self._node.is_simulated else max(0.0, until_s - self._node.now_s())
        with self._came:
            self._came.wait_for(lambda: self._image is not last, left_s)
            return None if self._image is last else self._image

    def report(self, now_s: float) -> Report:
        """Return the state of the inputs, for the diagnostics."""
        values: dict[str, str] = {}
        for watch in (self.image, self.pose, self.force):
            reading = watch.reading(now_s)
            values |= {
                f"{watch.name}_count": str(watch.count),
                f"{watch.name}_repeated": str(watch.repeated),
                f"{watch.name}_age_ms": milliseconds(reading.age_s),
                f"{watch.name}_delay_ms": milliseconds(reading.delay_s),
            }
        values["refused"] = str(self.refused)
        if not self.hears_force:
            return Level.OK, f"listening; {NO_FORCE_LIMIT}", values
        if not self.force.count:
            return Level.WARN, NO_FORCE, values
        return Level.OK, "listening", values

    def refuse(self, what: str, error: ValueError) -> None:
        """Count and log a message that cannot be used."""
        self.refused += 1
        now_s = self._node.now_s()
        if now_s - self._refusal_logged_s > 1.0:
            self._refusal_logged_s = now_s
            self._node.get_logger().warning(f"{what} refused: {reason_of(error)}")

    def _subscribe(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos: QoSProfile
    ) -> Any:
        def hear(message: Any) -> None:
            try:
                callback(message)
            except ValueError as error:
                self.refuse(topic, error)

        return self._node.open_subscription(kind, topic, hear, qos)

    def _stamp_ns(self, message: Any) -> int:
        stamp_ns = msg_adapters.message_stamp_ns(message)
        if stamp_ns == 0:
            raise ValueError("its stamp is 0, expected the time that it was taken at")
        return stamp_ns

    def _take(
        self, watch: StreamWatch, stamp_ns: int, arrival_s: float, keep: Callable[[], None]
    ) -> None:
        """Let a message that was checked count, if it holds anything new: `keep` latches where its
        content does not go with what came before, then keeps it."""
        clock_ns = self._node.time_ns()
        with self._lock:
            heard, why = watch.hear(stamp_ns, arrival_s=arrival_s, clock_ns=clock_ns)
            if heard is HeardMessage.JUMPED:
                self._latch(Reason.CLOCK_JUMP, why)
            if heard is not HeardMessage.NOTHING_NEW:
                keep()

    def _on_image(self, message: Any) -> None:
        arrival_s = self._node.now_s()
        image = HeardImage(message, self._stamp_ns(message), arrival_s)
        # It costs nothing to look, and what cannot be read must not count as fresh.
        if isinstance(message, Image):
            msg_adapters.decode_rgb(message)
        else:
            msg_adapters.compressed_image_size(message)

        def keep() -> None:
            if self._image is not None:
                before = self._image.message.header.frame_id
                self._check_frame("images", before, message.header.frame_id)
            with self._came:
                self._image = image
                self._came.notify_all()

        self._take(self.image, image.stamp_ns, arrival_s, keep)

    def _on_pose(self, message: PoseStamped) -> None:
        stamp_ns, frame = self._stamp_ns(message), message.header.frame_id
        if frame != BASE_FRAME:
            raise ValueError(
                f"its frame is {value_text(frame)}, expected {BASE_FRAME!r}: transform the tool's "
                "pose into the arm's base"
            )
        tool = Pose(*msg_adapters.decode_pose_stamped(message))
        check_reach(tool.position_m)

        def keep() -> None:
            self._tool = tool

        self._take(self.pose, stamp_ns, self._node.now_s(), keep)

    def _on_wrench(self, message: WrenchStamped) -> None:
        stamp_ns = self._stamp_ns(message)
        force, _ = msg_adapters.decode_wrench_stamped(message)
        force_n, frame = math.hypot(*force), message.header.frame_id

        def keep() -> None:
            if self._wrench_frame is not None:
                self._check_frame("forces", self._wrench_frame, frame)
            self._force_n, self._wrench_frame = force_n, frame

        self._take(self.force, stamp_ns, self._node.now_s(), keep)

    def _check_frame(self, what: str, before: str, frame: str) -> None:
        if frame != before:
            self._latch(
                Reason.WRONG_SENSOR,
                f"the {what}' frame changes from {value_text(before)} to {value_text(frame)}",
            )
