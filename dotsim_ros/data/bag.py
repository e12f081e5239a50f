# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""ROS 2 bags (mcap) read and written without ROS."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from heapq import merge
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mcap.records import Channel, Schema
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from dotsim_ros.data.bag_metadata import (
    METADATA,
    bag_information,
    metadata_texts,
    read_mcap_names,
)
from dotsim_ros.data.mcap.reader import McapFile, Tolerance
from dotsim_ros.data.mcap.records import DamagedError
from dotsim_ros.data.mcap.writer import McapWriter
from dotsim_ros.io.files import beside
from msg_adapters import BagTypes, Message

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
BAG_TYPES = BagTypes(TYPESTORE.types)
"""Message types for the encoders of `msg_adapters`, to make messages that `BagFile` writes."""

ENCODING = "cdr"
PARTIAL = ".partial"
TYPE_HASH = "topic_type_hash"
"""Where a topic of an mcap file holds the hash of its type's definition, REP-2011."""

_METADATA_BYTES = 2**16
"""Kept free on the disk for metadata.yaml."""


def bag_name(path: str | Path) -> str:
    """Return the name of a bag: that of its folder, or of its file without .mcap or .db3."""
    return beside(os.path.abspath(path), "", replaces=(".mcap", ".db3")).name


def unfinished_path(path: str | Path) -> Path:
    """Return where a recording lies until it is finished: its path plus `.partial`."""
    path = Path(path).absolute()
    return path.with_name(f"{path.name}{PARTIAL}")


