# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A trajectory: what was measured while an indenter pressed the sensor, channel by channel."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from heapq import merge
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import msg_adapters
from dotsim_ros.data.bag import BAG_TYPES, BagFile, BagMessage, BagReader, bag_name
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, IntArray

BASE_FRAME = "densetact_base"
OPTICAL_FRAME = "densetact_optical_frame"


@dataclass(frozen=True)
class Topics:
    """Where the channels of a trajectory lie in a bag. Defaults: those of a measured data set."""

    pose: str = "/indenter/pose"
    wrench: str = "/indenter/wrench"
    skin: str = "/tactile/skin"
    image: str = "/tactile/image_raw/compressed"


MEASURED_TOPICS = Topics()
RECORDED_TOPICS = Topics(wrench="/wrench", skin="/points", image="/image_raw")
"""Topics of a bag that `tactile_record` wrote with its nodes in the root namespace."""


@dataclass(frozen=True)
class PoseChannel:
    """Poses of the indenter's frame in the base frame; quaternions of unit length, scalar last."""

    stamp_ns: IntArray
    position_m: FloatArray
    quaternion_xyzw: FloatArray
    frame_id: str = BASE_FRAME

    @classmethod
    def of(cls, stamp_ns: IntArray, poses: Sequence[Pose]) -> PoseChannel:
        """Return the channel of poses in the base frame."""
        position_m = np.stack([pose.position_m for pose in poses])
        return cls(stamp_ns, position_m, np.stack([pose.quaternion_xyzw for pose in poses]))

    def poses(self) -> list[Pose]:
        """Return the N poses."""
        return [Pose(*each) for each in zip(self.position_m, self.quaternion_xyzw, strict=True)]


@dataclass(frozen=True)
class WrenchChannel:
    """Forces and torques (zero where not measured) of the gel on the indenter, about the frame's
    origin."""

    stamp_ns: IntArray
    force_n: FloatArray
    torque_nm: FloatArray
    frame_id: str = BASE_FRAME


@dataclass(frozen=True)
class SkinChannel:
    """The outer skin (N, V, 3), every frame in the order of the same vertices."""

    stamp_ns: IntArray
    position_m: NDArray[np.float32]
    frame_id: str = BASE_FRAME


@dataclass(frozen=True)
class ImageChannel:
    """The camera's images (N, H, W, 3), red, green, blue."""

    stamp_ns: IntArray
    pixels: NDArray[np.uint8]
    frame_id: str = OPTICAL_FRAME


Channel = PoseChannel | WrenchChannel | SkinChannel | ImageChannel


@dataclass(frozen=True)
class Trajectory:
    """The channels of one recording; each is None where it was not recorded.

    Raises:
        ValueError: stamps that do not increase, or an array of another length or shape.
    """

    pose: PoseChannel | None = None
    wrench: WrenchChannel | None = None
    skin: SkinChannel | None = None
    image: ImageChannel | None = None
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        for name, channel in self.channels().items():
            _check_channel(name, channel)

    def channels(self) -> dict[str, Channel]:
        """Return the channels that are there, by name."""
        named = {name: getattr(self, name) for name in CHANNELS}
        return {name: channel for name, channel in named.items() if channel is not None}


def _check_channel(name: str, channel: Channel) -> None:
    stamps = channel.stamp_ns
    if stamps.ndim != 1 or stamps.size == 0:
        raise ValueError(f"{name} needs (N,) stamps with N of at least 1, got {stamps.shape}")
    falls = np.flatnonzero(np.diff(stamps) <= 0)
    if falls.size:
        raise ValueError(
            f"{name} stamps must increase; frame {falls[0] + 1} is at {stamps[falls[0] + 1]} ns "
            f"after {stamps[falls[0]]} ns"
        )
    for item in fields(channel):
        values = getattr(channel, item.name)
        if isinstance(values, np.ndarray) and len(values) != len(stamps):
            raise ValueError(f"{name} has {len(stamps)} stamps and {len(values)} {item.name}")


@dataclass(frozen=True)
class _Form:
    """How a channel is made of messages of some types, and messages of it: `decode` returns a
    message's row of each of its arrays, `encode` makes a message of such rows."""

    channel: Callable[..., Channel]
    types: tuple[str, ...]
    decode: Callable[[msg_adapters.Message], tuple[NDArray[Any], ...]]
    encode: Callable[..., msg_adapters.Message]


def decode_colour(message: msg_adapters.Message) -> NDArray[np.uint8]:
    """Return the (H, W, 3) uint8 RGB pixels of an Image or a CompressedImage.

    Raises:
        ValueError: the message holds no such image.
    """
    if hasattr(message, "encoding"):
        return msg_adapters.decode_rgb(message)
    pixels = msg_adapters.decode_compressed_image(message)
    return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)


def _decode_skin(message: msg_adapters.Message) -> tuple[NDArray[np.float32]]:
    return (msg_adapters.decode_cloud(message).position.astype(np.float32, copy=False),)


CHANNELS = {
    "pose": _Form(
        PoseChannel,
        ("geometry_msgs/msg/PoseStamped",),
        msg_adapters.decode_pose_stamped,
        msg_adapters.encode_pose_stamped,
    ),
    "wrench": _Form(
        WrenchChannel,
        ("geometry_msgs/msg/WrenchStamped",),
        msg_adapters.decode_wrench_stamped,
        msg_adapters.encode_wrench_stamped,
    ),
    "skin": _Form(
        SkinChannel,
        ("sensor_msgs/msg/PointCloud2",),
        _decode_skin,
        msg_adapters.encode_cloud,
    ),
    "image": _Form(
        ImageChannel,
        ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"),
        lambda message: (decode_colour(message),),
        partial(msg_adapters.encode_image, encoding="rgb8"),
    ),
}
"""The channels by name."""


