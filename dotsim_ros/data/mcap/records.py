# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Records of an MCAP file, packed and unpacked within bounds."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "ros2"
HEAD = struct.Struct("<BQ")
"""What every record begins with: its opcode and the length of its content."""

FOOTER = struct.Struct("<QQI")
"""Start of the summary, start of its offsets, checksum."""

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time (ns)."""

CHUNK_HEAD = struct.Struct("<QQQI")
"""First and last log time (ns), bytes unpacked, checksum."""

TAIL_BYTES = HEAD.size + FOOTER.size + len(MAGIC)
"""What a finished file ends with: the footer and the magic."""


class Opcode(IntEnum):
    """Kinds of records."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


class DamagedError(ValueError):
    """A file that is MCAP and not whole: what is left of it can be saved."""


def record(opcode: Opcode, content: bytes) -> bytes:
    """Return a record."""
    return HEAD.pack(opcode, len(content)) + content


def prefixed(content: bytes | str) -> bytes:
    """Return bytes, or a text as UTF-8, behind their length."""
    octets = content.encode() if isinstance(content, str) else content
    return struct.pack("<I", len(octets)) + octets


def mapping(entries: Mapping[str, str]) -> bytes:
    """Return names and values behind their length."""
    return prefixed(b"".join(prefixed(name) + prefixed(value) for name, value in entries.items()))


class Fields:
    """Unpacks the content of a record from its beginning.

    Raises (each method):
        DamagedError: the record ends before the field does, or a text is not UTF-8.
    """

    def __init__(self, content: bytes | memoryview) -> None:
        self._content = memoryview(content)

    def __bool__(self) -> bool:
        """Return whether anything is left."""
        return len(self._content) > 0

    def octets(self, length: int) -> memoryview:
        """Take that many bytes."""
        if length > len(self._content):
            raise DamagedError(
                f"has a field of {length} bytes in a record with {len(self._content)} left"
            )
        taken, self._content = self._content[:length], self._content[length:]
        return taken

    def numbers(self, form: str) -> tuple[int, ...]:
        """Take numbers, little-endian, of a form of `struct`."""
        return struct.unpack(f"<{form}", self.octets(struct.calcsize(f"<{form}")))

    def number(self, form: str) -> int:
        """Take one number."""
        return self.numbers(form)[0]

    def prefixed(self) -> memoryview:
        """Take bytes behind their length."""
        return self.octets(self.number("I"))

    def text(self) -> str:
        """Take a text behind its length."""
        try:
            return bytes(self.prefixed()).decode()
        except UnicodeDecodeError as error:
            raise DamagedError(f"has a text that is not UTF-8 ({error})") from error

    def mapping(self) -> dict[str, str]:
        """Take names and values behind their length."""
        entries, taken = Fields(self.prefixed()), {}
        while entries:
            name = entries.text()
            taken[name] = entries.text()
        return taken


@dataclass(frozen=True)
class Schema:
    """Definition of a message type.

    Attributes:
        name: the type, such as "geometry_msgs/msg/WrenchStamped".
        encoding: language of the definition, such as "ros2msg".
        definition: its text.
    """

    name: str
    encoding: str
    definition: bytes

    def content(self, number: int) -> bytes:
        """Return the record's content."""
        return (
            struct.pack("<H", number)
            + prefixed(self.name)
            + prefixed(self.encoding)
            + prefixed(self.definition)
        )

    @classmethod
    def read(cls, content: memoryview) -> tuple[int, Schema]:
        """Return a record's number and schema."""
        fields = Fields(content)
        number = fields.number("H")
        return number, cls(fields.text(), fields.text(), bytes(fields.prefixed()))


@dataclass(frozen=True)
class Channel:
    """A topic.

    Attributes:
        schema: number of its schema.
        topic: its name.
        encoding: of the messages, such as "cdr".
        metadata: more about it, such as its QoS.
    """

    schema: int
    topic: str
    encoding: str
    metadata: Mapping[str, str] = field(default_factory=dict)

    def content(self, number: int) -> bytes:
        """Return the record's content."""
        return (
            struct.pack("<HH", number, self.schema)
            + prefixed(self.topic)
            + prefixed(self.encoding)
            + mapping(self.metadata)
        )

    @classmethod
    def read(cls, content: memoryview) -> tuple[int, Channel]:
        """Return a record's number and channel."""
        fields = Fields(content)
        number, schema = fields.numbers("HH")
        return number, cls(schema, fields.text(), fields.text(), fields.mapping())


@dataclass(frozen=True)
class ChunkIndex:
    """Where a chunk lies and what is in it.

    Attributes:
        first_ns, last_ns: log times.
        start: of its record, in bytes from the beginning of the file.
        length: of its record, in bytes.
        message_indexes: where the index of each channel's messages lies.
        message_index_length: of all of them, in bytes.
        compression: "", "lz4" or "zstd".
        compressed_size, size: of its records, in bytes, as they lie there and unpacked.
    """

    first_ns: int
    last_ns: int
    start: int
    length: int
    message_indexes: Mapping[int, int]
    message_index_length: int
    compression: str
    compressed_size: int
    size: int

    def content(self) -> bytes:
        """Return the record's content."""
        offsets = b"".join(struct.pack("<HQ", *entry) for entry in self.message_indexes.items())
        return (
            struct.pack("<QQQQ", self.first_ns, self.last_ns, self.start, self.length)
            + prefixed(offsets)
            + struct.pack("<Q", self.message_index_length)
            + prefixed(self.compression)
            + struct.pack("<QQ", self.compressed_size, self.size)
        )

    @classmethod
    def read(cls, content: memoryview) -> ChunkIndex:
        """Return a record's chunk index."""
        fields = Fields(content)
        first_ns, last_ns, start, length = fields.numbers("QQQQ")
        offsets, message_indexes = Fields(fields.prefixed()), {}
        while offsets:
            channel, offset = offsets.numbers("HQ")
            message_indexes[channel] = offset
        message_index_length, compression = fields.number("Q"), fields.text()
        compressed_size, size = fields.numbers("QQ")
        return cls(
            first_ns,
            last_ns,
            start,
            length,
            message_indexes,
            message_index_length,
            compression,
            compressed_size,
            size,
        )
