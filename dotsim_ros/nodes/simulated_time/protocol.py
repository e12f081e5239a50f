# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a stepper and its participants tell each other: JSON in a std_msgs/String.

A step names the time to go to and how many messages of each topic have been sent so far: they
belong to the steps before, and are heard before anything of this one is done. An answer says that
a participant is there or has gone to that time, and how many messages it has sent.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import NamedTuple

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from dotsim_ros.io.documents import value_text

STEP_TOPIC = "/simulated_time/step"
ANSWER_TOPIC = "/simulated_time/answer"
CLOCK_TOPIC = "/clock"
PROTOCOL_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
NANOSECONDS_PER_SECOND = 1_000_000_000
UNREADABLE = (ValueError, TypeError, AttributeError, RecursionError, OverflowError)
"""What a text that is no message of the protocol may raise."""


class Kind(StrEnum):
    """What a message of the protocol is."""

    CALL = "call"
    STEP = "step"
    PRESENT = "present"
    DONE = "done"


class Sent(NamedTuple):
    """How many messages a publisher, the life of a node, has sent on a topic since it began."""

    publisher: str
    total: int


class Step(NamedTuple):
    """What the stepper says: the time to go to or, for a call, where it is; and by topic, what has
    been sent since the step before."""

    time_ns: int
    kind: Kind
    sent: Mapping[str, Sent] = MappingProxyType({})


class Answer(NamedTuple):
    """What a participant says.

    Attributes:
        kind: PRESENT, the answer to a call, or DONE.
        name, life: of the node, with its namespace.
        sent: messages by topic; for DONE those that have changed.
        readers: for PRESENT, how many readers each of its topics is connected to.
        read: for PRESENT, how many writers each topic that it reads is connected to.
        waits: for PRESENT, what has not come that the step before needs, in words.
    """

    time_ns: int
    kind: Kind
    name: str
    life: str
    sent: Mapping[str, int] = MappingProxyType({})
    readers: Mapping[str, int] = MappingProxyType({})
    read: Mapping[str, int] = MappingProxyType({})
    waits: str = ""


def encode(said: Step | Answer) -> String:
    """Return the message of a step or an answer."""
    parts = [dict(part) if isinstance(part, Mapping) else part for part in said]
    return String(data=json.dumps(parts, separators=(",", ":")))


def decode_step(message: String) -> Step:
    """Return a step.

    Raises:
        ValueError: it is none.
    """
    try:
        time_ns, kind, sent = json.loads(message.data)
        return Step(
            int(time_ns),
            Kind(kind),
            {topic: Sent(str(publisher), int(n)) for topic, (publisher, n) in sent.items()},
        )
    except UNREADABLE as error:
        raise _strange(message, error) from None


def decode_answer(message: String) -> Answer:
    """Return an answer.

    Raises:
        ValueError: it is none.
    """
    try:
        time_ns, kind, name, life, *counted, waits = json.loads(message.data)
        sent, readers, read = ({topic: int(n) for topic, n in each.items()} for each in counted)
        return Answer(
            int(time_ns), Kind(kind), str(name), str(life), sent, readers, read, str(waits)
        )
    except UNREADABLE as error:
        raise _strange(message, error) from None


def _strange(message: String, error: Exception) -> ValueError:
    return ValueError(
        f"{value_text(message.data)} is no message between a stepper and its participants ({error})"
    )
