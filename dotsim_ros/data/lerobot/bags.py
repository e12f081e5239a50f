# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags as episodes of a LeRobotDataset, and its episodes as bags.

A frame of the data set is an image of the bag (where there is none, a pose, a wrench or a state of
the joints) with the newest of all else at its stamp. `stamp_ns.NAME` keeps the stamp of each, so
that the way back gives every message that a frame shows, bit for bit; images only as PNG, since
MP4 loses some. What lies between two frames, and the efforts of joints, is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import msg_adapters
from dotsim_ros.data.bag import BAG_TYPES, BagFile, BagReader
from dotsim_ros.data.lerobot.reader import Episode, LeRobotReader
from dotsim_ros.data.lerobot.writer import LeRobotWriter
from dotsim_ros.data.trajectory import (
    BASE_FRAME,
    MEASURED_TOPICS,
    OPTICAL_FRAME,
    Topics,
    decode_colour,
    read_trajectory,
)
from dotsim_ros.io.arrays import ImageArray, IntArray
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import write_json
from dotsim_ros.io.printable import placed

IMAGE = "observation.images.gel"
STATE = "observation.state"
"""The positions of the joints; without an arm, the pose of the indenter."""
POSE = "observation.tactile.indenter_pose"
WRENCH = "observation.tactile.wrench"
SKIN = "observation.tactile.skin"
VELOCITIES = "observation.velocity"
CLOCKS = ("image", "pose", "wrench", "joints", "skin")
"""The first of these that a bag has gives the frames their times."""
STAMP = "stamp_ns."
POSE_NAMES = ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
WRENCH_NAMES = ["fx_n", "fy_n", "fz_n", "tx_nm", "ty_nm", "tz_nm"]
NAMES = {
    STATE: POSE_NAMES,
    POSE: POSE_NAMES,
    WRENCH: WRENCH_NAMES,
    SKIN: None,
}
JOINT_TYPE, JOINTS_TOPIC = "sensor_msgs/msg/JointState", "/joint_states"
TASK = "touch"
"""What is done, where nobody said."""
ORIGIN = "meta/dotsim_ros.json"
"""Topics and frames of the bags that a data set was made of."""

Array = NDArray[Any]


@dataclass(frozen=True)
class Recording:
    """What a bag holds for a data set.

    Attributes:
        stamps_ns: of each channel.
        arrays: (N, ...) of each key but the image's.
        names: of the entries of a key.
        topics, frames: of each channel, for the way back.
        image_shape: (H, W, 3), or None without images.
    """

    path: Path
    stamps_ns: dict[str, IntArray]
    arrays: dict[str, Array]
    names: dict[str, Any]
    topics: dict[str, str]
    frames: dict[str, str]
    image_shape: tuple[int, ...] | None

    def clock(self) -> str:
        """Return the channel whose messages are the frames."""
        return next(name for name in CLOCKS if name in self.stamps_ns)

    def images(self, wanted: set[int]) -> Iterator[ImageArray]:
        """Yield the images of the wanted stamps, one in memory at a time."""
        with BagReader(self.path) as bag, placed(f"{self.path}, {self.topics['image']}"):
            for message in bag.messages(self.topics["image"]):
                if msg_adapters.serialized_stamp_ns(message.serialized) in wanted:
                    yield decode_colour(message.message())


