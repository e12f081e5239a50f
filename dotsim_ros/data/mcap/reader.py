# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads MCAP files, finished or broken off, and reports all damage.

A length that a file states is compared with that of the file and with bounds before it is used, so
that a damaged or hostile file costs neither time nor memory. PyPI's `mcap` parses single records;
its readers unpack chunks without bounds, and end at the first damage.
"""

from __future__ import annotations

import os
import stat
import zlib
from collections import Counter, OrderedDict
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from enum import IntEnum
from heapq import heapify, heappop, heappush
from pathlib import Path

import lz4.frame
from backports import zstd
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Header, Message, Schema, Statistics

from dotsim_ros.data.mcap.records import (
    HEAD,
    MAGIC,
    MESSAGE_HEAD,
    PROFILE,
    DamagedError,
    chunk_index,
    pack,
    parse,
    split,
)

LARGEST_CHUNK_BYTES = 2**29
"""Unpacked. ROS 2 writes chunks of a few megabytes, or of one larger message."""

KEPT_BYTES = 2**28
"""Unpacked chunks that are kept while messages of others come between theirs."""

STRETCH_BYTES = 2**20
"""Messages that lie in no chunk are taken together up to this length."""

_TAIL_BYTES = len(pack(Footer(0, 0, 0))) + len(MAGIC)
"""The end of a finished file: the footer and the magic."""

_LOOSE = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
"""What lies in chunks, and in a file without chunks one after the other."""

_UNPACKERS: dict[str, Callable[[], object]] = {
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "zstd": zstd.ZstdDecompressor,
}


class Tolerance(IntEnum):
    """What a file may be and still be read.

    WHOLE: finished, without damage.
    UNFINISHED: also cut short; what lies before its end is read.
    DAMAGED: also damaged; what is damaged is left out.
    """

    WHOLE = 0
    UNFINISHED = 1
    DAMAGED = 2


class McapFile:
    """An MCAP file of ROS 2, opened for reading until `close`.

    Attributes:
        schemas, channels: definitions of message types, and topics, by number.
        counts: messages of each channel.
        damage: what is wrong with the file, within its tolerance; more may come while messages
            are read.

    Raises:
        DamagedError: the file is damaged or was not finished.
        ValueError: it is no MCAP file of ROS 2.
        OSError: it cannot be opened.
    """

    def __init__(self, path: Path, tolerance: Tolerance = Tolerance.WHOLE) -> None:
        if not stat.S_ISREG(path.stat().st_mode):
            raise ValueError("is no file")
        self._file = os.open(path, os.O_RDONLY)
        self._tolerance = tolerance
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.damage: list[str] = []
        # Chunks, and stretches of records that lie in none.
        self._parts: list[ChunkIndex] = []
        try:
            self._size = os.fstat(self._file).st_size
            self._open()
        except BaseException:
            os.close(self._file)
            raise

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def messages(self, channels: Collection[int]) -> Iterator[Message]:
        """Yield the messages of the given channels by log time, those of equal times as they lie.

        Raises:
            DamagedError: a chunk is damaged or messages are missing, and the file may not be
                damaged.
        """
        wanted = frozenset(channels)
        # Log time, part, start and end of a message in it; an end of 0 stands for the part itself.
        queue = [
            (part.message_start_time, number, 0, 0)
            for number, part in enumerate(self._parts)
            if not wanted.isdisjoint(part.message_index_offsets)
        ]
        heapify(queue)
        contents = _Contents(self._content, KEPT_BYTES)
        found: Counter[int] = Counter()
        while queue:
            _, number, start, end = heappop(queue)
            part = self._parts[number]
            try:
                content = contents.get(number)
                places = self._places_within(part, content, wanted) if end == 0 else []
            except DamagedError as error:
                self._spoilt(
                    f"is damaged in the chunk at byte {part.chunk_start_offset} (log times "
                    f"{1e-9 * part.message_start_time:.3f} s to "
                    f"{1e-9 * part.message_end_time:.3f} s): {error}"
                )
                continue
            for log_time_ns, message_start, message_end in places:
                heappush(queue, (log_time_ns, number, message_start, message_end))
            if end == 0:
                continue
            channel, sequence, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(
                content, start
            )
            found[channel] += 1
            data = bytes(content[start + MESSAGE_HEAD.size : end])
            yield Message(channel, log_time_ns, data, publish_time_ns, sequence)
        missing = sum(max(0, self.counts[channel] - found[channel]) for channel in wanted)
        if missing and not self.damage:
            self._spoilt(f"lacks {missing} messages that its index counts")

    def _spoilt(self, words: str, tolerated_by: Tolerance = Tolerance.DAMAGED) -> None:
        if self._tolerance < tolerated_by:
            raise DamagedError(words)
        if words not in self.damage:
            self.damage.append(words)

    def _open(self) -> None:
        if self._size == 0:
            raise ValueError("is empty")
        magic = os.pread(self._file, len(MAGIC), 0)
        if magic != MAGIC:
            raise ValueError("does not begin as an MCAP file does")
        try:
            start: int | None = self._header()
        except DamagedError as error:
            self._spoilt(f"has no header that can be read ({error})")
            start = None
        footer, self._is_indexed = None, False
        try:
            footer = self._footer()
            self._is_indexed = footer is not None and self._read_summary(footer)
        except DamagedError as error:
            self._spoilt(str(error))
        if not self._is_indexed and start is not None:
            # Where a file was not finished, a break in it is its end.
            self._scan(start, Tolerance.DAMAGED if footer else Tolerance.UNFINISHED)

    def _header(self) -> int:
        """Return where the data begin."""
        opcode, end = self._head(len(MAGIC))
        if opcode != Opcode.HEADER:
            raise DamagedError("is damaged at byte 8")
        start = len(MAGIC) + HEAD.size
        profile = parse(Header, self._octets(start, end - start)).profile
        if profile != PROFILE:
            raise DamagedError(f"its profile is {profile[:40]!r}, expected {PROFILE!r}")
        return end

    def _octets(self, start: int, length: int) -> memoryview:
        if length > LARGEST_CHUNK_BYTES:
            raise DamagedError(
                f"has a part of {length} bytes, more than the {LARGEST_CHUNK_BYTES} that are read "
                "at once"
            )
        octets = os.pread(self._file, length, start)
        if len(octets) < length:
            raise DamagedError("it is cut off")
        return memoryview(octets)

    def _head(self, start: int) -> tuple[int, int]:
        """Return the opcode of a record, and where it ends."""
        head = os.pread(self._file, HEAD.size, start)
        if len(head) < HEAD.size:
            raise DamagedError(f"breaks off at byte {start}")
        opcode, length = HEAD.unpack(head)
        left = self._size - start - HEAD.size
        if length > left:
            raise DamagedError(
                f"breaks off at byte {start}: a record of {length} bytes is begun, {left} are there"
            )
        return opcode, start + HEAD.size + length

    def _footer(self) -> Footer | None:
        """Return the end of a file that was finished."""
        start = max(0, self._size - _TAIL_BYTES)
        tail = self._octets(start, self._size - start)
        if len(tail) == _TAIL_BYTES:
            footer = parse(Footer, tail[HEAD.size : -len(MAGIC)])
            if tail == pack(footer) + MAGIC:
                return footer
        words = "was not finished or is cut off: it has no index at its end"
        self._spoilt(words, Tolerance.UNFINISHED)
        return None

    def _read_summary(self, footer: Footer) -> bool:
        """Take channels and chunks from the summary; return whether it has them."""
        start, expected = footer.summary_start, footer.summary_crc
        end = self._size - _TAIL_BYTES
        if start == 0:
            return False
        if not len(MAGIC) <= start <= end:
            raise DamagedError(f"says that its index is at byte {start}, where it cannot be")
        summary = self._octets(start, end - start)
        # The checksum is of the footer, too, up to the checksum itself.
        if expected and zlib.crc32(pack(footer)[:-4], zlib.crc32(summary)) != expected:
            raise DamagedError("is damaged: the checksum of its index does not match")
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        statistics: Statistics | None = None
        parts: list[ChunkIndex] = []
        for opcode, content, _ in split(summary):
            if opcode == Opcode.SCHEMA:
                schema = parse(Schema, content)
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = parse(Channel, content)
                channels[channel.id] = channel
            elif opcode == Opcode.STATISTICS:
                statistics = parse(Statistics, content)
            elif opcode == Opcode.CHUNK_INDEX:
                part = parse(ChunkIndex, content)
                if not len(MAGIC) <= part.chunk_start_offset <= start - part.chunk_length:
                    raise DamagedError(
                        f"has an index of a chunk at byte {part.chunk_start_offset}, where none "
                        "can be"
                    )
                parts.append(part)
        if statistics is None:
            return False
        counts = Counter(statistics.channel_message_counts)
        has_all = (
            statistics.message_count == counts.total()
            and (bool(parts) or statistics.message_count == 0)
            and all(part.message_index_offsets for part in parts)
            and all(part.message_index_offsets.keys() <= channels.keys() for part in parts)
            and all(channel.schema_id in schemas for channel in channels.values())
        )
        if has_all:
            self.schemas, self.channels, self.counts, self._parts = schemas, channels, counts, parts
        return has_all

    def _scan(self, start: int, tolerates_break: Tolerance) -> None:
        """Recreate the index, from what lies in the file from its header on."""
        while start < self._size:
            try:
                opcode, end = self._head(start)
                if opcode == 0 and not self._is_zero_from(start):
                    raise DamagedError(f"breaks off at byte {start}")
            except DamagedError as error:
                words = f"{error}; the {self._size - start} bytes from there on cannot be read"
                self._spoilt(words, tolerates_break)
                return
            if opcode in (0, Opcode.DATA_END, Opcode.FOOTER):
                return
            if opcode in _LOOSE:
                end = self._stretch_end(start, end)
            if opcode in (*_LOOSE, Opcode.CHUNK):
                try:
                    self._scan_part(start, end - start)
                except DamagedError as error:
                    what = "chunk" if opcode == Opcode.CHUNK else "messages"
                    # Where nothing follows, its writing was cut short.
                    is_last = self._is_zero_from(end)
                    self._spoilt(
                        f"is damaged in the {what} at byte {start}: {error}",
                        tolerates_break if is_last else Tolerance.DAMAGED,
                    )
            start = end

    def _is_zero_from(self, start: int) -> bool:
        while octets := os.pread(self._file, STRETCH_BYTES, start):
            if octets.strip(b"\0"):
                return False
            start += len(octets)
        return True

    def _stretch_end(self, start: int, end: int) -> int:
        """Return where a stretch of records ends that lie in no chunk; the first ends at `end`."""
        while end < self._size and end - start < STRETCH_BYTES:
            try:
                opcode, next_end = self._head(end)
            except DamagedError:
                break
            if opcode not in _LOOSE:
                break
            end = next_end
        return end

    def _scan_part(self, start: int, length: int) -> None:
        """Look at all of a part, and take its topics and times from what is in it."""
        chunk = self._chunk(start, length)
        content = _unpacked(chunk)
        for opcode, inner, _ in split(content):
            if opcode == Opcode.SCHEMA:
                schema = parse(Schema, inner)
                self.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = parse(Channel, inner)
                if channel.schema_id not in self.schemas:
                    raise DamagedError(f"topic {channel.topic} has no schema")
                self.channels[channel.id] = channel
        places = list(self._places(content))
        if not places:
            return
        counts = Counter(number for number, *_ in places)
        times = [log_time_ns for _, log_time_ns, *_ in places]
        chunk = replace(chunk, message_start_time=min(times), message_end_time=max(times))
        self.counts += counts
        self._parts.append(chunk_index(chunk, start, length, dict.fromkeys(counts, 0)))

    def _chunk(self, start: int, length: int) -> Chunk:
        """Return a chunk; records that lie in none are returned as one that is not compressed."""
        octets = self._octets(start, length)
        opcode, content, end = next(split(octets), (0, octets, 0))
        if opcode in _LOOSE:
            return Chunk("", octets, 0, 0, 0, length)  # type: ignore[arg-type]
        if opcode != Opcode.CHUNK or end != length:
            raise DamagedError("no chunk of that length is there")
        return parse(Chunk, content, LARGEST_CHUNK_BYTES)

    def _content(self, number: int) -> memoryview:
        """Return the records of a part, their checksum checked."""
        part = self._parts[number]
        start, length = part.chunk_start_offset, part.chunk_length
        chunk = self._chunk(start, length)
        offsets, index_length = part.message_index_offsets, part.message_index_length
        found = chunk_index(chunk, start, length, offsets, index_length)
        if self._is_indexed and found != part:
            raise DamagedError("its head differs from the index")
        return _unpacked(chunk)

    def _places(self, content: memoryview) -> Iterator[tuple[int, int, int, int]]:
        """Yield channel, log time, start and end of the messages."""
        for opcode, inner, end in split(content):
            if opcode != Opcode.MESSAGE:
                continue
            if len(inner) < MESSAGE_HEAD.size:
                raise DamagedError(f"holds a message of {len(inner)} bytes without a head")
            channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(inner)
            if channel not in self.channels:
                raise DamagedError(f"holds messages of an unknown topic {channel}")
            yield channel, log_time_ns, end - len(inner), end

    def _places_within(
        self, part: ChunkIndex, content: memoryview, wanted: Collection[int]
    ) -> list[tuple[int, int, int]]:
        """Return log time, start and end of a part's messages of the wanted channels."""
        places = list(self._places(content))
        for _, log_time_ns, *_ in places:
            if not part.message_start_time <= log_time_ns <= part.message_end_time:
                raise DamagedError("holds messages of other times than its index says")
        return [(time, start, end) for channel, time, start, end in places if channel in wanted]


