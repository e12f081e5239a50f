# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A bag written by a thread of its own, behind a queue of bounded memory. Needs no ROS."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dotsim_ros.data.bag import BagFile
from msg_adapters import serialized_stamp_ns

FLUSH_PERIOD_S = 0.5
"""No message waits longer than this in memory, unless the disk does not keep up."""

BACK_NS = 100_000_000
"""Stamps of one topic that go back by more are those of a time that has begun again."""

_HEADER_BYTES = 12
_FLUSH = ("", b"")
"""In the queue: bring what came before to the disk."""


@dataclass(frozen=True)
class RecordingSummary:
    """What became of the messages, counted by topic.

    Attributes:
        written: messages in the bag.
        waiting: taken and not in the bag yet; none once the recording is closed.
        dropped: messages that found the queue full, or came after the recording broke off.
        lost: messages that were taken and are not in the bag, since the recording broke off.
        refused: messages too short to hold a header.
        stamp_is_no_time: messages in the bag whose stamp is negative or malformed; they lie at the
            log time of the message before.
        went_back: how often the stamps of a topic went back: time began again.
        error: why the recording broke off, or None.
        folder: where the bag is.
    """

    written: Mapping[str, int]
    waiting: int
    dropped: Mapping[str, int]
    lost: Mapping[str, int]
    refused: Mapping[str, int]
    stamp_is_no_time: Mapping[str, int]
    went_back: Mapping[str, int]
    error: str | None
    folder: Path

    @property
    def missing(self) -> int:
        """How many messages came and are not in the bag, for whatever reason."""
        parts = (self.dropped, self.lost, self.refused)
        return sum(sum(counts.values()) for counts in parts)


class BagRecording:
    """Takes serialised messages without waiting for the disk.

    What is written can be read again whatever happens: until `close` it lies in the folder that
    `unfinished_path` names, no more than the flush period behind, without an index; where the disk
    fails, the bag is finished with what it took.

    Args:
        path: folder of the bag, which must not exist; it appears when `close` is called.
        topics: message type of each topic.
        queue_bytes: memory for messages that wait for the disk; what finds it full is dropped.
        flush_period_s: longest time that a message waits in memory; None: until `flush`, so that
            the same messages make the same file.

    Raises:
        FileExistsError: there is something at `path` already, or an unfinished recording of it.
        OSError: it cannot be written.
        ValueError: a message type is not known.
    """

    def __init__(
        self,
        path: Path,
        topics: Mapping[str, str],
        *,
        queue_bytes: int,
        flush_period_s: float | None = FLUSH_PERIOD_S,
    ) -> None:
        self._bag = BagFile(path, keep_unfinished=True)
        try:
            for topic, message_type in topics.items():
                self._bag.add_topic(topic, message_type)
        except ValueError:
            self._bag.discard()
            raise
        self._queue: deque[tuple[str, bytes]] = deque()
        self._queue_bytes = queue_bytes
        self._waiting_bytes = 0
        self._ready = threading.Condition()
        self._is_closing = False
        self._taken: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._stamp_is_no_time: Counter[str] = Counter()
        self._went_back: Counter[str] = Counter()
        self._last_ns: dict[str, int] = {}
        self._newest_ns: int | None = None
        self._error: str | None = None
        self._flush_period_s = flush_period_s
        self._flush_s: float | None = None
        self._thread = threading.Thread(target=self._run, name="recording")
        self._thread.start()

    def put(self, topic: str, serialized: bytes) -> bool:
        """Queue a message; return False where it is dropped."""
        with self._ready:
            is_full = self._waiting_bytes + len(serialized) > self._queue_bytes
            if is_full or self._error is not None or self._is_closing:
                self._dropped[topic] += 1
                return False
            self._queue.append((topic, serialized))
            self._taken[topic] += 1
            self._waiting_bytes += len(serialized)
            self._ready.notify()
        return True

    def flush(self) -> None:
        """Have what was queued so far brought to the disk."""
        with self._ready:
            self._queue.append(_FLUSH)
            self._ready.notify()

    @property
    def error(self) -> str | None:
        """Why the recording broke off, or None."""
        return self._error

    def summary(self) -> RecordingSummary:
        """Return what became of the messages up to now."""
        with self._ready:
            # Somebody may have removed the folder.
            is_there = self._bag.folder.is_dir()
            written = Counter(self._bag.written if is_there else {})
            left = self._taken - written - self._refused
            is_over = not self._thread.is_alive()
            return RecordingSummary(
                written=+written,
                waiting=0 if is_over else left.total(),
                dropped=dict(self._dropped),
                lost=dict(left) if is_over else {},
                refused=dict(self._refused),
                stamp_is_no_time=dict(self._stamp_is_no_time),
                went_back=dict(self._went_back),
                error=self._error,
                folder=self._bag.folder,
            )

    def close(self) -> RecordingSummary:
        """Write what waits, finish the bag and return what became of the messages.

        A recording of no message leaves no bag.
        """
        with self._ready:
            self._is_closing = True
            self._ready.notify()
        self._thread.join()
        return self.summary()

    def _run(self) -> None:
        # Whatever goes wrong: what came before must become a bag, and the reason must be told.
        for step in (self._write_all, self._bag.flush, self._end):
            try:
                step()
            except Exception as error:
                self._break_off(error)

    def _write_all(self) -> None:
        while (item := self._next()) is not None:
            if item is _FLUSH:
                self._bag.flush(sync=True)
            else:
                self._write(*item)

    def _end(self) -> None:
        if any(self._bag.written.values()):
            self._bag.finish()
        else:
            self._bag.discard()

    def _break_off(self, error: Exception) -> None:
        words = str(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
        with self._ready:
            if self._error is None:
                self._error = words
            elif words not in self._error:
                self._error += f"; then {words}"
            self._queue.clear()
            self._waiting_bytes = 0

    def _write(self, topic: str, serialized: bytes) -> None:
        if len(serialized) < _HEADER_BYTES:
            self._refused[topic] += 1
            return
        try:
            # Acquisition times, so that a replay keeps the pace of the sensor.
            log_time_ns = serialized_stamp_ns(serialized)
            self._newest_ns = max(self._newest_ns or 0, log_time_ns)
            if log_time_ns < self._last_ns.get(topic, 0) - BACK_NS:
                self._went_back[topic] += 1
            self._last_ns[topic] = log_time_ns
        except ValueError:
            # A recorder keeps what came; who reads it finds the stamp in the message.
            self._stamp_is_no_time[topic] += 1
            log_time_ns = time.time_ns() if self._newest_ns is None else self._newest_ns
        self._bag.write_serialized(topic, log_time_ns, serialized)
        if self._flush_s is None and self._flush_period_s is not None:
            self._flush_s = time.monotonic() + self._flush_period_s

    def _next(self) -> tuple[str, bytes] | None:
        """Return the next message, None at the end; flush when it is time."""
        while True:
            if self._flush_s is not None and time.monotonic() >= self._flush_s:
                self._flush_s = None
                self._bag.flush(sync=True)
            with self._ready:
                if not self._queue and not self._is_closing:
                    left_s = None if self._flush_s is None else self._flush_s - time.monotonic()
                    self._ready.wait(left_s)
                if self._queue:
                    item = self._queue.popleft()
                    self._waiting_bytes -= len(item[1])
                    return item
                if self._is_closing:
                    return None
