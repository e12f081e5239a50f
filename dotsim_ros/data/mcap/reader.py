# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads MCAP files, finished or broken off, and lets no damage pass unseen.

Nothing that a file says about lengths is believed before it is compared with the file's own length
and with bounds, so that a damaged or hostile file costs neither time nor memory.
"""

from __future__ import annotations

import os
import stat
import struct
import zlib
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from enum import IntEnum
from heapq import heappop, heappush
from pathlib import Path
from types import TracebackType
from typing import Self

import lz4.frame
from backports import zstd

from dotsim_ros.data.mcap.records import (
    CHUNK_HEAD,
    FOOTER,
    HEAD,
    MAGIC,
    MESSAGE_HEAD,
    PROFILE,
    TAIL_BYTES,
    Channel,
    ChunkIndex,
    DamagedError,
    Fields,
    Opcode,
    Schema,
)

LARGEST_CHUNK_BYTES = 2**29
"""Unpacked. ROS 2 writes chunks of a few megabytes, or of one larger message."""

LARGEST_RECORD_BYTES = 2**26
"""Of a header, a schema, a channel or the index of one chunk."""

KEPT_BYTES = 2**28
"""Unpacked chunks that are kept while messages of others come between theirs."""

STRETCH_BYTES = 2**20
"""Messages that lie in no chunk are taken together up to this length."""

LARGEST_NS = 2**64 - 1

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


@dataclass(frozen=True)
class McapMessage:
    """One message.

    Attributes:
        channel: number of its topic.
        sequence: number given by its publisher.
        log_time_ns: place in the order of a replay.
        publish_time_ns: when it was published.
        content: serialised.
    """

    channel: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    content: bytes


@dataclass(frozen=True)
class _Part:
    """A chunk, or a stretch of messages that lie in none."""

    start: int
    length: int
    is_chunk: bool
    first_ns: int
    last_ns: int
    channels: frozenset[int]
    index: ChunkIndex | None = None

    def __str__(self) -> str:
        what = "chunk" if self.is_chunk else "stretch of messages"
        times = f"{1e-9 * self.first_ns:.3f} s to {1e-9 * self.last_ns:.3f} s"
        return f"the {what} at byte {self.start} (log times {times})"


class McapFile:
    """An MCAP file of ROS 2, opened for reading; a context manager.

    Args:
        path: the file.
        tolerance: what the file may be; what is wrong with it is in `damage` then.

    Attributes:
        schemas: definitions of message types, by number.
        channels: topics, by number.
        counts: messages of each channel.
        damage: what is wrong with the file, in words; more may come while messages are read.

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
        self._is_finished = True
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.damage: list[str] = []
        self._parts: list[_Part] = []
        try:
            self._size = os.fstat(self._file).st_size
            self._open()
        except BaseException:
            os.close(self._file)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def messages(self, channels: Collection[int]) -> Iterator[McapMessage]:
        """Yield the messages of the given channels by log time, those of equal times as they lie.

        Raises:
            DamagedError: a chunk is damaged or messages lack, and the file may not be damaged.
        """
        wanted = frozenset(channels)
        coming = deque(
            sorted(
                (
                    (part.first_ns, number)
                    for number, part in enumerate(self._parts)
                    if part.channels & wanted
                ),
            )
        )
        contents = _Kept(KEPT_BYTES)
        pending: list[tuple[int, int, int, int]] = []
        found: Counter[int] = Counter()
        while coming or pending:
            while coming and (not pending or coming[0][0] <= pending[0][0]):
                number = coming.popleft()[1]
                part = self._parts[number]
                try:
                    content = self._content(part)
                    places = list(self._places(part, content, wanted))
                except DamagedError as error:
                    self._spoilt(f"is damaged in {part}: {error}")
                    continue
                contents.keep(number, content)
                for place in places:
                    heappush(pending, (place[0], number, *place[1:]))
            if not pending:
                break
            _, number, start, end = heappop(pending)
            kept = contents.get(number)
            if kept is None:
                kept = self._content(self._parts[number])
                contents.keep(number, kept)
            message = _message(kept[start:end])
            found[message.channel] += 1
            yield message
        lacking = sum(max(0, self.counts[channel] - found[channel]) for channel in wanted)
        if lacking and not self.damage:
            self._spoilt(f"lacks {lacking} messages that its index counts")

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
        try:
            self._is_finished = self._has_end()
            is_indexed = self._is_finished and self._read_summary(*self._summary())
        except DamagedError as error:
            self._spoilt(str(error))
            is_indexed = False
        if not is_indexed and start is not None:
            self._scan(start)

    def _header(self) -> int:
        """Return where the data begin."""
        opcode, header, end = self._record(len(MAGIC), LARGEST_RECORD_BYTES)
        if opcode != Opcode.HEADER:
            raise DamagedError("is damaged at byte 8")
        profile = Fields(header).text()
        if profile != PROFILE:
            raise DamagedError(f"its profile is {profile[:40]!r}, expected {PROFILE!r}")
        return end

    def _record(self, start: int, largest: int) -> tuple[int, memoryview, int]:
        """Return opcode and content of a record, and where it ends."""
        head = os.pread(self._file, HEAD.size, start)
        if len(head) < HEAD.size:
            raise DamagedError(f"breaks off at byte {start}")
        opcode, length = HEAD.unpack(head)
        end = start + HEAD.size + length
        if end > self._size:
            raise DamagedError(
                f"breaks off at byte {start}: a record of {length} bytes is begun, "
                f"{self._size - start - HEAD.size} are there"
            )
        if length > largest:
            raise DamagedError(
                f"has a record of {length} bytes at byte {start}, more than the {largest} that are "
                "read"
            )
        content = os.pread(self._file, length, start + HEAD.size)
        if len(content) < length:
            raise DamagedError(f"breaks off at byte {start}")
        return opcode, memoryview(content), end

    def _tail(self) -> bytes:
        return os.pread(self._file, TAIL_BYTES, max(0, self._size - TAIL_BYTES))

    def _has_end(self) -> bool:
        tail = self._tail()
        has_end = (
            len(tail) == TAIL_BYTES
            and tail.startswith(HEAD.pack(Opcode.FOOTER, FOOTER.size))
            and tail.endswith(MAGIC)
        )
        if not has_end:
            words = "was not finished or is cut off: it has no index at its end"
            self._spoilt(words, Tolerance.UNFINISHED)
        return has_end

    def _summary(self) -> tuple[memoryview, int]:
        """Return the summary and where it begins; nothing where the file has none."""
        tail = self._tail()
        start, offsets_start, expected = FOOTER.unpack(tail[HEAD.size : HEAD.size + FOOTER.size])
        if start == 0:
            return memoryview(b""), self._size - TAIL_BYTES
        length = self._size - TAIL_BYTES - start
        if start < len(MAGIC) or length < 0:
            raise DamagedError(f"says that its index is at byte {start}, where it cannot be")
        summary = os.pread(self._file, length, start)
        if expected:
            checked = summary + tail[: HEAD.size] + struct.pack("<QQ", start, offsets_start)
            if zlib.crc32(checked) != expected:
                raise DamagedError("is damaged: the checksum of its index does not match")
        return memoryview(summary), start

    def _read_summary(self, summary: memoryview, end: int) -> bool:
        """Take channels and chunks from the summary; return whether it has them."""
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        counts: Counter[int] = Counter()
        message_count: int | None = None
        parts = []
        for opcode, content, _ in _records(summary):
            if opcode == Opcode.SCHEMA:
                number, schema = Schema.read(content)
                schemas[number] = schema
            elif opcode == Opcode.CHANNEL:
                number, channel = Channel.read(content)
                channels[number] = channel
            elif opcode == Opcode.STATISTICS:
                fields = Fields(content)
                message_count = fields.numbers("QHIIIIQQ")[0]
                entries = Fields(fields.prefixed())
                while entries:
                    number, count = entries.numbers("HQ")
                    counts[number] = count
            elif opcode == Opcode.CHUNK_INDEX:
                parts.append(self._indexed(ChunkIndex.read(content), end))
        indexed = frozenset(number for part in parts for number in part.channels)
        has_all = (
            indexed <= channels.keys()
            and all(channel.schema in schemas for channel in channels.values())
            and (bool(parts) or message_count == 0)
            and message_count == counts.total()
            and all(part.channels for part in parts)
        )
        if has_all:
            self.schemas, self.channels, self.counts, self._parts = schemas, channels, counts, parts
        return has_all

    def _indexed(self, index: ChunkIndex, end: int) -> _Part:
        if not len(MAGIC) <= index.start <= index.start + index.length <= end:
            raise DamagedError(f"has an index of a chunk at byte {index.start}, where none can be")
        return _Part(
            index.start,
            index.length,
            True,
            index.first_ns,
            index.last_ns,
            frozenset(index.message_indexes),
            index,
        )

    def _scan(self, start: int) -> None:
        """Make the index again, from what lies in the file from its header on."""
        while start < self._size:
            try:
                opcode, end = self._next(start)
            except DamagedError as error:
                words = f"{error}; the {self._size - start} bytes from there on cannot be read"
                self._spoilt(words, self._cut())
                return
            if opcode in (0, Opcode.DATA_END, Opcode.FOOTER):
                return
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, self._record(start, LARGEST_RECORD_BYTES)[1])
            elif opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                self._scan_part(start, end - start, is_chunk=opcode == Opcode.CHUNK)
            start = end

    def _next(self, start: int) -> tuple[int, int]:
        """Return opcode and end of a record, of a stretch of messages, or of room left (0)."""
        opcode, length = HEAD.unpack(self._head(start))
        if opcode == Opcode.MESSAGE:
            return opcode, self._stretch(start)
        if opcode == 0 and self._is_zero_from(start):
            return opcode, self._size
        if opcode == 0 or start + HEAD.size + length > self._size:
            raise DamagedError(f"breaks off at byte {start}")
        return opcode, start + HEAD.size + length

    def _cut(self) -> Tolerance:
        """Return what tolerates a break in the file."""
        return Tolerance.DAMAGED if self._is_finished else Tolerance.UNFINISHED

    def _is_zero_from(self, start: int) -> bool:
        while octets := os.pread(self._file, STRETCH_BYTES, start):
            if octets.strip(b"\0"):
                return False
            start += len(octets)
        return True

    def _head(self, start: int) -> bytes:
        head = os.pread(self._file, HEAD.size, start)
        if len(head) < HEAD.size:
            raise DamagedError(f"breaks off at byte {start}")
        return head

    def _stretch(self, start: int) -> int:
        """Return where a stretch of messages ends that lie in no chunk."""
        end = start
        while end < self._size and end - start < STRETCH_BYTES:
            opcode, length = HEAD.unpack(self._head(end))
            if opcode != Opcode.MESSAGE or end + HEAD.size + length > self._size:
                break
            end += HEAD.size + length
        if end == start:
            raise DamagedError(f"breaks off at byte {start}")
        return end

    def _scan_part(self, start: int, length: int, *, is_chunk: bool) -> None:
        """Look at all of a part, and take its topics and times from what is in it."""
        part = _Part(start, length, is_chunk, 0, LARGEST_NS, frozenset())
        try:
            content = self._content(part)
            counts: Counter[int] = Counter()
            times = []
            for opcode, inner, _ in _records(content):
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._define(opcode, inner)
                elif opcode == Opcode.MESSAGE:
                    message = _message(inner)
                    if message.channel not in self.channels:
                        raise DamagedError(f"holds messages of an unknown topic {message.channel}")
                    counts[message.channel] += 1
                    times.append(message.log_time_ns)
        except DamagedError as error:
            what = "chunk" if is_chunk else "messages"
            # Where nothing follows, its writing was cut short.
            is_last = self._is_zero_from(start + length)
            tolerated_by = self._cut() if is_last else Tolerance.DAMAGED
            self._spoilt(f"is damaged in the {what} at byte {start}: {error}", tolerated_by)
            return
        if times:
            self.counts += counts
            found = _Part(start, length, is_chunk, min(times), max(times), frozenset(counts))
            self._parts.append(found)

    def _define(self, opcode: int, content: memoryview) -> None:
        if opcode == Opcode.SCHEMA:
            number, schema = Schema.read(content)
            self.schemas[number] = schema
            return
        number, channel = Channel.read(content)
        if channel.schema not in self.schemas:
            raise DamagedError(f"topic {channel.topic} has no schema")
        self.channels[number] = channel

    def _content(self, part: _Part) -> memoryview:
        """Return the records of a part, their checksum checked."""
        if part.length > LARGEST_CHUNK_BYTES:
            raise DamagedError(
                f"{part.length} bytes, more than the {LARGEST_CHUNK_BYTES} that are read at once"
            )
        octets = os.pread(self._file, part.length, part.start)
        if len(octets) < part.length:
            raise DamagedError("it is cut off")
        if not part.is_chunk:
            return memoryview(octets)
        opcode, length = HEAD.unpack(octets[: HEAD.size])
        if opcode != Opcode.CHUNK or length != part.length - HEAD.size:
            raise DamagedError("no chunk of that length is there")
        fields = Fields(memoryview(octets)[HEAD.size :])
        first_ns, last_ns, size, expected = CHUNK_HEAD.unpack(fields.octets(CHUNK_HEAD.size))
        compression = fields.text()
        packed = fields.octets(fields.number("Q"))
        if part.index is not None and (
            (first_ns, last_ns, size, compression, len(packed))
            != (
                part.index.first_ns,
                part.index.last_ns,
                part.index.size,
                part.index.compression,
                part.index.compressed_size,
            )
        ):
            raise DamagedError("its head differs from the index")
        content = _unpacked(packed, compression, size)
        if expected and zlib.crc32(content) != expected:
            raise DamagedError("its checksum does not match: bytes have changed")
        return content

    def _places(
        self, part: _Part, content: memoryview, wanted: Collection[int]
    ) -> Iterator[tuple[int, int, int]]:
        """Yield log time, start and end of the messages of the wanted channels."""
        for opcode, inner, end in _records(content):
            if opcode != Opcode.MESSAGE:
                continue
            channel, _, log_time_ns, _ = _message_head(inner)
            if channel not in self.channels:
                raise DamagedError(f"holds messages of an unknown topic {channel}")
            if not part.first_ns <= log_time_ns <= part.last_ns:
                raise DamagedError("holds messages of other times than its index says")
            if channel in wanted:
                yield log_time_ns, end - len(inner), end