class BagFile:
    """A bag that appears at its path when it is whole, and not before.

    A context manager: messages go into a folder next to the path, which takes the bag's name when
    the block ends, and is removed where it ends by an exception. Without a block, `finish` or
    `discard` end it; what was flushed outlives the process.

    Args:
        path: folder of the bag; its name becomes that of the mcap file.
        keep_unfinished: `folder`, where the bag is meanwhile, is that of `unfinished_path`, where
            a user finds it after a crash; else a hidden one.

    Raises:
        FileExistsError: there is something at `path` already, or an unfinished recording of it.
        OSError: it cannot be written.
    """

    def __init__(self, path: str | Path, *, keep_unfinished: bool = False) -> None:
        self.path = Path(path).absolute()
        if self.path.exists():
            raise FileExistsError(f"{self.path} exists already; give another path or remove it")
        if keep_unfinished and unfinished_path(path).exists():
            unfinished = unfinished_path(path)
            raise FileExistsError(
                f"{unfinished} exists already, a recording that was not finished; make a bag of it "
                f"(dotsim_ros record --repair {unfinished}) or remove it first"
            )
        self._is_ended = False
        self._file_name = f"{self.path.name}.mcap"
        self._types: dict[str, str] = {}
        self._type_hashes: dict[str, str] = {}
        self._channels: dict[str, int] = {}
        try:
            self.folder = self._made_folder(keep_unfinished)
            try:
                self._open()
            except OSError:
                shutil.rmtree(self.folder, ignore_errors=True)
                raise
        except OSError as error:
            raise OSError(
                f"no bag can be written to {self.path} ({error.strerror}); give another path"
            ) from error

    def _made_folder(self, keep_unfinished: bool) -> Path:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if keep_unfinished:
            folder = unfinished_path(self.path)
            folder.mkdir()
            return folder
        folder = Path(tempfile.mkdtemp(prefix=".part.", dir=self.path.parent))
        folder.chmod(0o755)
        return folder

    def _open(self) -> None:
        self._writer = McapWriter(self.folder / self._file_name)
        # Kept open, too: at the end there may be no room for another file, nor for its handle.
        self._reserved = (self.folder / f"{METADATA}.reserved").open("x+b")
        try:
            self._reserved.write(bytes(_METADATA_BYTES))
            self._reserved.flush()
        except OSError:
            self._writer.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        if self._is_ended:
            return
        if kind is not None:
            self.discard()
            return
        try:
            self.finish()
        except BaseException:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise

    @property
    def written(self) -> dict[str, int]:
        """Messages of each topic that are in the file; those that wait for `flush` are not."""
        counts = self._writer.statistics.channel_message_counts
        return {topic: counts[number] for topic, number in self._channels.items()}

    def add_topic(self, topic: str, message_type: str) -> None:
        """Declare a topic, so that the bag names it even where no message comes.

        Raises:
            ValueError: a type that the type store does not know, or the topic with another type.
        """
        if message_type not in TYPESTORE.types:
            raise ValueError(f"message type {message_type!r} of topic {topic} is not known")
        if topic in self._types:
            self._check_type(topic, message_type)
            return
        definition, _ = TYPESTORE.generate_msgdef(message_type, ros_version=2)
        schema = Schema(0, definition.encode(), "ros2msg", message_type)
        metadata = {"offered_qos_profiles": "[]", TYPE_HASH: TYPESTORE.hash_rihs01(message_type)}
        self.add_channel(Channel(0, topic, ENCODING, metadata, 0), schema)

    def add_channel(self, channel: Channel, schema: Schema) -> None:
        """Declare a topic of any type, by its definition; the numbers in both are replaced.

        Raises:
            ValueError: the topic was declared with another type.
        """
        if channel.topic in self._types:
            self._check_type(channel.topic, schema.name)
            return
        self._channels[channel.topic] = self._writer.add_channel(channel, schema)
        self._types[channel.topic] = schema.name
        self._type_hashes[channel.topic] = channel.metadata.get(TYPE_HASH, "")

    def _check_type(self, topic: str, message_type: str) -> None:
        if self._types[topic] != message_type:
            raise ValueError(f"topic {topic} holds {self._types[topic]}, got {message_type}")

    def write_serialized(
        self, topic: str, log_time_ns: int, serialized: bytes | memoryview
    ) -> None:
        """Write a serialised (CDR) message of a topic that was declared.

        Raises:
            ValueError: a log time below 0 or beyond 2^63 - 1; nothing is written.
        """
        self._writer.write(self._channels[topic], log_time_ns, serialized)

    def write(self, topic: str, stamp_ns: int, message: Message) -> None:
        """Write a message made with `BAG_TYPES`; declares its topic."""
        message_type = str(message.__msgtype__)
        self.add_topic(topic, message_type)
        self.write_serialized(topic, stamp_ns, TYPESTORE.serialize_cdr(message, message_type))

    def flush(self, *, sync: bool = False) -> None:
        """Write what waits in memory; with `sync`, wait until it is on the disk.

        Raises:
            OSError: it does not fit on the disk; it is lost, and the bag can be finished without.
        """
        self._writer.flush()
        if sync:
            self._writer.sync()

    def finish(self) -> None:
        """Write what waits in memory and the index, and give the bag its name.

        Raises:
            OSError: not all of it fits on the disk; what is written stays in `folder`.
        """
        self._writer.flush()
        self._is_ended = True
        statistics = self._writer.statistics
        topics = [
            (topic, kind, self._type_hashes[topic], self.written[topic])
            for topic, kind in self._types.items()
        ]
        times_ns = statistics.message_start_time, statistics.message_end_time
        metadata, summary = metadata_texts(bag_information(self._file_name, *times_ns, topics))
        self._writer.finish({"rosbag2": {"serialized_metadata": summary}})
        with self._reserved as stream:
            stream.seek(0)
            stream.write(metadata.encode())
            stream.truncate()
        os.rename(self._reserved.name, self.folder / METADATA)
        if self.path.exists():
            raise FileExistsError(f"{self.path} exists by now; the bag is {self.folder}")
        os.rename(self.folder, self.path)
        self.folder = self.path

    def discard(self) -> None:
        """Leave nothing at the path."""
        self._is_ended = True
        self._writer.close()
        self._reserved.close()
        shutil.rmtree(self.folder, ignore_errors=True)