def read_recording(path: Path, topics: Topics, joints: str | None) -> Recording:
    """Read all but the images of a bag.

    Args:
        path: of the bag.
        topics: where its channels lie; absent ones are left out.
        joints: topic of the joints' states; None: the only one of that type, if any.

    Raises:
        FileNotFoundError: no such bag.
        ValueError: it cannot be read, stamps do not increase, or it holds none of the channels.
    """
    stamps_ns: dict[str, IntArray] = {}
    arrays: dict[str, Array] = {}
    names: dict[str, Any] = dict(NAMES)
    frames: dict[str, str] = {}
    shape = None
    with BagReader(path) as bag:
        there = bag.topics()
        if joints is None:
            joints = next((topic for topic, kind in there.items() if kind == JOINT_TYPE), None)
        topic_of = {**vars(topics), "joints": joints}
        topic_of = {name: topic for name, topic in topic_of.items() if topic in there}
        if not topic_of:
            raise ValueError(
                f"{path} holds no image, pose, wrench, skin or state of joints; it holds "
                f"{', '.join(there) or 'no message'}: name its topics"
            )
        if "image" in topic_of:
            found = []
            for message in bag.messages(topic_of["image"]):
                found.append(msg_adapters.serialized_stamp_ns(message.serialized))
                if shape is None:
                    content = message.message()
                    with placed(f"{path}, {message.topic}"):
                        shape = decode_colour(content).shape
                    frames["image"] = str(content.header.frame_id)
            stamps_ns["image"] = np.array(found)
        if "joints" in topic_of:
            states = [each.message() for each in bag.messages(topic_of["joints"])]
            with placed(f"{path}, {joints}"):
                names[STATE] = names[VELOCITIES] = list(states[0].name)
                stamps_ns["joints"] = np.array([msg_adapters.message_stamp_ns(s) for s in states])
                arrays |= _joint_arrays(states, names[STATE])
            frames["joints"] = str(states[0].header.frame_id)
    channels = [name for name in ("pose", "wrench", "skin") if name in topic_of]
    if channels:
        trajectory = read_trajectory(path, topics=topics, channels=channels)
        for name, channel in trajectory.channels().items():
            stamps_ns[name], frames[name] = channel.stamp_ns, channel.frame_id
        if (pose := trajectory.pose) is not None:
            arrays[POSE if "joints" in topic_of else STATE] = np.hstack(
                [pose.position_m, pose.quaternion_xyzw]
            )
        if (wrench := trajectory.wrench) is not None:
            arrays[WRENCH] = np.hstack([wrench.force_n, wrench.torque_nm])
        if trajectory.skin is not None:
            arrays[SKIN] = trajectory.skin.position_m
    for name, stamps in stamps_ns.items():
        if (np.diff(stamps) <= 0).any():
            at = int(np.argmax(np.diff(stamps) <= 0))
            raise ValueError(
                f"{path}, {topic_of[name]}: the stamp {stamps[at + 1]} ns follows {stamps[at]} ns, "
                "expected stamps that increase; mend the clock, and record again"
            )
    return Recording(path, stamps_ns, arrays, names, topic_of, frames, shape)


def _joint_arrays(states: list[Any], names: list[str]) -> dict[str, Array]:
    has_velocities = len(states[0].velocity) > 0
    if not has_velocities:
        for state in states:
            state.velocity = np.zeros(len(state.name))
    rows = [msg_adapters.decode_joint_state(state, names) for state in states]
    positions, velocities = (np.stack(column) for column in zip(*rows, strict=True))
    return {STATE: positions} | ({VELOCITIES: velocities} if has_velocities else {})


def _channel(key: str, names: Any) -> str:
    """Return the channel of a key whose entries have these names."""
    if key == POSE or (key == STATE and names == POSE_NAMES):
        return "pose"
    return {WRENCH: "wrench", SKIN: "skin"}.get(key, "joints")


def check_absent(folder: Path) -> None:
    """Raise FileExistsError where there is something already."""
    if folder.exists():
        raise FileExistsError(f"{folder} exists already; give another path or remove it")