@dataclass(frozen=True)
class Row:
    """One message of a channel, decoded: its stamp, its frame, and a row of each array."""

    stamp_ns: int
    frame_id: str
    values: tuple[NDArray[Any], ...]


def decoded(message: BagMessage, name: str, place: str) -> Row:
    """Return a message of the channel of a name, decoded; errors begin with its place.

    Raises:
        ValueError: it is malformed.
    """
    content = message.message()
    try:
        values = CHANNELS[name].decode(content)
        stamp_ns = msg_adapters.message_stamp_ns(content)
    except ValueError as error:
        raise ValueError(
            f"{place}: {error}; mend what publishes it, or drop the message"
        ) from error
    return Row(stamp_ns, str(content.header.frame_id), values)


def channel_of(name: str, rows: Sequence[Row]) -> Any:
    """Return the channel that messages make, ordered by their stamps.

    Raises:
        ValueError: their arrays differ in size.
    """
    rows = sorted(rows, key=attrgetter("stamp_ns"))
    columns = list(zip(*(row.values for row in rows), strict=True))
    for column in columns:
        shapes = sorted({array.shape for array in column})
        if len(shapes) > 1:
            raise ValueError(
                f"{name}: messages have arrays from {shapes[0]} to {shapes[-1]}, expected one size "
                "in all"
            )
    stamp_ns = np.array([row.stamp_ns for row in rows], dtype=np.int64)
    return CHANNELS[name].channel(
        stamp_ns, *(np.stack(column) for column in columns), rows[0].frame_id
    )


def check_types(there: Mapping[str, str], topic_of: Mapping[str, str], place: str) -> None:
    """Refuse topics of a bag, with their types, that a channel is not read from.

    Raises:
        ValueError: a topic has another type than its channel's; the text begins with the place.
    """
    for name, topic in topic_of.items():
        types = CHANNELS[name].types
        if topic in there and there[topic] not in types:
            raise ValueError(
                f"{place}, {topic}: holds {there[topic]}, expected {' or '.join(types)} as {name}; "
                "record that type, or name the topic that has it"
            )


def read_trajectory(
    path: str | Path,
    *,
    topics: Topics = MEASURED_TOPICS,
    channels: Iterable[str] = tuple(CHANNELS),
) -> Trajectory:
    """Read a trajectory from a ROS 2 bag (mcap or sqlite3), without ROS.

    Frames are ordered and timed by their headers' stamps, not by when they were recorded. What a
    data set's bag holds is checked by `reading.read_bag` as it is read.

    Args:
        path: folder of the bag.
        topics: where the channels lie in it; a topic that is absent leaves its channel None.
        channels: which of them to read: "pose", "wrench", "skin", "image".

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag; it holds none of the topics; a topic has a type that its channel
            is not read from; or a message is malformed. The text names topic and message.
    """
    topic_of = {name: getattr(topics, name) for name in channels}
    name_of = {topic: name for name, topic in topic_of.items()}
    rows: dict[str, list[Row]] = {}
    with BagReader(path) as bag:
        there = bag.topics()
        check_types(there, topic_of, str(path))
        if not set(name_of) & set(there):
            raise ValueError(
                f"{path} holds none of {', '.join(name_of)}; it holds "
                f"{', '.join(there) or 'no message'}: name its topics"
            )
        for message in bag.messages(*name_of):
            found = rows.setdefault(name_of[message.topic], [])
            place = f"{path}, {message.topic}, message {len(found)}"
            found.append(decoded(message, name_of[message.topic], place))
    try:
        made = {name: channel_of(name, each) for name, each in rows.items()}
        return Trajectory(**made, name=bag_name(path))
    except ValueError as error:
        raise ValueError(f"{path}, {error}") from error


def _messages(
    channel: Channel, topic: str, encode: Callable[..., msg_adapters.Message]
) -> Iterator[tuple[int, str, msg_adapters.Message]]:
    """Yield stamp, topic and message of each row of a channel."""
    _, *arrays, _ = (getattr(channel, item.name) for item in fields(channel))
    for stamp_ns, *values in zip(channel.stamp_ns.tolist(), *arrays, strict=True):
        head = {"stamp_ns": stamp_ns, "frame_id": channel.frame_id, "types": BAG_TYPES}
        yield stamp_ns, topic, encode(*values, **head)


def write_trajectory(
    path: str | Path, trajectory: Trajectory, *, topics: Topics = MEASURED_TOPICS
) -> None:
    """Write a trajectory as a ROS 2 bag (mcap), whole or not at all.

    Images are stored as PNG, exact, where their topic ends in "/compressed", and raw elsewhere.

    Args:
        path: folder of the bag, which must not exist.
        trajectory: what to write; channels of None leave no topic.
        topics: where the channels go.

    Raises:
        FileExistsError: there is something at `path` already.
        ValueError: no channel at all, or numbers that are not finite.
    """
    streams = []
    for name, channel in trajectory.channels().items():
        topic, encode = getattr(topics, name), CHANNELS[name].encode
        if name == "image" and topic.endswith("/compressed"):
            encode = partial(msg_adapters.encode_compressed_image, compression="png")
        streams.append(_messages(channel, topic, encode))
    if not streams:
        raise ValueError("the trajectory has no channel to write")
    with BagFile(path) as bag:
        for stamp_ns, topic, message in merge(*streams, key=lambda item: item[0]):
            bag.write(topic, stamp_ns, message)
