# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Waits for what a node publishes that knows nothing of steps."""

from __future__ import annotations

from collections.abc import Callable
from threading import Condition
from typing import Any

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile

import msg_adapters
from dotsim_ros.nodes.simulated_time.participant import stamp_of
from dotsim_ros.nodes.simulated_time.participants import Publication
from dotsim_ros.nodes.simulated_time.protocol import NANOSECONDS_PER_SECOND, Sent

FARTHEST_STAMP_S = 10.0
"""A stamp further from the simulated time is one of another clock."""
HEADER = "std_msgs/Header"


class PublicationWatch:
    """What has come on one topic.

    Args:
        owner: full name of the node that publishes on it.
        changed: notified, and held, when something has come.
        now_ns: returns the simulated time.

    Attributes:
        sent: what the owner has sent.
        fault: why what comes is of no use; empty for nothing.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        owner: str,
        publication: Publication,
        *,
        changed: Condition,
        now_ns: Callable[[], int],
    ) -> None:
        self._node, self._topic = node, topic
        self.owner, self.publication = owner, publication
        self._changed, self._now_ns = changed, now_ns
        self.sent = Sent("", 0)
        self.fault = ""
        self._subscription: Any = None
        self._is_stamped = False
        self._received = self._replied_to = 0
        self._begun_ns = self._stamp_ns = 0

    def listen(self) -> str:
        """Subscribe to what the owner publishes; return in words why that cannot be, empty where it
        can."""
        found = self._node.get_publishers_info_by_topic(self._topic)
        if len(found) > 1:
            return f"{self._topic} has more than one publisher, expected one: stop the others"
        name = self.owner.lstrip("/")
        if not found:
            return f"{name} has no publisher on {self._topic}"
        (publisher,) = found
        actual = f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
        if actual != self.owner:
            return f"{self._topic} is published by {actual.lstrip('/')}, expected {name}"
        # One that has started again counts its messages again.
        life = bytes(publisher.endpoint_gid).hex()
        if life == self.sent.publisher:
            is_connected = self._subscription.get_publisher_count() > 0
            return "" if is_connected else f"{self._topic} of {name} is not connected yet"
        kind = msg_adapters.message_class(publisher.topic_type)
        self._is_stamped = list(kind.get_fields_and_field_types().values())[:1] == [HEADER]
        if self.publication.every_s and not self._is_stamped:
            return (
                f"{self._topic} of {name} is a {publisher.topic_type}, which has no stamp: "
                "every_s needs one, for_each does not"
            )
        self.close()
        with self._changed:
            self.sent = Sent(life, 0)
        # rclpy's types know no callback that takes what is known of a message as well.
        hear: Any = self._on_message
        self._subscription = Node.create_subscription(
            self._node,
            kind,
            self._topic,
            hear,
            QoSProfile(
                history=HistoryPolicy.KEEP_ALL, reliability=publisher.qos_profile.reliability
            ),
            raw=True,
        )
        return f"{self._topic} of {name} is not connected yet"

    def begin(self, asked: int) -> None:
        """Take what has come so far as the state to begin with; so many messages have been sent on
        the topic that the owner answers."""
        self._received, self._replied_to, self.fault = 0, asked, ""
        self._begun_ns = self._now_ns()

    def is_late(self, asked: int) -> bool:
        """Return whether something is missing that should have come by now; see `begin`."""
        if self.publication.for_each:
            return self._received < asked - self._replied_to
        every_ns = round(self.publication.every_s * NANOSECONDS_PER_SECOND)
        now_ns = self._now_ns()
        return now_ns - self._begun_ns >= every_ns and self._stamp_ns <= now_ns - every_ns

    def close(self) -> None:
        """Hear nothing any more."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _on_message(self, message: bytes, information: Any) -> None:
        number, owner = information["publication_sequence_number"], self.owner.lstrip("/")
        stamp_ns = stamp_of(message) if self._is_stamped else self._now_ns()
        away_s = (stamp_ns - self._now_ns()) / NANOSECONDS_PER_SECOND
        with self._changed:
            if number is None:
                self.fault = (
                    "the middleware does not number its messages, which steps of simulated time "
                    "need: set RMW_IMPLEMENTATION=rmw_fastrtps_cpp"
                )
            elif abs(away_s) > FARTHEST_STAMP_S:
                self.fault = (
                    f"{self._topic} of {owner} is stamped {away_s:.0f} s away from the simulated "
                    "time: set use_sim_time on that node"
                )
            else:
                self._received += 1
                self._stamp_ns = stamp_ns
                self.sent = Sent(self.sent.publisher, number)
            self._changed.notify_all()
