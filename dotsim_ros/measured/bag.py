"""ROS 2 bags (mcap) read and written without ROS."""

from __future__ import annotations

import os
import shutil
import struct
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.interfaces import Connection
from rosbags.rosbag2 import ReaderError, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from msg_adapters import BagTypes, Message

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
BAG_TYPES = BagTypes(TYPESTORE.types)
"""Message types for the encoders of `msg_adapters`, to make messages that `BagFile` writes."""

BAG_VERSION: Literal[9] = 9

_CDR_LITTLE_ENDIAN = 1
_STAMP_END = 12


def serialized_stamp_ns(serialized: bytes | memoryview) -> int:
    """Return the header's stamp of a serialised (CDR) message whose first field is its header.

    Raises:
        ValueError: the message is too short to hold a header.
    """
    if len(serialized) < _STAMP_END:
        raise ValueError(f"serialised message of {len(serialized)} bytes holds no header")
    order = "<" if serialized[1] & _CDR_LITTLE_ENDIAN else ">"
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", serialized, 4)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


class BagFile:
    """A bag that appears at its path when it is whole, and not before.

    A context manager: messages go into a folder beside the path, which takes the bag's name when
    the block ends, and is removed where it ends by an exception.

    Args:
        path: folder of the bag; its name becomes that of the mcap file.

    Raises:
        FileExistsError: there is something at `path` already.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).absolute()
        if self.path.exists():
            raise FileExistsError(f"{self.path} exists already; give another path or remove it")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._folder = Path(tempfile.mkdtemp(prefix=f".{self.path.name}.", dir=self.path.parent))
        self._writer = Writer(
            self._folder / self.path.name,
            version=BAG_VERSION,
            storage_plugin=StoragePlugin.MCAP,
        )
        self._connections: dict[str, Connection] = {}
        self._is_discarded = False

    def __enter__(self) -> Self:
        self._writer.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        try:
            self._writer.close()
            if kind is None and not self._is_discarded:
                os.replace(self._folder / self.path.name, self.path)
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def discard(self) -> None:
        """Leave nothing at the path when the block ends."""
        self._is_discarded = True

    def add_topic(self, topic: str, message_type: str) -> None:
        """Declare a topic, so that the bag names it even where no message comes.

        Raises:
            ValueError: a type that the type store does not know, or the topic with another type.
        """
        known = self._connections.get(topic)
        if known is not None:
            if known.msgtype != message_type:
                raise ValueError(f"topic {topic} holds {known.msgtype}, got {message_type}")
            return
        if message_type not in TYPESTORE.types:
            raise ValueError(f"message type {message_type!r} of topic {topic} is not known")
        self._connections[topic] = self._writer.add_connection(
            topic, message_type, typestore=TYPESTORE
        )

    def write_serialized(self, topic: str, stamp_ns: int, serialized: bytes | memoryview) -> None:
        """Write a serialised (CDR) message of a topic that was declared."""
        self._writer.write(self._connections[topic], stamp_ns, serialized)

    def write(self, topic: str, stamp_ns: int, message: Message) -> None:
        """Write a message made with `BAG_TYPES`; declares its topic."""
        message_type = str(message.__msgtype__)
        self.add_topic(topic, message_type)
        self.write_serialized(topic, stamp_ns, TYPESTORE.serialize_cdr(message, message_type))


@dataclass(frozen=True)
class BagMessage:
    """One message of a bag, deserialised when asked."""

    topic: str
    message_type: str
    log_time_ns: int
    serialized: bytes

    def message(self) -> Message:
        """Return the message.

        Raises:
            ValueError: its bytes are no such message.
        """
        try:
            return TYPESTORE.deserialize_cdr(self.serialized, self.message_type)
        except Exception as error:
            raise ValueError(
                f"{self.topic}: a message of {len(self.serialized)} bytes is no whole "
                f"{self.message_type}: {error}"
            ) from error


class BagReader:
    """A bag opened for reading; a context manager.

    Args:
        path: folder of the bag, or its .mcap file.

    Raises:
        FileNotFoundError: nothing is there.
        ValueError: what is there is no bag that can be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if not self.path.exists():
            raise FileNotFoundError(f"no bag at {self.path}")
        try:
            self._reader = AnyReader([self.path], default_typestore=TYPESTORE)
            self._reader.open()
        except (
            AnyReaderError,
            ReaderError,
            OSError,
            ValueError,
            KeyError,
            AssertionError,
        ) as error:
            raise ValueError(
                f"{self.path} is no ROS 2 bag that can be read ({error}); expected a folder with "
                "metadata.yaml and an .mcap or .db3 file"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: Any) -> None:
        with suppress(AnyReaderError, AssertionError):
            self._reader.close()

    def topics(self) -> dict[str, str]:
        """Return the message type of each topic that holds messages."""
        return {c.topic: c.msgtype for c in self._reader.connections if c.msgcount > 0}

    def messages(self, *topics: str) -> Iterator[BagMessage]:
        """Yield the messages of the given topics in the order of their log time.

        Raises:
            ValueError: the file ends or breaks in the middle.
        """
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:
            return
        try:
            for connection, log_time_ns, serialized in self._reader.messages(connections):
                yield BagMessage(
                    connection.topic, connection.msgtype, log_time_ns, bytes(serialized)
                )
        except (AnyReaderError, ReaderError, AssertionError, struct.error) as error:
            raise ValueError(f"{self.path} breaks off while it is read: {error}") from error
