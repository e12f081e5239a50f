# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A user's program that leads an arm: velocities out, poses in, all kept with their arrival."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, TwistStamped
from harness import Watcher
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

import msg_adapters

TOPICS: dict[str, type] = {
    "ee_pose": PoseStamped,
    "ee_twist": TwistStamped,
    "joint_states": JointState,
    "indenter/pose": PoseStamped,
}


class ArmClient(Watcher):
    """Leads the arm of a node and records what comes.

    Args:
        node_name: whose services and parameters are called.
        topics: what to read.
    """

    def __init__(self, node_name: str, topics: dict[str, type] = TOPICS) -> None:
        super().__init__("arm_client")
        self._node_name = node_name
        self._lock = threading.Lock()
        self.heard: dict[str, list[tuple[float, Any]]] = {topic: [] for topic in topics}
        self.commands = self.node.create_publisher(TwistStamped, "cmd_vel", 1)
        for topic, kind in topics.items():
            self.node.create_subscription(kind, topic, self._collector(topic), 50)

    def meet(self) -> None:
        """Wait until the arm hears and is heard."""
        self.wait(lambda: self.commands.get_subscription_count() > 0, "a reader of cmd_vel")
        for topic in self.heard:
            self.wait(lambda topic=topic: self.heard[topic], topic)

    def send(
        self,
        linear_m_s: Sequence[float],
        angular_rad_s: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        frame_id: str = "link_base",
    ) -> float:
        """Publish a velocity as it is given, valid or not; return when."""
        message = TwistStamped()
        message.header.frame_id = frame_id
        message.header.stamp = self.node.get_clock().now().to_msg()
        linear, angular = message.twist.linear, message.twist.angular
        linear.x, linear.y, linear.z = map(float, linear_m_s)
        angular.x, angular.y, angular.z = map(float, angular_rad_s)
        self.commands.publish(message)
        return time.monotonic()

    def lead(
        self,
        duration_s: float,
        velocity: Callable[[float], tuple[Sequence[float], Sequence[float]]],
        *,
        frame_id: str = "link_base",
        rate_hz: float = 50.0,
    ) -> float:
        """Send velocities of the time since the start; return when the last one was sent."""
        begin_s = last_s = time.monotonic()
        index = 0
        while (now_s := time.monotonic()) - begin_s < duration_s:
            last_s = self.send(*velocity(now_s - begin_s), frame_id=frame_id)
            index += 1
            time.sleep(max(0.0, begin_s + index / rate_hz - time.monotonic()))
        return last_s

    def newest(self, topic: str, after_s: float = -np.inf) -> Any:
        """Return the newest message of a topic, of those that come after a time."""
        return self.wait(
            lambda: (found := self.heard[topic]) and found[-1][0] > after_s and found[-1][1],
            topic,
        )

    def position_m(self) -> np.ndarray[Any, Any]:
        """Return where the tool is, by a pose that is sent from now on."""
        since_s, since_ns = time.monotonic(), self.now_ns()
        found = self.wait(
            lambda: list(self.positions(since_s, sent_after_ns=since_ns)[1]), "a pose of now"
        )
        return found[-1]

    def positions(
        self, since_s: float = -np.inf, *, sent_after_ns: float = 0, sent_before_ns: float = np.inf
    ) -> tuple[np.ndarray[Any, Any], ...]:
        """Return the stamps (N,) in seconds and positions (N, 3) of the poses heard since a time,
        of those that were sent between two others."""
        with self._lock:
            heard = [message for arrival_s, message in self.heard["ee_pose"] if arrival_s > since_s]
        found = [
            each
            for each in heard
            if sent_after_ns < msg_adapters.message_stamp_ns(each) < sent_before_ns
        ]
        stamps = np.array([msg_adapters.message_stamp_ns(message) for message in found])
        places = np.array([msg_adapters.decode_pose_stamped(message)[0] for message in found])
        return 1e-9 * (stamps - stamps[:1]), places

    def count(self, topic: str) -> int:
        """Return how many messages of a topic have come."""
        with self._lock:
            return len(self.heard[topic])

    def state(self, part: str, is_wanted: Callable[[msg_adapters.Status], bool]) -> Any:
        """Wait for a diagnostic of a part of the node that is wanted."""
        name = f"{self._node_name}: {part}"
        return self.wait(
            lambda: (found := self.diagnostics.get(name)) and is_wanted(found) and found,
            f"a state of {part}",
        )

    def trigger(self, name: str) -> Any:
        """Call a service of the node without arguments."""
        return self.call(Trigger, f"/{self._node_name}/{name}")

    def set_parameters(self, **values: Any) -> Any:
        """Set parameters of the node together; return the result with its reason."""
        return self.set_parameters_of(f"/{self._node_name}", **values)

    def _collector(self, topic: str) -> Callable[[Any], None]:
        def collect(message: Any) -> None:
            with self._lock:
                self.heard[topic].append((time.monotonic(), message))

        return collect
