# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes MCAP files of which everything flushed can be read again, whatever happens next."""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from dotsim_ros import __version__
from dotsim_ros.data.mcap.records import (
    CHUNK_HEAD,
    FOOTER,
    HEAD,
    MAGIC,
    MESSAGE_HEAD,
    PROFILE,
    Channel,
    ChunkIndex,
    Opcode,
    Schema,
    mapping,
    prefixed,
    record,
)

CHUNK_BYTES = 2**20
"""A chunk is written when it is as large as this."""

RESERVE_BYTES = 2**16
"""Kept free on the disk for the end of the file, next to the index of its chunks."""

LARGEST_LOG_TIME_NS = 2**63 - 1
"""ROS 2 counts time in 63 bits."""

_CANNOT_RESERVE = (errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


class McapWriter:
    """An MCAP file with checksums of its chunks, its data and its index, not compressed.

    A chunk is written whole or not at all: the room for it, and for the index that ends the file,
    is reserved on the disk beforehand. A full disk refuses the chunk, and the file can still be
    finished; until then it ends in zeros.

    Args:
        path: the file.

    Raises:
        FileExistsError: it is there already.
        OSError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._end = 0
        self._data_crc = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._written: Counter[int] = Counter()
        self._first_ns, self._last_ns = LARGEST_LOG_TIME_NS, 0
        # What ends the file, as far as it is known.
        self._definitions = bytearray()
        self._chunk_indexes = bytearray()
        self._chunk_count = 0
        self._begin_chunk()
        try:
            self._reserve(2 * RESERVE_BYTES)
            head = prefixed(PROFILE) + prefixed(f"dotsim_ros {__version__}")
            self._put(MAGIC + record(Opcode.HEADER, head))
        except OSError:
            os.close(self._file)
            raise

    def _begin_chunk(self) -> None:
        # The first chunk that reaches the disk holds what later ones refer to.
        self._chunk = bytearray(b"" if self._chunk_count else self._definitions)
        self._messages: dict[int, bytearray] = {}
        self._chunk_counts: Counter[int] = Counter()
        self._chunk_first_ns, self._chunk_last_ns = LARGEST_LOG_TIME_NS, 0

    @property
    def written(self) -> Mapping[int, int]:
        """How many messages of each channel are in the file; those of the open chunk are not."""
        return dict(self._written)

    @property
    def first_ns(self) -> int:
        """The smallest log time in the file, 0 where it has no message."""
        return self._first_ns if self._written else 0

    @property
    def last_ns(self) -> int:
        """The largest log time in the file, 0 where it has no message."""
        return self._last_ns

    def add_channel(self, channel: Channel, schema: Schema) -> int:
        """Declare a topic; return its number.

        Args:
            channel: the topic; its number of a schema is replaced.
            schema: definition of its messages.
        """
        if schema not in self._schemas:
            self._schemas.append(schema)
            self._define(Opcode.SCHEMA, schema.content(len(self._schemas)))
        number = len(self._channels) + 1
        schema_number = self._schemas.index(schema) + 1
        channel = Channel(schema_number, channel.topic, channel.encoding, channel.metadata)
        self._channels.append(channel)
        self._define(Opcode.CHANNEL, channel.content(number))
        return number

    def _define(self, opcode: Opcode, content: bytes) -> None:
        self._chunk += record(opcode, content)
        self._definitions += record(opcode, content)

    def write(self, channel: int, log_time_ns: int, message: bytes | memoryview) -> None:
        """Add a message to the open chunk, and write the chunk when it is large enough.

        Args:
            channel: number of its topic.
            log_time_ns: place in the order of a replay, 0 to 2^63 - 1.
            message: serialised.

        Raises:
            ValueError: a log time out of range; nothing is added.
            OSError: the chunk does not fit on the disk; none of its messages is written.
        """
        if not 0 <= log_time_ns <= LARGEST_LOG_TIME_NS:
            raise ValueError(f"log time {log_time_ns} ns is out of range, expected 0 to 2^63 - 1")
        entry = struct.pack("<QQ", log_time_ns, len(self._chunk))
        self._messages.setdefault(channel, bytearray()).extend(entry)
        self._chunk += HEAD.pack(Opcode.MESSAGE, MESSAGE_HEAD.size + len(message))
        self._chunk += MESSAGE_HEAD.pack(channel, 0, log_time_ns, log_time_ns)
        self._chunk += message
        self._chunk_counts[channel] += 1
        self._chunk_first_ns = min(self._chunk_first_ns, log_time_ns)
        self._chunk_last_ns = max(self._chunk_last_ns, log_time_ns)
        if len(self._chunk) >= CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write the open chunk, so that its messages outlive this process.

        Raises:
            OSError: it does not fit on the disk; none of its messages is written, and the file can
                be finished without them.
        """
        if not self._chunk_counts:
            return
        chunk = record(
            Opcode.CHUNK,
            CHUNK_HEAD.pack(
                self._chunk_first_ns,
                self._chunk_last_ns,
                len(self._chunk),
                zlib.crc32(self._chunk),
            )
            + prefixed("")
            + struct.pack("<Q", len(self._chunk))
            + self._chunk,
        )
        place, offsets, indexes = self._end + len(chunk), {}, bytearray()
        for channel, entries in self._messages.items():
            offsets[channel] = place + len(indexes)
            content = struct.pack("<H", channel) + prefixed(bytes(entries))
            indexes += record(Opcode.MESSAGE_INDEX, content)
        index = record(
            Opcode.CHUNK_INDEX,
            ChunkIndex(
                self._chunk_first_ns,
                self._chunk_last_ns,
                self._end,
                len(chunk),
                offsets,
                len(indexes),
                "",
                len(self._chunk),
                len(self._chunk),
            ).content(),
        )
        ending = len(self._definitions) + len(self._chunk_indexes) + len(index) + RESERVE_BYTES
        try:
            self._check_still_there()
            self._reserve(len(chunk) + len(indexes) + ending)
            self._put(chunk + indexes)
        except OSError:
            self._begin_chunk()
            raise
        self._chunk_indexes += index
        self._chunk_count += 1
        self._written += self._chunk_counts
        self._first_ns = min(self._first_ns, self._chunk_first_ns)
        self._last_ns = max(self._last_ns, self._chunk_last_ns)
        self._begin_chunk()

    def sync(self) -> None:
        """Wait until what is written is on the disk, so that it outlives a loss of power."""
        os.fdatasync(self._file)

    def finish(self, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Write what is left, the metadata and the index, and close the file.

        Args:
            metadata: named groups of names and values.

        Raises:
            OSError: they do not fit on the disk; the file is closed without an index.
        """
        try:
            self.flush()
            self._check_still_there()
            self._put_end(metadata or {})
            self.sync()
        finally:
            self.close()

    def close(self) -> None:
        """Close the file where its last whole record ends."""
        with suppress(OSError):
            os.ftruncate(self._file, self._end)
        os.close(self._file)

    def _put_end(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        indexes = bytearray()
        for name, entries in metadata.items():
            group = record(Opcode.METADATA, prefixed(name) + mapping(entries))
            place = struct.pack("<QQ", self._end, len(group)) + prefixed(name)
            indexes += record(Opcode.METADATA_INDEX, place)
            self._put(group)
        self._put(record(Opcode.DATA_END, struct.pack("<I", self._data_crc)))
        counts = b"".join(
            struct.pack("<HQ", number, self._written[number])
            for number in range(1, len(self._channels) + 1)
        )
        statistics = struct.pack(
            "<QHIIIIQQ",
            self._written.total(),
            len(self._schemas),
            len(self._channels),
            0,
            len(metadata),
            self._chunk_count,
            self.first_ns,
            self.last_ns,
        ) + prefixed(counts)
        summary = (
            bytes(self._definitions)
            + record(Opcode.STATISTICS, statistics)
            + bytes(self._chunk_indexes)
            + bytes(indexes)
        )
        start = self._end
        head = HEAD.pack(Opcode.FOOTER, FOOTER.size)
        checked = summary + head + struct.pack("<QQ", start, 0)
        footer = FOOTER.pack(start, 0, zlib.crc32(checked))
        self._put(summary + head + footer + MAGIC)

    def _check_still_there(self) -> None:
        """Notice what the system tells no writer: that somebody removed or cut the file.

        Raises:
            OSError: so it is.
        """
        status = os.fstat(self._file)
        if status.st_nlink == 0 or status.st_size < self._end:
            done = "removed" if status.st_nlink == 0 else "cut"
            raise OSError(f"the file was {done} while it was written")

    def _reserve(self, length: int) -> None:
        try:
            os.posix_fallocate(self._file, self._end, length)
        except OSError as error:
            # Where a file system has no such call, a full disk leaves a file without an index.
            if error.errno not in _CANNOT_RESERVE:
                raise

    def _put(self, content: bytes) -> None:
        left = memoryview(content)
        while left:
            written = os.pwrite(self._file, left, self._end + len(content) - len(left))
            left = left[written:]
        self._end += len(content)
        self._data_crc = zlib.crc32(content, self._data_crc)
