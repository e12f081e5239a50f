"""What a stepper and its participants tell each other, as diagnostic_msgs/DiagnosticArray.

A step names the time to go to and how many messages of each topic have been sent so far: they
belong to the steps before, and are heard before anything of this one is done. An answer says that
a participant is there or has gone to that time, and how many messages it has sent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

import msg_adapters
from msg_adapters import Level, Status

STEP_TOPIC = "/simulated_time/step"
ANSWER_TOPIC = "/simulated_time/answer"
CLOCK_TOPIC = "/clock"
PROTOCOL_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
NANOSECONDS_PER_SECOND = 1_000_000_000


class Kind(StrEnum):
    """What a message of the protocol is."""

    CALL = "call"
    STEP = "step"
    PRESENT = "present"
    DONE = "done"


@dataclass(frozen=True)
class Sent:
    """How many messages a publisher has sent on a topic.

    Attributes:
        publisher: the life of the node that sends; another one after a restart.
        count: since it began.
    """

    publisher: str
    count: int


@dataclass(frozen=True)
class Step:
    """What the stepper says.

    Attributes:
        time_ns: where to go; for a call, where the time is.
        kind: CALL or STEP.
        sent: by topic, what has changed since the step before.
    """

    time_ns: int
    kind: Kind
    sent: Mapping[str, Sent] = field(default_factory=dict)


@dataclass(frozen=True)
class Answer:
    """What a participant says.

    Attributes:
        time_ns: where it is.
        kind: PRESENT, the answer to a call, or DONE.
        name: of the node, with its namespace.
        life: of the node.
        sent: messages by topic; for DONE those that have changed.
        readers: for PRESENT, how many readers each of its topics is connected to.
        read: for PRESENT, how many writers each topic that it reads is connected to.
    """

    time_ns: int
    kind: Kind
    name: str
    life: str
    sent: Mapping[str, int] = field(default_factory=dict)
    readers: Mapping[str, int] = field(default_factory=dict)
    read: Mapping[str, int] = field(default_factory=dict)


def encode_step(step: Step) -> Any:
    """Return the message of a step."""
    values = {topic: f"{sent.publisher} {sent.count}" for topic, sent in step.sent.items()}
    return _encode([Status("stepper", Level.OK, step.kind, "", values)], step.time_ns)


def decode_step(message: Any) -> Step:
    """Return a step.

    Raises:
        ValueError: it is none.
    """
    (status,) = _statuses(message, 1)
    sent = {}
    for topic, text in status.values.items():
        publisher, _, count = text.rpartition(" ")
        sent[topic] = Sent(publisher, int(count))
    return Step(msg_adapters.message_stamp_ns(message), Kind(status.message), sent)


def encode_answer(answer: Answer) -> Any:
    """Return the message of an answer."""
    parts = [answer.sent, answer.readers, answer.read]
    if answer.kind is Kind.DONE:
        parts = parts[:1]
    statuses = [
        Status(
            answer.name, Level.OK, answer.kind, answer.life, {k: str(n) for k, n in each.items()}
        )
        for each in parts
    ]
    return _encode(statuses, answer.time_ns)


def decode_answer(message: Any) -> Answer:
    """Return an answer.

    Raises:
        ValueError: it is none.
    """
    statuses = _statuses(message, 1, 3)
    first = statuses[0]
    counts = [{k: int(text) for k, text in each.values.items()} for each in statuses]
    return Answer(
        msg_adapters.message_stamp_ns(message),
        Kind(first.message),
        first.name,
        first.hardware_id,
        *counts,
    )


def _encode(statuses: list[Status], time_ns: int) -> Any:
    return msg_adapters.encode_diagnostics(statuses, stamp_ns=time_ns)


def _statuses(message: Any, *counts: int) -> list[Status]:
    statuses = msg_adapters.decode_diagnostics(message)
    if len(statuses) not in counts:
        raise ValueError(f"a message of the stepper's holds {len(statuses)} parts")
    return statuses
