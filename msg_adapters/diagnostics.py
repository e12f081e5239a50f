# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""diagnostic_msgs/DiagnosticArray as plain records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

from msg_adapters.stamps import encode_header
from msg_adapters.types import ROS, Message, MessageTypes


class Level(IntEnum):
    """Level of a diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """State of one component.

    Attributes:
        name: the component, "node: what".
        level: how it is.
        message: why, in words.
        hardware_id: the device.
        values: figures, as text.
    """

    name: str
    level: Level
    message: str = ""
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)


def encode_diagnostics(
    statuses: Sequence[Status], *, stamp_ns: int, types: MessageTypes = ROS
) -> Message:
    """Return a diagnostic_msgs/DiagnosticArray."""
    return types.make(
        "diagnostic_msgs/msg/DiagnosticArray",
        header=encode_header(stamp_ns, "", types=types),
        status=[
            types.make(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=types.octet(int(status.level)),
                name=status.name,
                message=status.message,
                hardware_id=status.hardware_id,
                values=[
                    types.make("diagnostic_msgs/msg/KeyValue", key=key, value=value)
                    for key, value in status.values.items()
                ],
            )
            for status in statuses
        ],
    )


def decode_diagnostics(message: Message) -> list[Status]:
    """Return the states of a diagnostic_msgs/DiagnosticArray.

    Raises:
        ValueError: a level that the message does not define.
    """
    statuses = []
    for status in message.status:
        level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
        try:
            known = Level(level)
        except ValueError:
            raise ValueError(f"diagnostic {status.name!r} has unknown level {level}") from None
        values = {pair.key: pair.value for pair in status.values}
        statuses.append(Status(status.name, known, status.message, status.hardware_id, values))
    return statuses
