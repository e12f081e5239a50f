# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node's part in the steps: it holds back what it hears, and goes on when it is told to.

Between two steps nothing is done, so what a node does depends on what was sent up to the step
before, in an order of its own, and not on when it came.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_msgs.msg import String

from dotsim_ros.nodes.simulated_time.protocol import (
    ANSWER_TOPIC,
    PROTOCOL_QOS,
    STEP_TOPIC,
    Answer,
    Kind,
    Sent,
    Step,
    decode_step,
    encode,
)
from msg_adapters import serialized_stamp_ns

Hear = Callable[[], None]


class StepParticipant:
    """Answers the stepper for a node.

    Args:
        node: whose subscriptions and publishers are given to `hold` and `watch`.
        go: takes the node to a time (ns).
    """

    def __init__(self, node: Node, go: Callable[[int], None]) -> None:
        self._node, self._go = node, go
        self._life = uuid.uuid4().hex
        self._name = node.get_fully_qualified_name()
        self._publishers: dict[str, Any] = {}
        self._told: dict[str, int] = {}
        self._subscriptions: dict[str, Any] = {}
        self._newest: dict[str, int] = {}
        self._sent: dict[str, Sent] = {}
        self._held: list[tuple[int, str, int, Hear]] = []
        self._step: Step | None = None
        # Not the node's own methods: what the stepper says is not held back.
        self._answers = Node.create_publisher(node, String, ANSWER_TOPIC, PROTOCOL_QOS)
        Node.create_subscription(node, String, STEP_TOPIC, self._on_step, PROTOCOL_QOS)

    def watch(self, publisher: Any) -> None:
        """Report to the stepper how many messages (`sent`) a `LocalPublisher` has sent."""
        self._publishers[publisher.topic_name] = publisher

    def read(self, subscription: Any) -> None:
        """Wait, before each step, for what was sent on the topic of this subscription."""
        self._subscriptions[subscription.topic_name] = subscription

    def restart(self) -> None:
        """Take part as a node that has just started, without publishers and subscriptions: those
        so far are destroyed, and the numbers of others of their topics begin again."""
        self._life = uuid.uuid4().hex
        for known in (self._publishers, self._told, self._subscriptions, self._newest, self._sent):
            known.clear()
        self._held.clear()

    def hold(self, topic: str, number: int | None, stamp_ns: int, hear: Hear) -> None:
        """Keep a message until the next step.

        Args:
            number: of the message among those of its publisher, from 1.

        Raises:
            ValueError: the middleware does not number messages.
        """
        if number is None:
            raise ValueError(
                "the middleware does not number its messages, which steps of simulated time need: "
                "set RMW_IMPLEMENTATION=rmw_fastrtps_cpp"
            )
        self._newest[topic] = max(number, self._newest.get(topic, 0))
        self._held.append((stamp_ns, topic, number, hear))
        self._take_step()

    def _on_step(self, message: Any) -> None:
        try:
            step = decode_step(message)
        except ValueError as error:
            self._node.get_logger().warning(f"a message on {STEP_TOPIC} is left out: {error}")
            return
        if step.kind is Kind.CALL:
            self._answer_call(step.time_ns)
            return
        self._step = step
        for topic, sent in step.sent.items():
            # What a publisher sent before both knew each other need not come, and the numbers of
            # one that has started again begin again.
            before = self._sent.get(topic)
            if before is None or before.publisher != sent.publisher:
                early = [number for _, held, number, _ in self._held if held == topic]
                self._newest[topic] = max(sent.total, *early, 0)
            self._sent[topic] = sent
        self._take_step()

    def _take_step(self) -> None:
        step = self._step
        if step is None or self._waits():
            return
        self._step = None
        for hear in self._due():
            hear()
        self._go(step.time_ns)
        self._answers.publish(
            encode(Answer(step.time_ns, Kind.DONE, self._name, self._life, self._changed()))
        )

    def _waits(self) -> str:
        """Return what was sent before the step and has not come, in words; empty for nothing."""
        for topic, sent in self._step.sent.items() if self._step is not None else ():
            newest = self._newest.get(topic, 0)
            if topic in self._subscriptions and newest < sent.total:
                return f"message {sent.total} of {topic}, {newest} came last"
        return ""

    def _due(self) -> list[Hear]:
        """Return what was sent before this step, in order, and keep what others have sent in it."""
        due: list[tuple[int, str, int, Hear]] = []
        early: list[tuple[int, str, int, Hear]] = []
        for each in self._held:
            _, topic, number, _ = each
            sent = self._sent.get(topic)
            (due if sent is None or number <= sent.total else early).append(each)
        self._held = early
        return [each[3] for each in sorted(due, key=lambda each: each[:3])]

    def _changed(self) -> dict[str, int]:
        now = {topic: publisher.sent for topic, publisher in self._publishers.items()}
        changed = {topic: n for topic, n in now.items() if n != self._told.get(topic)}
        self._told = now
        return changed

    def _answer_call(self, time_ns: int) -> None:
        publishers, subscriptions = self._publishers.items(), self._subscriptions.items()
        answer = Answer(
            time_ns,
            Kind.PRESENT,
            self._name,
            self._life,
            sent={topic: each.sent for topic, each in publishers},
            readers={topic: each.get_subscription_count() for topic, each in publishers},
            read={topic: each.get_publisher_count() for topic, each in subscriptions},
            waits=self._waits(),
        )
        self._answers.publish(encode(answer))


def stamp_of(message: Any) -> int:
    """Return the stamp of a message's header (ns), packed or not; 0 where it has none."""
    if isinstance(message, bytes):
        try:
            return serialized_stamp_ns(message)
        except ValueError:
            return 0
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)
