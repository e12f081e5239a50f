# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Topics between nodes of one process: messages are handed over as they are, without DDS.

Whoever is in another process sees the same topics: publishers send over DDS as well where somebody
outside reads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rclpy.publisher import Publisher
from rclpy.qos import HistoryPolicy, QoSProfile

Information = dict[str, int | None]
"""What is known of a message next to it, as ROS hands it to callbacks that ask for it."""


class LocalTopics:
    """The topics of the nodes that are made within `composed`."""

    def __init__(self) -> None:
        self.publishers: dict[str, list[LocalPublisher]] = {}
        self.subscriptions: dict[str, list[LocalSubscription]] = {}

    def publish_here(self, publisher: LocalPublisher) -> None:
        """Let a publisher send to the subscriptions of this process."""
        topic = publisher.topic_name
        self.publishers.setdefault(topic, []).append(publisher)
        publisher.local = self.subscriptions.setdefault(topic, [])
        for subscription in publisher.local:
            subscription.leave_dds()

    def subscribe_here(self, subscription: LocalSubscription) -> None:
        """Let a subscription hear the publishers of this process."""
        topic = subscription.topic_name
        self.subscriptions.setdefault(topic, []).append(subscription)
        subscription.publishers = self.publishers.setdefault(topic, [])
        if subscription.publishers:
            subscription.leave_dds()

    def leave(self, node: Any) -> None:
        """Forget the publishers and subscriptions of a node, which are to be destroyed."""
        for publishers in self.publishers.values():
            publishers[:] = [each for each in publishers if each not in node.publishers]
        for subscriptions in self.subscriptions.values():
            subscriptions[:] = [each for each in subscriptions if not each.is_of(node)]


class LocalPublisher(Publisher):
    """A publisher that sends within its process, and over DDS where somebody else reads.

    Attributes:
        sent: how many messages.
        local: subscriptions of this process; empty where nodes are not composed.
        sends_all: send over DDS though nobody reads there, so that its numbers go with `sent`.
    """

    sent = 0
    local: list[LocalSubscription] = []  # noqa: RUF012 - replaced, never changed
    sends_all = True

    def publish(self, msg: Any) -> None:
        """Send a message, which nobody may change afterwards; see `rclpy.publisher.Publisher`."""
        self.sent += 1
        for subscription in self.local:
            subscription.put(msg, self.sent)
        if self.sends_all or not self.local or super().get_subscription_count():
            super().publish(msg)

    def get_subscription_count(self) -> int:
        """Return how many subscriptions, here and elsewhere, hear this."""
        return int(super().get_subscription_count()) + len(self.local)


class LocalSubscription:
    """A subscription that hears the nodes of its process, or DDS where none of them publishes.

    Args:
        node: whose executor calls `take` with a message and what is known of it.
        topic: resolved.
        quality: of the topic; what does not fit into its depth is replaced.
        dds: the subscription over DDS; None once this process alone is read.
    """

    def __init__(
        self,
        node: Any,
        topic: str,
        take: Callable[[Any, Information], None],
        quality: QoSProfile,
        dds: Any,
    ) -> None:
        self.topic_name = topic
        self.publishers: list[LocalPublisher] = []
        self._node, self._receive, self.dds = node, take, dds
        keeps_all = quality.history is HistoryPolicy.KEEP_ALL
        self._waiting: deque[tuple[Any, int]] = deque(maxlen=None if keeps_all else quality.depth)
        # Never within the publisher's call: that holds locks, and runs on another thread.
        self._came = node.create_guard_condition(self._take)

    def is_of(self, node: Any) -> bool:
        """Return whether this is a subscription of a node."""
        return self._node is node

    def leave_dds(self) -> None:
        """Hear this process alone from now on."""
        if self.dds is not None:
            self._node.destroy_subscription(self.dds)
            self.dds = None

    def put(self, message: Any, number: int) -> None:
        """Have a message taken by the executor."""
        self._waiting.append((message, number))
        self._came.trigger()

    def get_publisher_count(self) -> int:
        """Return how many publishers this hears."""
        return len(self.publishers) if self.dds is None else int(self.dds.get_publisher_count())

    def _take(self) -> None:
        while self._waiting:
            message, number = self._waiting.popleft()
            self._receive(message, {"publication_sequence_number": number})


_composed: LocalTopics | None = None


def composed_topics() -> LocalTopics | None:
    """Return the topics that a node that is made now belongs to."""
    return _composed


@contextmanager
def composed() -> Iterator[None]:
    """Let the nodes that are made in the block hand messages to each other."""
    global _composed
    _composed = LocalTopics()
    try:
        yield
    finally:
        _composed = None
