# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A trajectory: what was measured while an indenter pressed the sensor, channel by channel."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields
from heapq import merge
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import msg_adapters
from dotsim_ros.data.bag import BAG_TYPES, BagFile, BagMessage, BagReader, bag_name
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, IntArray

StampedMessage = tuple[int, str, msg_adapters.Message]

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
    """Poses of the indenter's frame in the base frame.

    Attributes:
        stamp_ns: (N,) increasing.
        position_m: (N, 3).
        quaternion_xyzw: (N, 4) of unit length.
        frame_id: the base frame.
    """

    stamp_ns: IntArray
    position_m: FloatArray
    quaternion_xyzw: FloatArray
    frame_id: str = BASE_FRAME

    def poses(self) -> list[Pose]:
        """Return the N poses."""
        return [
            Pose(position, quaternion)
            for position, quaternion in zip(self.position_m, self.quaternion_xyzw, strict=True)
        ]


@dataclass(frozen=True)
class WrenchChannel:
    """Forces and torques of the gel on the indenter.

    Attributes:
        stamp_ns: (N,) increasing.
        force_n: (N, 3).
        torque_nm: (N, 3) about the frame's origin; zero where it was not measured.
        frame_id: the frame they are expressed in.
    """

    stamp_ns: IntArray
    force_n: FloatArray
    torque_nm: FloatArray
    frame_id: str = BASE_FRAME


@dataclass(frozen=True)
class SkinChannel:
    """The outer skin, every frame in the order of the same vertices.

    Attributes:
        stamp_ns: (N,) increasing.
        position_m: (N, V, 3) float32.
        frame_id: the frame of the points.
    """

    stamp_ns: IntArray
    position_m: NDArray[np.float32]
    frame_id: str = BASE_FRAME


@dataclass(frozen=True)
class ImageChannel:
    """The camera's images.

    Attributes:
        stamp_ns: (N,) increasing.
        pixels: (N, H, W, 3) uint8 RGB.
        frame_id: the optical frame.
    """

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


def _pose_channel(messages: list[msg_adapters.Message]) -> PoseChannel:
    decoded = [msg_adapters.decode_pose_stamped(message) for message in messages]
    return PoseChannel(
        _stamps(messages),
        np.stack([position for position, _ in decoded]),
        np.stack([quaternion for _, quaternion in decoded]),
        messages[0].header.frame_id,
    )


def _wrench_channel(messages: list[msg_adapters.Message]) -> WrenchChannel:
    decoded = [msg_adapters.decode_wrench_stamped(message) for message in messages]
    return WrenchChannel(
        _stamps(messages),
        np.stack([force for force, _ in decoded]),
        np.stack([torque for _, torque in decoded]),
        messages[0].header.frame_id,
    )


def _skin_channel(messages: list[msg_adapters.Message]) -> SkinChannel:
    clouds = [msg_adapters.decode_cloud(message).position for message in messages]
    counts = sorted({len(cloud) for cloud in clouds})
    if len(counts) > 1:
        raise ValueError(
            f"skin frames hold from {counts[0]} to {counts[-1]} points; expected the same vertices "
            "in every frame"
        )
    positions = np.stack(clouds).astype(np.float32, copy=False)
    return SkinChannel(_stamps(messages), positions, messages[0].header.frame_id)


def _image_channel(messages: list[msg_adapters.Message]) -> ImageChannel:
    images = [decode_colour(message) for message in messages]
    sizes = sorted({image.shape[:2] for image in images})
    if len(sizes) > 1:
        raise ValueError(f"images change their size, from {sizes[0]} to {sizes[-1]}")
    return ImageChannel(_stamps(messages), np.stack(images), messages[0].header.frame_id)


def _stamps(messages: Iterable[msg_adapters.Message]) -> IntArray:
    return np.array([msg_adapters.message_stamp_ns(m) for m in messages], dtype=np.int64)


CHANNELS: dict[str, Callable[[list[msg_adapters.Message]], Any]] = {
    "pose": _pose_channel,
    "wrench": _wrench_channel,
    "skin": _skin_channel,
    "image": _image_channel,
}
"""How each channel is made of its messages."""

MESSAGE_TYPES = {
    "pose": ("geometry_msgs/msg/PoseStamped",),
    "wrench": ("geometry_msgs/msg/WrenchStamped",),
    "skin": ("sensor_msgs/msg/PointCloud2",),
    "image": ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"),
}
"""Which message types each channel is read from."""


def decode_colour(message: msg_adapters.Message) -> NDArray[np.uint8]:
    """Return the (H, W, 3) uint8 RGB pixels of an Image or a CompressedImage.

    Raises:
        ValueError: the message holds no such image.
    """
    if hasattr(message, "encoding"):
        return msg_adapters.decode_rgb(message)
    pixels = msg_adapters.decode_compressed_image(message)
    return pixels if pixels.ndim == 3 else np.repeat(pixels[..., None], 3, axis=2)


def decode_message(bag_message: BagMessage) -> msg_adapters.Message:
    """Return the message, its stamp checked.

    Raises:
        ValueError: the bytes are no such message, or its stamp is no time.
    """
    message = bag_message.message()
    msg_adapters.message_stamp_ns(message)
    return message