def bags_to_lerobot(
    bags: Sequence[Path],
    folder: Path,
    warn: Callable[[str], None],
    *,
    topics: Callable[[Path], Topics],
    joints: str | None = None,
    is_video: bool = False,
    task: str = TASK,
) -> int:
    """Write bags as the episodes of a new data set, and return the number of its frames.

    Args:
        bags: an episode each.
        folder: of the data set; must not exist.
        warn: takes what is left out, a sentence each.
        topics: returns where a bag has its channels.
        joints: as `read_recording`.
        is_video: images as MP4, not as PNG.
        task: what is done, in words.

    Raises:
        FileNotFoundError: no such bag.
        FileExistsError: there is something at `folder`.
        ValueError: a bag cannot be read, or holds other channels than the first.
        OSError: no room; the episodes before are whole.
    """
    check_absent(folder)
    writer: LeRobotWriter | None = None
    for path in bags:
        recording = read_recording(path, topics(path), joints)
        features = _features(recording, is_video=is_video)
        frame_ns = recording.stamps_ns[recording.clock()]
        # Of each channel, the newest message at each frame; frames before the first have none.
        newest = {
            name: np.searchsorted(stamps, frame_ns, side="right") - 1
            for name, stamps in recording.stamps_ns.items()
        }
        is_whole = np.min(list(newest.values()), axis=0) >= 0
        if not is_whole.any():
            raise ValueError(f"{path}: the topics share no time; expected one recording of all")
        newest = {name: index[is_whole] for name, index in newest.items()}
        for name, index in newest.items():
            count = len(recording.stamps_ns[name])
            if left := count - len(np.unique(index)):
                warn(
                    f"{path}: {left} of {count} messages on {recording.topics[name]} lie between "
                    "frames and are left out"
                )
        if writer is None:
            fps = (
                max(1, round(1e9 / float(np.median(np.diff(frame_ns))))) if len(frame_ns) > 1 else 1
            )
            first, writer = features, LeRobotWriter(folder, features, fps)
            origin = {"topics": recording.topics, "frames": recording.frames}
        elif features != first:
            raise ValueError(f"{path} holds other channels than {bags[0]}, expected the same")
        frames: dict[str, Any] = {
            key: array[newest[_channel(key, recording.names[key])]]
            for key, array in recording.arrays.items()
        }
        for name, index in newest.items():
            frames[f"{STAMP}{name}"] = recording.stamps_ns[name][index]
        if recording.image_shape is not None:
            frames[IMAGE] = recording.images(set(frame_ns[is_whole].tolist()))
        writer.add_episode(frames, task)
        writer.flush()
        write_json(folder / ORIGIN, origin)
    assert writer is not None
    return writer.frame_count


def _features(recording: Recording, *, is_video: bool) -> dict[str, dict[str, Any]]:
    features: dict[str, dict[str, Any]] = {
        key: {"dtype": str(array.dtype), "shape": array.shape[1:], "names": recording.names[key]}
        for key, array in recording.arrays.items()
    }
    for name in recording.stamps_ns:
        features[f"{STAMP}{name}"] = {"dtype": "int64", "shape": (1,)}
    if recording.image_shape is not None:
        features[IMAGE] = {
            "dtype": "video" if is_video else "image",
            "shape": recording.image_shape,
            "names": ["height", "width", "channels"],
        }
    return features