class _Kept:
    """Unpacked chunks, those used last, within a number of bytes."""

    def __init__(self, largest_bytes: int) -> None:
        self._largest = largest_bytes
        self._size = 0
        self._contents: OrderedDict[int, memoryview] = OrderedDict()

    def keep(self, number: int, content: memoryview) -> None:
        self._contents[number] = content
        self._size += len(content)
        while self._size > self._largest and len(self._contents) > 1:
            self._size -= len(self._contents.popitem(last=False)[1])

    def get(self, number: int) -> memoryview | None:
        content = self._contents.get(number)
        if content is not None:
            self._contents.move_to_end(number)
        return content


def _records(content: memoryview) -> Iterator[tuple[int, memoryview, int]]:
    """Yield opcode and content of the records, and where each ends.

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


def _message_head(content: memoryview) -> tuple[int, int, int, int]:
    if len(content) < MESSAGE_HEAD.size:
        raise DamagedError(f"holds a message of {len(content)} bytes without a head")
    channel, sequence, log_time_ns, publish_time_ns = MESSAGE_HEAD.unpack_from(content)
    return channel, sequence, log_time_ns, publish_time_ns


def _message(content: memoryview) -> McapMessage:
    return McapMessage(*_message_head(content), bytes(content[MESSAGE_HEAD.size :]))


def _unpacked(packed: memoryview, compression: str, size: int) -> memoryview:
    """Return what is packed, of exactly the size that is promised."""
    if size > LARGEST_CHUNK_BYTES:
        raise DamagedError(
            f"unpacks to {size} bytes, more than the {LARGEST_CHUNK_BYTES} that are read at once"
        )
    if not compression:
        content: bytes | memoryview = packed
    elif compression in _UNPACKERS:
        unpacker = _UNPACKERS[compression]()
        try:
            # One byte more than promised, so that more shows.
            content = unpacker.decompress(bytes(packed), size + 1)  # type: ignore[attr-defined]
        # Each library raises errors of its own, and lz4 bare RuntimeErrors.
        except Exception as error:
            raise DamagedError(f"cannot be unpacked ({error})") from error
    else:
        raise DamagedError(f"is packed by {compression!r}, expected lz4, zstd or nothing")
    if len(content) != size:
        raise DamagedError(f"unpacks to {len(content)} bytes or more, its head says {size}")
    return memoryview(content)