@dataclass(frozen=True)
class BagMessage:
    """One message of a bag, deserialised when asked."""

    topic: str
    message_type: str
    log_time_ns: int
    serialized: bytes
    bag: str = ""

    def message(self) -> Message:
        """Return the message.

        Raises:
            ValueError: its bytes are no such message.
        """
        try:
            return TYPESTORE.deserialize_cdr(self.serialized, self.message_type)
        # Whatever the generated code meets in bytes that are no such message.
        except Exception as error:
            place = f"{self.bag}, {self.topic}" if self.bag else self.topic
            raise ValueError(
                f"{place}: a message of {len(self.serialized)} bytes is no whole "
                f"{self.message_type} ({' '.join(str(error).split())}); record the bag again"
            ) from error


class BagReader:
    """A bag opened for reading; a context manager.

    Checksums are compared where the bag has them, as those written by this package do.

    Args:
        path: folder of the bag, or its .mcap or .db3 file.
        tolerance: what the bag may be; what is wrong with it is in `damage` then. An unfinished
            one may lack its metadata.yaml.

    Raises:
        FileNotFoundError: nothing is there.
        ValueError: what is there is no bag that can be read, is damaged or was not finished.
    """

    def __init__(self, path: str | Path, tolerance: Tolerance = Tolerance.WHOLE) -> None:
        self.path = Path(path)
        self._tolerance = tolerance
        self._damage: list[str] = []
        if not self.path.exists():
            unfinished = unfinished_path(self.path)
            hint = (
                f"; {unfinished} is a recording that was not finished: `dotsim_ros record --repair "
                f"{unfinished}` makes a bag of it"
            )
            raise FileNotFoundError(f"no bag at {self.path}{hint if unfinished.is_dir() else ''}")
        self._stack = ExitStack()
        self._other: AnyReader | None = None
        self._files: list[tuple[Path, McapFile]] = []
        try:
            for file in self._mcap_files():
                self._open_mcap(file)
            if not self._files:
                self._open_other()
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exception: Any) -> None:
        self._stack.close()

    @property
    def damage(self) -> tuple[str, ...]:
        """What is wrong with the bag, in words."""
        found = [f"{file.name} {words}" for file, mcap in self._files for words in mcap.damage]
        return (*self._damage, *found)

    def topics(self) -> dict[str, str]:
        """Return the message type of each topic that holds messages."""
        if self._other is not None:
            return {c.topic: c.msgtype for c in self._other.connections if c.msgcount > 0}
        return {
            channel.topic: mcap.schemas[channel.schema_id].name
            for _, mcap in self._files
            for number, channel in mcap.channels.items()
            if mcap.counts[number] > 0
        }

    def channels(self) -> dict[str, tuple[Channel, Schema]]:
        """Return each topic of an mcap bag with the definition of its messages."""
        return {
            channel.topic: (channel, mcap.schemas[channel.schema_id])
            for _, mcap in self._files
            for channel in mcap.channels.values()
        }

    def messages(self, *topics: str) -> Iterator[BagMessage]:
        """Yield the messages of the given topics in the order of their log time.

        Raises:
            ValueError: the file ends or breaks in the middle.
        """
        if self._other is not None:
            yield from self._other_messages(self._other, topics)
            return
        streams = [self._messages_of(file, mcap, topics) for file, mcap in self._files]
        yield from merge(*streams, key=lambda message: message.log_time_ns)

    def _messages_of(
        self, file: Path, mcap: McapFile, topics: tuple[str, ...]
    ) -> Iterator[BagMessage]:
        wanted = {n: channel for n, channel in mcap.channels.items() if channel.topic in topics}
        types = {n: mcap.schemas[channel.schema_id].name for n, channel in wanted.items()}
        try:
            for message in mcap.messages(wanted):
                yield BagMessage(
                    wanted[message.channel_id].topic,
                    types[message.channel_id],
                    message.log_time,
                    message.data,
                    str(self.path),
                )
        except DamagedError as error:
            raise ValueError(self._damaged(file, error)) from error

    def _mcap_files(self) -> list[Path]:
        """Return the mcap files of the bag, none where its storage is another."""
        if not self.path.is_dir():
            return [self.path] if self.path.suffix == ".mcap" else []
        there = sorted(self.path.glob("*.mcap"))
        try:
            names = read_mcap_names(self.path)
        except (ValueError, OSError) as error:
            if not there:
                raise ValueError(self._no_bag(error)) from error
            if self._tolerance < Tolerance.UNFINISHED:
                raise ValueError(f"{error}; {self._advice()}") from error
            self._damage.append(str(error).removeprefix(f"{self.path}/"))
            return there
        files = [self.path / name for name in names]
        missing = [file.name for file in files if not file.is_file()]
        if missing:
            words = f"{METADATA} names {', '.join(missing)}, which is not there"
            if not there:
                raise ValueError(f"{self.path}: {words}; put it back, or record the bag again")
            if self._tolerance < Tolerance.UNFINISHED:
                raise ValueError(f"{self.path}: {words}; {self._advice()}")
            self._damage.append(words)
            return there
        return files

    def _open_mcap(self, file: Path) -> None:
        try:
            mcap = McapFile(file, self._tolerance)
        except DamagedError as error:
            raise ValueError(self._damaged(file, error)) from error
        except ValueError as error:
            raise ValueError(f"{file} {error}; expected a ROS 2 bag in the format mcap") from error
        self._stack.callback(mcap.close)
        self._files.append((file, mcap))
        for channel in mcap.channels.values():
            if channel.message_encoding != ENCODING:
                raise ValueError(
                    f"{file}: {channel.topic} is encoded as {channel.message_encoding!r}, expected "
                    f"{ENCODING!r}"
                )

    def _open_other(self) -> None:
        """Open a bag in sqlite3 or one that is compressed as a whole."""
        if not self.path.is_dir() and self.path.suffix != ".db3":
            raise ValueError(self._no_bag("its name ends neither in .mcap nor in .db3"))
        try:
            reader = AnyReader([self.path], default_typestore=TYPESTORE)
            reader.open()
        # rosbags lets through whatever a file in disorder makes its code raise.
        except Exception as error:
            raise ValueError(self._no_bag(error)) from error
        self._stack.callback(reader.close)
        self._other = reader

    def _other_messages(self, reader: AnyReader, topics: tuple[str, ...]) -> Iterator[BagMessage]:
        connections = [c for c in reader.connections if c.topic in topics]
        if not connections:
            return
        try:
            for connection, log_time_ns, serialized in reader.messages(connections):
                topic, kind = connection.topic, connection.msgtype
                yield BagMessage(topic, kind, log_time_ns, bytes(serialized), str(self.path))
        except Exception as error:
            words = " ".join(str(error).split())
            raise ValueError(f"{self.path} breaks off while it is read: {words}") from error

    def _no_bag(self, reason: object) -> str:
        return (
            f"{self.path} is no ROS 2 bag that can be read ({' '.join(str(reason).split())}); "
            "expected a folder with "
            f"{METADATA} and an .mcap or .db3 file"
        )

    def _damaged(self, file: Path, error: DamagedError) -> str:
        return f"{file} {error}; {self._advice()}"

    def _advice(self) -> str:
        return f"`dotsim_ros record --repair {self.path}` makes a bag of what can be read"


def bag_sha256(path: str | Path) -> str:
    """Return a hash of the topics, times and serialised messages of a bag, in their order.

    Raises:
        OSError, ValueError: as `BagReader`.
    """
    digest = hashlib.sha256()
    with BagReader(path) as bag:
        for each in bag.messages(*bag.topics()):
            head = f"{each.topic} {each.log_time_ns} {len(each.serialized)}\n"
            digest.update(head.encode() + each.serialized)
    return digest.hexdigest()