def lerobot_to_bags(folder: Path, out: Path, warn: Callable[[str], None]) -> list[Path]:
    """Write the episodes of a data set as bags out/episode_000000 and on, and return their paths.

    Of a data set that no bag was made into, the frames' times are their numbers over the rate, each
    camera NAME goes to /NAME/image_raw/compressed, and a state that is no pose to /joint_states.

    Args:
        folder: of the data set.
        out: folder of the bags.
        warn: takes what is left out, a sentence each.

    Raises:
        FileNotFoundError: no such data set.
        FileExistsError: a bag is there already.
        ValueError: the data set cannot be read, or holds nothing that a bag takes.
        OSError: no room; the bags before are whole.
    """
    reader = LeRobotReader(folder)
    origin = read_json(folder / ORIGIN) if (folder / ORIGIN).is_file() else {}
    topics = {**vars(MEASURED_TOPICS), "joints": JOINTS_TOPIC, **origin.get("topics", {})}
    frames = {"image": OPTICAL_FRAME, **origin.get("frames", {})}
    known = [key for key in (POSE, WRENCH, SKIN, STATE) if key in reader.features]
    if not (known or reader.image_keys()):
        raise ValueError(f"{folder} holds no image and nothing of a sensor or an arm")
    left = [
        key
        for key in reader.features
        if key.startswith(("observation.", "action"))
        and key not in (*known, *reader.image_keys(), VELOCITIES)
    ]
    if left:
        warn(f"{folder}: left out, for lack of a topic: {', '.join(left)}")
    written = []
    for episode in reader.episodes():
        streams = [
            _images(reader, episode, key, topics["image"], frames["image"])
            for key in reader.image_keys()
        ]
        for key in known:
            names = reader.features[key].get("names")
            name = _channel(key, names)
            encode = _encoder(name, episode.arrays[key], names, episode.arrays.get(VELOCITIES))
            streams.append(
                _messages(
                    _stamps_ns(reader, episode, name),
                    topics[name],
                    iter(range(len(episode.arrays[key]))),
                    partial(encode, frame_id=frames.get(name, BASE_FRAME), types=BAG_TYPES),
                )
            )
        path = out / f"episode_{episode.index:06d}"
        with BagFile(path) as bag, placed(f"{folder}, episode {episode.index}"):
            for stamp_ns, topic, message in merge(*streams, key=itemgetter(0)):
                bag.write(topic, stamp_ns, message)
        written.append(path)
    return written


def _stamps_ns(reader: LeRobotReader, episode: Episode, name: str) -> IntArray:
    given = episode.arrays.get(f"{STAMP}{name}")
    if given is not None:
        return given.reshape(-1)
    numbers = np.arange(len(episode.arrays["frame_index"]))
    return np.rint(numbers * (1e9 / reader.fps)).astype(np.int64)


def _messages(
    stamps_ns: IntArray, topic: str, rows: Iterator[Any], encode: Callable[..., Any]
) -> Iterator[tuple[int, str, msg_adapters.Message]]:
    """Yield stamp, topic and message of each row; frames that show one again give none."""
    before = None
    for stamp_ns, row in zip(stamps_ns.tolist(), rows, strict=True):
        if stamp_ns != before:
            yield stamp_ns, topic, encode(row, stamp_ns=stamp_ns)
        before = stamp_ns


def _images(
    reader: LeRobotReader, episode: Episode, key: str, topic: str, frame_id: str
) -> Iterator[tuple[int, str, msg_adapters.Message]]:
    if key != IMAGE:
        topic = f"/{key.rpartition('.')[2]}/image_raw/compressed"
    encode = (
        partial(msg_adapters.encode_compressed_image, compression="png")
        if topic.endswith("/compressed")
        else partial(msg_adapters.encode_image, encoding="rgb8")
    )
    return _messages(
        _stamps_ns(reader, episode, "image"),
        topic,
        reader.images(episode, key),
        partial(encode, frame_id=frame_id, types=BAG_TYPES),
    )


def _encoder(
    channel: str, rows: Array, names: Any, velocities: Array | None
) -> Callable[..., msg_adapters.Message]:
    """Return what makes a message of the row of a number."""
    if channel == "skin":
        return lambda row, **head: msg_adapters.encode_cloud(rows[row], **head)
    if channel in ("pose", "wrench"):
        encode = (
            msg_adapters.encode_pose_stamped
            if channel == "pose"
            else msg_adapters.encode_wrench_stamped
        )
        return lambda row, **head: encode(rows[row, :3], rows[row, 3:], **head)
    joints = [f"joint{n}" for n in range(rows.shape[1])]
    if isinstance(names, list) and list(map(type, names)) == [str] * len(joints):
        joints = names

    def state(row: int, **head: Any) -> msg_adapters.Message:
        velocity = np.zeros(len(joints)) if velocities is None else velocities[row]
        message = msg_adapters.encode_joint_state(joints, rows[row], velocity, **head)
        if velocities is None:
            message.velocity = np.zeros(0)
        return message

    return state
