# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes MCAP files of which everything flushed can be read again, whatever happens next."""

from __future__ import annotations

import errno
import os
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import (
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from dotsim_ros import __version__
from dotsim_ros.data.mcap.records import MAGIC, PROFILE, chunk_index, pack

CHUNK_BYTES = 2**20
"""A chunk is written when it is as large as this."""

RESERVE_BYTES = 2**16
"""Kept free on the disk for the end of the file, besides the index of its chunks."""

LARGEST_LOG_TIME_NS = 2**63 - 1
"""ROS 2 counts time in 63 bits."""

_CANNOT_RESERVE = (errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


class McapWriter:
    """An MCAP file with checksums of its chunks, its data and its index, not compressed.

    A chunk is written whole or not at all: the room for it, and for the index that ends the file,
    is reserved on the disk beforehand. A full disk refuses the chunk, and the file can still be
    finished; until then it ends in zeros. `statistics` are those of the messages in the file; those
    of the open chunk are not in it.

    Raises:
        FileExistsError: it is there already.
        OSError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._end = 0
        self._data_crc = 0
        self._schemas: list[Schema] = []
        self.statistics = Statistics(0, 0, {}, 0, 0, 0, 0, 0, 0)
        # What ends the file, as far as it is known.
        self._definitions = bytearray()
        self._chunk_indexes = bytearray()
        self._begin_chunk()
        try:
            self._reserve(2 * RESERVE_BYTES)
            self._put(MAGIC + pack(Header(PROFILE, f"dotsim_ros {__version__}")))
        except OSError:
            os.close(self._file)
            raise

    def _begin_chunk(self) -> None:
        self._chunk = RecordBuilder()
        self._indexes: dict[int, MessageIndex] = {}
        if not self.statistics.chunk_count:
            # The first chunk that reaches the disk holds what later ones refer to.
            self._chunk.write(self._definitions)

    def add_channel(self, channel: Channel, schema: Schema) -> int:
        """Declare a topic and the definition of its messages, whose numbers are replaced; return
        its number."""
        known = [each.id for each in self._schemas if each == replace(schema, id=each.id)]
        if not known:
            known = [len(self._schemas) + 1]
            self._schemas.append(replace(schema, id=known[0]))
            self._define(self._schemas[-1])
        self.statistics.channel_count += 1
        number = self.statistics.channel_count
        self.statistics.channel_message_counts[number] = 0
        self._define(replace(channel, id=number, schema_id=known[0]))
        return number

    def _define(self, definition: Schema | Channel) -> None:
        octets = pack(definition)
        self._chunk.write(octets)
        self._definitions += octets

    def write(self, channel: int, log_time_ns: int, message: bytes | memoryview) -> None:
        """Add a message to the open chunk, and write the chunk when it is large enough.

        Raises:
            ValueError: a log time out of range; nothing is added.
            OSError: the chunk does not fit on the disk; none of its messages is written.
        """
        if not 0 <= log_time_ns <= LARGEST_LOG_TIME_NS:
            raise ValueError(f"log time {log_time_ns} ns is out of range, expected 0 to 2^63 - 1")
        index = self._indexes.setdefault(channel, MessageIndex(channel, []))
        index.records.append((log_time_ns, self._chunk.count))
        Message(channel, log_time_ns, bytes(message), log_time_ns, 0).write(self._chunk)
        if self._chunk.count >= CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write the open chunk, so that its messages outlive this process.

        Raises:
            OSError: it does not fit on the disk; none of its messages is written, and the file can
                be finished without them.
        """
        if not self._indexes:
            return
        try:
            self._put_chunk()
        finally:
            self._begin_chunk()

    def _put_chunk(self) -> None:
        content = self._chunk.end()
        times = [time for index in self._indexes.values() for time, _ in index.records]
        chunk = Chunk(
            compression="",
            data=content,
            message_end_time=max(times),
            message_start_time=min(times),
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        octets = bytearray(pack(chunk))
        length, offsets = len(octets), {}
        for channel, message_index in self._indexes.items():
            offsets[channel] = self._end + len(octets)
            octets += pack(message_index)
        index = pack(chunk_index(chunk, self._end, length, offsets, len(octets) - length))
        ending = len(self._definitions) + len(self._chunk_indexes) + len(index) + RESERVE_BYTES
        self._check_still_there()
        self._reserve(len(octets) + ending)
        self._put(octets)
        self._chunk_indexes += index
        done = self.statistics
        times += [done.message_start_time, done.message_end_time] if done.chunk_count else []
        done.message_start_time, done.message_end_time = min(times), max(times)
        done.chunk_count += 1
        done.message_count += sum(len(each.records) for each in self._indexes.values())
        for channel, message_index in self._indexes.items():
            done.channel_message_counts[channel] += len(message_index.records)

    def sync(self) -> None:
        """Wait until what is written is on the disk, so that it outlives a loss of power."""
        os.fdatasync(self._file)

    def finish(self, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Write what is left, named groups of metadata and the index, and close the file.

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
        metadata_indexes = bytearray()
        for name, entries in metadata.items():
            group = pack(Metadata(name, dict(entries)))
            metadata_indexes += pack(MetadataIndex(self._end, len(group), name))
            self._put(group)
        self._put(pack(DataEnd(self._data_crc)))
        self.statistics.schema_count = len(self._schemas)
        self.statistics.metadata_count = len(metadata)
        summary = self._definitions + pack(self.statistics) + self._chunk_indexes + metadata_indexes
        start = self._end
        # The checksum is of the footer, too, up to the checksum itself.
        checked = summary + pack(Footer(start, 0, 0))[:-4]
        self._put(summary + pack(Footer(start, 0, zlib.crc32(checked))) + MAGIC)

    def _check_still_there(self) -> None:
        """Notice that somebody removed or cut the file, which no write reports.

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

    def _put(self, content: bytes | bytearray) -> None:
        left = memoryview(content)
        while left:
            written = os.pwrite(self._file, left, self._end + len(content) - len(left))
            left = left[written:]
        self._end += len(content)
        self._data_crc = zlib.crc32(content, self._data_crc)