class _Contents:
    """What parts hold; that of those used last is kept, within a number of bytes."""

    def __init__(self, read: Callable[[int], memoryview], largest_bytes: int) -> None:
        self._read, self._largest, self._size = read, largest_bytes, 0
        self._kept: OrderedDict[int, memoryview] = OrderedDict()

    def get(self, number: int) -> memoryview:
        if number in self._kept:
            self._kept.move_to_end(number)
            return self._kept[number]
        content = self._kept[number] = self._read(number)
        self._size += len(content)
        while self._size > self._largest and len(self._kept) > 1:
            self._size -= len(self._kept.popitem(last=False)[1])
        return content


def _unpacked(chunk: Chunk) -> memoryview:
    """Return the records of a chunk, of the size that it promises and of its checksum."""
    size, compression = chunk.uncompressed_size, chunk.compression
    if size > LARGEST_CHUNK_BYTES:
        raise DamagedError(
            f"unpacks to {size} bytes, more than the {LARGEST_CHUNK_BYTES} that are read at once"
        )
    content = chunk.data
    if compression in _UNPACKERS:
        unpacker = _UNPACKERS[compression]()
        try:
            # One byte more than promised, so that more shows.
            content = unpacker.decompress(bytes(content), size + 1)  # type: ignore[attr-defined]
        # Each library raises errors of its own, and lz4 bare RuntimeErrors.
        except Exception as error:
            raise DamagedError(f"cannot be unpacked ({error})") from error
    elif compression:
        raise DamagedError(f"is packed by {compression!r}, expected lz4, zstd or nothing")
    if len(content) != size:
        raise DamagedError(f"unpacks to {len(content)} bytes or more, its head says {size}")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise DamagedError("its checksum does not match: bytes have changed")
    return memoryview(content)
