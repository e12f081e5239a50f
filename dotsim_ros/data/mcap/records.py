# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Records of an MCAP file, packed and parsed by PyPI's `mcap`, within bounds."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO
from typing import TypeVar

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.records import Chunk, ChunkIndex, McapRecord

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "ros2"
HEAD = struct.Struct("<BQ")
"""The start of every record: its opcode and the length of its content."""

LARGEST_RECORD_BYTES = 2**26
"""Of a record other than a chunk or a message."""

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time (ns): a message is looked at without its content."""

Record = TypeVar("Record", bound=McapRecord)


class DamagedError(ValueError):
    """A file that is MCAP and not whole: what is left of it can be saved."""


class _Content(ReadDataStream):
    """The content of a record, which is not copied.

    Where a field reaches beyond its end, mcap's own stream returns less than was asked for, or
    asks for as much memory as the field claims.
    """

    def __init__(self, content: memoryview) -> None:
        super().__init__(BytesIO())
        self._size, self._left = len(content), content

    @property
    def count(self) -> int:
        return self._size - len(self._left)

    def read(self, length: int) -> memoryview:  # type: ignore[override]
        if length > len(self._left):
            raise DamagedError(
                f"has a field of {length} bytes in a record with {len(self._left)} left"
            )
        taken, self._left = self._left[:length], self._left[length:]
        return taken


def pack(record: McapRecord) -> bytes:
    """Return a record as it lies in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


def parse(kind: type[Record], content: memoryview, largest: int = LARGEST_RECORD_BYTES) -> Record:
    """Return the record of a class of `mcap.records` whose content that is.

    Raises:
        DamagedError: it is larger than `largest` bytes, a field reaches beyond it, or a text is not
            UTF-8.
    """
    if len(content) > largest:
        raise DamagedError(f"has a record of {len(content)} bytes, more than {largest}")
    try:
        return kind.read(_Content(content))  # type: ignore[attr-defined]
    except UnicodeDecodeError as error:
        raise DamagedError(f"has a text that is not UTF-8 ({error})") from error


def split(content: memoryview) -> Iterator[tuple[int, memoryview, int]]:
    """Yield opcode and content of the records that lie one after the other, and where each ends.

    Raises:
        DamagedError: the last one is not whole.
    """
    start = 0
    while start < len(content):
        if start + HEAD.size > len(content):
            raise DamagedError("ends in half a record")
        opcode, length = HEAD.unpack_from(content, start)
        end = start + HEAD.size + length
        if end > len(content):
            raise DamagedError(f"holds a record of {length} bytes that reaches beyond it")
        yield opcode, content[start + HEAD.size : end], end
        start = end


def chunk_index(
    chunk: Chunk, start: int, length: int, offsets: dict[int, int], index_length: int = 0
) -> ChunkIndex:
    """Return what the summary says of a chunk whose record lies at `start` of the file, and of the
    indexes of its messages: their offsets by channel, and their length in bytes."""
    return ChunkIndex(
        chunk_length=length,
        chunk_start_offset=start,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=index_length,
        message_index_offsets=offsets,
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )
