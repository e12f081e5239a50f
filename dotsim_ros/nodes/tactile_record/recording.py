"""A bag written by a thread of its own, behind a queue of bounded memory. Needs no ROS."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dotsim_ros.measured.bag import BagFile, serialized_stamp_ns


@dataclass(frozen=True)
class RecordingSummary:
    """What became of the messages, counted by topic.

    Attributes:
        written: messages in the bag.
        dropped: messages that found the queue full, or came after the disk failed.
        error: why the bag could not be written, or None.
    """

    written: Mapping[str, int]
    dropped: Mapping[str, int]
    error: str | None


class BagRecording:
    """Takes serialised messages without waiting for the disk.

    Args:
        path: folder of the bag, which must not exist; it appears when `close` is called.
        topics: message type of each topic.
        queue_bytes: memory for messages that wait for the disk; what finds it full is dropped.

    Raises:
        FileExistsError: there is something at `path` already.
        ValueError: a message type is not known.
    """

    def __init__(self, path: Path, topics: Mapping[str, str], *, queue_bytes: int) -> None:
        self._bag = BagFile(path)
        self._queue: deque[tuple[str, bytes]] = deque()
        self._queue_bytes = queue_bytes
        self._waiting_bytes = 0
        self._ready = threading.Condition()
        self._is_closing = False
        self._written: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._error: str | None = None
        self._topics = dict(topics)
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
            self._waiting_bytes += len(serialized)
            self._ready.notify()
        return True

    @property
    def error(self) -> str | None:
        """Why the bag cannot be written, or None."""
        return self._error

    def close(self) -> RecordingSummary:
        """Write what waits, finish the bag and return what became of the messages.

        A recording of no message leaves no bag.
        """
        with self._ready:
            self._is_closing = True
            self._ready.notify()
        self._thread.join()
        return RecordingSummary(dict(self._written), dict(self._dropped), self._error)

    def _run(self) -> None:
        item = None
        try:
            with self._bag as bag:
                for topic, message_type in self._topics.items():
                    bag.add_topic(topic, message_type)
                while (item := self._next()) is not None:
                    topic, serialized = item
                    # Acquisition times, so that a replay keeps the pace of the sensor.
                    bag.write_serialized(topic, serialized_stamp_ns(serialized), serialized)
                    self._written[topic] += 1
                if not self._written:
                    bag.discard()
        except (OSError, ValueError) as error:
            with self._ready:
                self._error = str(error)
                self._dropped.update(self._written)
                lost = [*self._queue, *([item] if item is not None else [])]
                self._dropped.update(topic for topic, _ in lost)
                self._written.clear()
                self._queue.clear()

    def _next(self) -> tuple[str, bytes] | None:
        with self._ready:
            while not self._queue and not self._is_closing:
                self._ready.wait()
            if not self._queue:
                return None
            topic, serialized = self._queue.popleft()
            self._waiting_bytes -= len(serialized)
        return topic, serialized
