# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Time stamps as integers of nanoseconds, exact, and message headers."""

from __future__ import annotations

import struct

from msg_adapters.types import ROS, Message, MessageTypes

NANOSECONDS_PER_SECOND = 1_000_000_000
MAXIMUM_SECONDS = 2**31 - 1

_CDR_LITTLE_ENDIAN = 1
_STAMP_END = 12


def encode_stamp(stamp_ns: int, *, types: MessageTypes = ROS) -> Message:
    """Return a builtin_interfaces/Time.

    Raises:
        ValueError: the time is negative, or beyond the 31 bits of seconds that a Time holds.
    """
    seconds, nanoseconds = divmod(int(stamp_ns), NANOSECONDS_PER_SECOND)
    if not 0 <= seconds <= MAXIMUM_SECONDS:
        raise ValueError(f"stamp of {stamp_ns} ns is outside of what a Time holds, 0 to 2^31 s")
    return types.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def decode_stamp(stamp: Message) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time.

    Raises:
        ValueError: negative seconds, or a nanosecond part of a second or more.
    """
    seconds, nanoseconds = int(stamp.sec), int(stamp.nanosec)
    if seconds < 0 or not 0 <= nanoseconds < NANOSECONDS_PER_SECOND:
        raise ValueError(
            f"stamp {seconds} s + {nanoseconds} ns is no valid time: seconds must not be negative "
            "and nanoseconds must be below 10^9"
        )
    return seconds * NANOSECONDS_PER_SECOND + nanoseconds


def encode_header(stamp_ns: int, frame_id: str, *, types: MessageTypes = ROS) -> Message:
    """Return a std_msgs/Header.

    Raises:
        ValueError: as `encode_stamp`.
    """
    stamp = encode_stamp(stamp_ns, types=types)
    return types.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def message_stamp_ns(message: Message) -> int:
    """Return the nanoseconds of a stamped message's header.

    Raises:
        ValueError: as `decode_stamp`.
    """
    return decode_stamp(message.header.stamp)


def serialized_stamp_ns(serialized: bytes | memoryview) -> int:
    """Return the header's stamp of a serialised (CDR) message whose first field is its header.

    Raises:
        ValueError: the message is too short to hold a header, or the stamp is no time: its seconds
            are negative, or its nanoseconds a second or more.
    """
    if len(serialized) < _STAMP_END:
        raise ValueError(f"serialised message of {len(serialized)} bytes holds no header")
    order = "<" if serialized[1] & _CDR_LITTLE_ENDIAN else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", serialized, 4)
    if seconds < 0 or nanoseconds >= NANOSECONDS_PER_SECOND:
        raise ValueError(f"stamp {seconds} s + {nanoseconds} ns is no time")
    return int(seconds) * NANOSECONDS_PER_SECOND + int(nanoseconds)
