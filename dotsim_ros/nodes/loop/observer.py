# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Receives what a closed loop publishes and calls its services, for programs that judge it.

Messages are kept as they come over the wire, with the times at which the middleware sent them, and
unpacked afterwards: receiving 250 of them a second must not cost the loop a core.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock, Thread
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

import msg_adapters
from dotsim_ros.nodes.common.arguments import prepare_log_folder
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.simulated_time.participant import StepParticipant

LOOP_TOPICS: dict[str, type] = {
    "ee_pose": PoseStamped,
    "ee_twist": TwistStamped,
    "cmd_vel": TwistStamped,
    "wrench": WrenchStamped,
}
# Deep enough for a second in which this process does not get to run.
OBSERVER_QOS = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
PATIENCE_S = 30.0


@dataclass(frozen=True)
class LoopTraffic:
    """A message, unpacked, and when the middleware sent it, by the system clock."""

    message: Any
    sent_ns: int


class LoopObserver:
    """A node next to the loop.

    Args:
        is_stepped: take part in the steps of simulated time: nothing is heard between two.

    Attributes:
        node: the node, for publishers of one's own.
        beside: a second node, which never takes part in steps.
        diagnostics: the newest status of each part of each node, by name.
    """

    def __init__(
        self, topics: Mapping[str, type] = LOOP_TOPICS, *, is_stepped: bool = False
    ) -> None:
        self._context = rclpy.Context()
        prepare_log_folder()
        rclpy.init(context=self._context)
        self.node = WorkingNode("loop_observer", context=self._context)
        if is_stepped:
            self.node.participant = StepParticipant(self.node, lambda time_ns: None)
        self.beside = WorkingNode("loop_stepper", context=self._context)
        self.diagnostics: dict[str, msg_adapters.Status] = {}
        self.diagnostics_ns: dict[str, int] = {}
        self._types = dict(topics)
        self._lock = Lock()
        self._kept: dict[str, list[tuple[bytes, int]]] = {name: [] for name in topics}
        self._clients: dict[str, Any] = {}
        for topic, kind in topics.items():
            self.node.create_subscription(kind, topic, self._keeper(topic), OBSERVER_QOS, raw=True)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 20)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._executor.add_node(self.beside)
        self._thread = Thread(target=self._spin, name="observer", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Leave the graph."""
        rclpy.try_shutdown(context=self._context)
        self._thread.join(PATIENCE_S)
        self.node.destroy_node()
        self.beside.destroy_node()

    def forget(self) -> None:
        """Discard the messages received so far."""
        with self._lock:
            for kept in self._kept.values():
                kept.clear()

    def count(self, topic: str) -> int:
        """Return how many messages of a topic are kept."""
        with self._lock:
            return len(self._kept[topic])

    def heard(self, topic: str, *, last: int | None = None) -> list[LoopTraffic]:
        """Return the messages of a topic that have been received, or the last of them."""
        with self._lock:
            kept = list(self._kept[topic] if last is None else self._kept[topic][-last:])
        kind = self._types[topic]
        return [LoopTraffic(deserialize_message(raw, kind), sent_ns) for raw, sent_ns in kept]

    def wait(
        self, is_reached: Callable[[], Any], what: str, *, timeout_s: float = PATIENCE_S
    ) -> Any:
        """Wait until something holds, and return it.

        Raises:
            OSError: the time is over.
        """
        end_s = time.monotonic() + timeout_s
        while not (reached := is_reached()):
            if time.monotonic() > end_s:
                raise OSError(f"waited {timeout_s:g} s for {what}")
            time.sleep(0.005)
        return reached

    def call(self, kind: type, name: str, **fields: Any) -> Any:
        """Call a service and return its response.

        Raises:
            OSError: it is not available, or no response comes.
        """
        client = self._clients.get(name)
        if client is None:
            client = self._clients[name] = self.node.create_client(kind, name)
        if not client.wait_for_service(PATIENCE_S):
            raise OSError(f"the service {name} is not available")
        future = client.call_async(kind.Request(**fields))  # type: ignore[attr-defined]
        self.wait(future.done, f"an answer of {name}")
        return future.result()

    def values(self, part: str) -> dict[str, str]:
        """Return the newest values of a part of a node, "tactile_policy: control" for one; empty
        where none have come."""
        status = self.diagnostics.get(part)
        return dict(status.values) if status is not None else {}

    def _spin(self) -> None:
        with suppress(ExternalShutdownException):
            self._executor.spin()

    def _keeper(self, topic: str) -> Any:
        """Return a callback; rclpy's types know none that takes the time as well."""
        kept = self._kept[topic]

        def keep(serialized: bytes, info: Any) -> None:
            with self._lock:
                kept.append((serialized, info["source_timestamp"]))

        return keep

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        stamp_ns = msg_adapters.message_stamp_ns(message)
        for status in msg_adapters.decode_diagnostics(message):
            self.diagnostics[status.name] = status
            self.diagnostics_ns[status.name] = stamp_ns