def read_trajectory(
    path: str | Path,
    *,
    topics: Topics = MEASURED_TOPICS,
    channels: Iterable[str] = tuple(CHANNELS),
) -> Trajectory:
    """Read a trajectory from a ROS 2 bag (mcap or sqlite3), without ROS.

    Frames are ordered and timed by their headers' stamps, not by when they were recorded.

    Args:
        path: folder of the bag.
        topics: where the channels lie in it; a topic that is absent leaves its channel None.
        channels: which of them to read: "pose", "wrench", "skin", "image".

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag; it holds none of the topics; a topic has a type that its channel
            is not read from; or a message is malformed. The message names topic and frame.
    """
    path = Path(path)
    wanted = {getattr(topics, name): name for name in channels}
    found: dict[str, list[msg_adapters.Message]] = {}
    with BagReader(path) as bag:
        there = bag.topics()
        for topic, name in wanted.items():
            if topic in there and there[topic] not in MESSAGE_TYPES[name]:
                raise ValueError(
                    f"{path}: {topic} holds {there[topic]}; {name} is read from "
                    f"{' or '.join(MESSAGE_TYPES[name])}"
                )
        if not set(wanted) & set(there):
            raise ValueError(
                f"{path} holds none of {', '.join(wanted)}; it holds "
                f"{', '.join(there) or 'no message'}: name its topics"
            )
        for bag_message in bag.messages(*wanted):
            message = decode_message(bag_message)
            found.setdefault(wanted[bag_message.topic], []).append(message)
    made = {}
    for name, messages in found.items():
        messages.sort(key=msg_adapters.message_stamp_ns)
        try:
            made[name] = CHANNELS[name](messages)
        except ValueError as error:
            raise ValueError(f"{path}, topic {getattr(topics, name)}: {error}") from error
    return Trajectory(**made, name=bag_name(path))


def iterate_images(path: str | Path, topic: str) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield stamps (ns) and (H, W, 3) uint8 RGB images of one topic, one in memory at a time.

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag, or a message is no image.
    """
    with BagReader(path) as bag:
        for bag_message in bag.messages(topic):
            message = decode_message(bag_message)
            yield msg_adapters.message_stamp_ns(message), decode_colour(message)


def _pose_messages(channel: PoseChannel, topic: str) -> Iterator[StampedMessage]:
    for stamp, position, quaternion in zip(
        channel.stamp_ns.tolist(), channel.position_m, channel.quaternion_xyzw, strict=True
    ):
        yield (
            stamp,
            topic,
            msg_adapters.encode_pose_stamped(
                position, quaternion, stamp_ns=stamp, frame_id=channel.frame_id, types=BAG_TYPES
            ),
        )


def _wrench_messages(channel: WrenchChannel, topic: str) -> Iterator[StampedMessage]:
    for stamp, force, torque in zip(
        channel.stamp_ns.tolist(), channel.force_n, channel.torque_nm, strict=True
    ):
        yield (
            stamp,
            topic,
            msg_adapters.encode_wrench_stamped(
                force, torque, stamp_ns=stamp, frame_id=channel.frame_id, types=BAG_TYPES
            ),
        )


def _skin_messages(channel: SkinChannel, topic: str) -> Iterator[StampedMessage]:
    for stamp, position in zip(channel.stamp_ns.tolist(), channel.position_m, strict=True):
        yield (
            stamp,
            topic,
            msg_adapters.encode_cloud(
                position, stamp_ns=stamp, frame_id=channel.frame_id, types=BAG_TYPES
            ),
        )


def _raw_image_messages(channel: ImageChannel, topic: str) -> Iterator[StampedMessage]:
    for stamp, pixels in zip(channel.stamp_ns.tolist(), channel.pixels, strict=True):
        yield (
            stamp,
            topic,
            msg_adapters.encode_image(
                pixels,
                encoding="rgb8",
                stamp_ns=stamp,
                frame_id=channel.frame_id,
                types=BAG_TYPES,
            ),
        )


def _png_image_messages(channel: ImageChannel, topic: str) -> Iterator[StampedMessage]:
    for stamp, pixels in zip(channel.stamp_ns.tolist(), channel.pixels, strict=True):
        yield (
            stamp,
            topic,
            msg_adapters.encode_compressed_image(
                pixels,
                compression="png",
                stamp_ns=stamp,
                frame_id=channel.frame_id,
                types=BAG_TYPES,
            ),
        )


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
    streams: list[Iterator[StampedMessage]] = []
    if trajectory.pose is not None:
        streams.append(_pose_messages(trajectory.pose, topics.pose))
    if trajectory.wrench is not None:
        streams.append(_wrench_messages(trajectory.wrench, topics.wrench))
    if trajectory.skin is not None:
        streams.append(_skin_messages(trajectory.skin, topics.skin))
    if trajectory.image is not None:
        is_compressed = topics.image.endswith("/compressed")
        make = _png_image_messages if is_compressed else _raw_image_messages
        streams.append(make(trajectory.image, topics.image))
    if not streams:
        raise ValueError("the trajectory has no channel to write")
    with BagFile(path) as bag:
        for stamp, topic, message in merge(*streams, key=lambda item: item[0]):
            bag.write(topic, stamp, message)
