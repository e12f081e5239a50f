# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads measured presses: the one way from a data set's bags to arrays.

Poses, wrenches and skins are checked message by message before a press is used; images come with
the poses, and the forces, at their own times.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import msg_adapters
from dotsim_ros.data.bag import BagReader
from dotsim_ros.data.data_set import DataSet, DataSetEntry, find_indenter
from dotsim_ros.data.plausibility import ImplausiblePressError, check_press
from dotsim_ros.data.presses import Press, press_of
from dotsim_ros.data.trajectory import (
    MEASURED_TOPICS,
    MESSAGE_TYPES,
    PoseChannel,
    Topics,
    read_trajectory,
)
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, ImageArray, IntArray

LARGEST_LENGTH_M = 0.5
"""Nothing on a fingertip sensor is farther from its base."""

LARGEST_FORCE_N = 500.0

CHANNELS = ("pose", "wrench", "skin")


class BadBagError(ValueError):
    """A bag that cannot be fitted to; the text names bag, message and likely mend."""


@dataclass(frozen=True)
class Observation:
    """A press to fit to.

    Attributes:
        press: what was measured.
        indenter: what pressed.
    """

    press: Press
    indenter: Indenter


@dataclass(frozen=True)
class Omission:
    """A trajectory that was left out.

    Attributes:
        name: of the trajectory.
        reason: why, with the likely mend.
    """

    name: str
    reason: str


def read_observation(
    data_set: DataSet,
    entry: DataSetEntry,
    *,
    skin: SkinMesh,
    has_vertices: bool,
    topics: Topics = MEASURED_TOPICS,
    indenters: str | Path | None = None,
    indenter_of: Callable[[str], Indenter] | None = None,
) -> Observation:
    """Read a press and its indenter.

    Args:
        data_set: that holds it.
        entry: the trajectory.
        skin: at rest; the data set's, or the sensor's own where it has none.
        has_vertices: whether the clouds list the skin's vertices; where not, they may differ.
        topics: where the channels lie.
        indenters: folder of the indenters' meshes; None as `DataSet.indenter_file`.
        indenter_of: finds an indenter by its name instead.

    Raises:
        BadBagError: the bag, or its indenter, cannot be used.
    """
    try:
        vertex_count = skin.vertex_count if has_vertices else None
        check_bag(entry, vertex_count=vertex_count, topics=topics)
        trajectory = read_trajectory(entry.bag, topics=topics, channels=CHANNELS)
        press = press_of(trajectory, name=entry.name, indenter=entry.indenter)
        if indenter_of is None:
            indenter = find_indenter(data_set, entry.indenter, indenters)
        else:
            indenter = indenter_of(entry.indenter)
    except BadBagError:
        raise
    except FileNotFoundError as error:
        raise BadBagError(
            f"{entry.name}: {error}; add the file, or correct the name in dataset.yaml"
        ) from error
    except ValueError as error:
        text = str(error).removeprefix(f"{entry.name}: ")
        raise BadBagError(f"{entry.name}: {text}") from error
    if press.skin_position_m is None and press.force_n is None:
        raise BadBagError(
            f"{entry.name}: neither {topics.skin} nor {topics.wrench} in the bag; record one of "
            "them, or name its topic"
        )
    try:
        check_press(press, indenter, skin, has_vertices=has_vertices)
    except ImplausiblePressError as error:
        raise BadBagError(f"{entry.name}, {_topics_named(str(error), topics)}") from error
    return Observation(press, indenter)


def _topics_named(text: str, topics: Topics) -> str:
    """Return what is wrong with a channel with its topic in the channel's place."""
    channel = next(name for name in CHANNELS if text.startswith(name))
    return str(getattr(topics, channel)) + text.removeprefix(channel)


def read_observations(
    data_set: DataSet,
    names: Sequence[str],
    *,
    skin: SkinMesh,
    has_vertices: bool,
    topics: Topics = MEASURED_TOPICS,
    indenters: str | Path | None = None,
) -> tuple[list[Observation], list[Omission]]:
    """Return what can be used of the named trajectories, and why the others cannot."""
    entries = {entry.name: entry for entry in data_set.entries}
    found, omitted = [], []
    for name in names:
        try:
            found.append(
                read_observation(
                    data_set,
                    entries[name],
                    skin=skin,
                    has_vertices=has_vertices,
                    topics=topics,
                    indenters=indenters,
                )
            )
        except BadBagError as error:
            omitted.append(Omission(name, str(error)))
    return found, omitted


MOST_REASONS = 3


def summarize_reasons(reasons: Sequence[str]) -> str:
    """Return the first reasons on one line, and how many more there are."""
    more = len(reasons) - MOST_REASONS
    return "; ".join(reasons[:MOST_REASONS]) + (f"; and {more} more" if more > 0 else "")


def read_motion(entry: DataSetEntry, *, topics: Topics = MEASURED_TOPICS) -> Press:
    """Read the poses of a press alone, measured or only planned.

    Raises:
        FileNotFoundError: no bag there.
        ValueError: no poses, or poses that make no press.
    """
    check_bag(entry, vertex_count=None, topics=topics, channels=("pose",))
    trajectory = read_trajectory(entry.bag, topics=topics, channels=("pose",))
    return press_of(trajectory, name=entry.name, indenter=entry.indenter)


@dataclass(frozen=True)
class PressImages:
    """Images of a press.

    Attributes:
        press: the motion at the images' times, with the force where it was measured, no skin.
        pixels: (F, H, W, 3) uint8.
        delay_s: from the first pose of the bag to the first image.
    """

    press: Press
    pixels: ImageArray
    delay_s: float


def read_press_images(
    entry: DataSetEntry,
    *,
    idle: ImageArray | None = None,
    topics: Topics = MEASURED_TOPICS,
    most: int | None = None,
) -> PressImages:
    """Read the images of a press, and the motion at their times.

    The force is interpolated to the same times where it was measured; the skin is not read.

    Args:
        entry: the trajectory.
        idle: (H, W, 3) without contact, by the same camera; None where none is known.
        topics: where the channels lie.
        most: frames to keep at most, evenly spread; None for all.

    Raises:
        FileNotFoundError: no bag there.
        ValueError: no image or pose, images of another size, none within the poses' time, or
            channels by different clocks.
    """
    trajectory = read_trajectory(entry.bag, topics=topics, channels=("pose", "wrench", "image"))
    pose, image, wrench = trajectory.pose, trajectory.image, trajectory.wrench
    if image is None:
        raise ValueError(
            f"{entry.bag} holds no image on {topics.image}; record the camera's images, or name "
            "their topic"
        )
    if pose is None:
        raise ValueError(
            f"{entry.bag} holds no pose on {topics.pose}; record the indenter's pose, or name its "
            "topic"
        )
    check_bag(entry, vertex_count=None, topics=topics, channels=("pose", "wrench"))
    if idle is not None and image.pixels.shape[1:] != idle.shape:
        raise ValueError(
            f"{entry.bag}: images are {image.pixels.shape[2]}x{image.pixels.shape[1]}, but the "
            f"idle images {idle.shape[1]}x{idle.shape[0]}; take both with one camera and setting"
        )
    within = (image.stamp_ns >= pose.stamp_ns[0]) & (image.stamp_ns <= pose.stamp_ns[-1])
    frames = np.flatnonzero(within)
    if not len(frames):
        raise ValueError(
            f"{entry.bag}: no image was taken while poses were recorded; record both at once, "
            "stamped by one clock"
        )
    _check_clocks(entry, image.stamp_ns, pose.stamp_ns, topics.image, topics.pose)
    if wrench is not None:
        _check_clocks(entry, wrench.stamp_ns, pose.stamp_ns, topics.wrench, topics.pose)
    _check_seen(entry, image.pixels[frames], pose, topics.image)
    if most is not None and len(frames) > most:
        frames = frames[np.unique(np.linspace(0, len(frames) - 1, most).round().astype(int))]
    stamp_ns = image.stamp_ns[frames]
    stamp_s = 1e-9 * stamp_ns.astype(np.float64)
    force = None
    if wrench is not None:
        times_s = 1e-9 * wrench.stamp_ns.astype(np.float64)
        force = np.stack([np.interp(stamp_s, times_s, axis) for axis in wrench.force_n.T], axis=1)
    poses = _poses_at(stamp_ns, pose.stamp_ns, pose.poses())
    press = Press(entry.name, entry.indenter, poses, stamp_s, force_n=force)
    delay_s = 1e-9 * float(stamp_ns[0] - pose.stamp_ns[0])
    return PressImages(press, image.pixels[frames], delay_s)


MOVED_M = 1.0e-3


def _check_seen(entry: DataSetEntry, pixels: ImageArray, pose: PoseChannel, topic: str) -> None:
    """Refuse images of a camera that stands still: noise alone makes any two differ."""
    way_m = float(np.ptp(pose.position_m, axis=0).max())
    if len(pixels) > 1 and way_m >= MOVED_M and bool((pixels == pixels[0]).all()):
        raise BadBagError(
            f"{entry.name}, {topic}: all {len(pixels)} images are the same to the bit while the "
            f"indenter moves {1e3 * way_m:.1f} mm, expected a live camera; record its images again "
            "or leave the trajectory out"
        )


LARGEST_DELAY_S = 0.5
"""Of one channel after another by the same clock; cameras and arms are late by tenths at most."""


def _check_clocks(
    entry: DataSetEntry, stamp_ns: IntArray, pose_ns: IntArray, topic: str, pose_topic: str
) -> None:
    """Refuse a channel that begins and ends as much later, or earlier, than the poses.

    A channel that is recorded longer than the poses, at one end or both, passes.
    """
    begins_s, ends_s = (
        1e-9 * float(stamp_ns[0] - pose_ns[0]),
        1e-9 * float(stamp_ns[-1] - pose_ns[-1]),
    )
    period_s = 1e-9 * float(np.ptp(stamp_ns)) / max(len(stamp_ns) - 1, 1)
    same = abs(begins_s - ends_s) <= max(0.1, 2.0 * period_s)
    if same and min(abs(begins_s), abs(ends_s)) > LARGEST_DELAY_S and begins_s * ends_s > 0.0:
        raise BadBagError(
            f"{entry.name}, {topic}: begins and ends {abs(begins_s):.2f} s "
            f"{'after' if begins_s > 0.0 else 'before'} {pose_topic}, expected at most "
            f"{LARGEST_DELAY_S} s: two clocks; stamp both on one computer, or shift the stamps"
        )


def _poses_at(wanted_ns: IntArray, stamp_ns: IntArray, poses: Sequence[Pose]) -> list[Pose]:
    """Return the poses at stamps that lie within those of the given ones."""
    found = []
    for wanted in wanted_ns.tolist():
        after = int(np.searchsorted(stamp_ns, wanted))
        if stamp_ns[after] == wanted:
            found.append(poses[after])
            continue
        before = after - 1
        share = (wanted - stamp_ns[before]) / (stamp_ns[after] - stamp_ns[before])
        found.append(interpolate(poses[before], poses[after], float(share)))
    return found


def check_bag(
    entry: DataSetEntry,
    *,
    vertex_count: int | None,
    topics: Topics = MEASURED_TOPICS,
    channels: Sequence[str] = CHANNELS,
) -> None:
    """Look at each message of poses, wrenches and skins in the order of their recording.

    Args:
        entry: the trajectory.
        vertex_count: of the data set's skin; None where clouds may differ.
        topics: where the channels lie.
        channels: which of them to look at.

    Raises:
        BadBagError: a topic of the wrong type, no poses, another frame than the sensor's base,
            stamps out of order, a number that is not finite, lengths in millimetres, another number
            of skin points.
        FileNotFoundError, ValueError: as `BagReader`.
    """
    channel_of = {getattr(topics, channel): channel for channel in channels}
    last: dict[str, int] = {}
    counts = dict.fromkeys(CHANNELS, 0)
    with BagReader(entry.bag) as bag:
        there = bag.topics()
        for topic, channel in channel_of.items():
            if topic in there and there[topic] not in MESSAGE_TYPES[channel]:
                raise BadBagError(
                    f"{entry.name}, {topic}: holds {there[topic]}, expected "
                    f"{' or '.join(MESSAGE_TYPES[channel])}; record that type, or name the topic "
                    "that has it"
                )
        if topics.pose not in there:
            raise BadBagError(
                f"{entry.name}: no message on {topics.pose}; the bag holds "
                f"{', '.join(there) or 'nothing'}; record the indenter's poses "
                "(geometry_msgs/PoseStamped), or name their topic"
            )
        for message in bag.messages(*channel_of):
            channel = channel_of[message.topic]
            place = f"{entry.name}, {message.topic}, message {counts[channel]}"
            counts[channel] += 1
            try:
                content = message.message()
                stamp = msg_adapters.message_stamp_ns(content)
                _check_frame(content, entry.base_frame)
                _CHECKS[channel](content, vertex_count)
            except ValueError as error:
                raise BadBagError(f"{place}: {error}") from error
            if stamp <= last.get(channel, -1):
                raise BadBagError(
                    f"{place}: stamp {stamp} ns does not come after {last[channel]} ns of the "
                    "message before; record with one clock, and each message once"
                )
            last[channel] = stamp


def _check_frame(message: msg_adapters.Message, base_frame: str) -> None:
    found = str(message.header.frame_id)
    if found.removeprefix("/") != base_frame.removeprefix("/"):
        raise ValueError(
            f"frame_id is {found!r}, expected {base_frame!r}, the sensor's base frame; transform "
            "poses, forces and skin into it, or where it only has another name, add the line "
            f"'base_frame: {found or repr('')}' to dataset.yaml"
        )


def _check_length(values: FloatArray, what: str) -> None:
    finite = np.isfinite(values)
    if not finite.all():
        raise ValueError(
            f"the {what} holds a number that is not finite; drop such frames while recording"
        )
    largest = float(np.abs(values).max(initial=0.0))
    if largest > LARGEST_LENGTH_M:
        raise ValueError(
            f"the {what} reaches {largest:.4g} m from the base, expected metres and at most "
            f"{LARGEST_LENGTH_M} m; if these are millimetres, multiply by 0.001"
        )


def _decoded(decode: Callable[[msg_adapters.Message], Any], message: msg_adapters.Message) -> Any:
    try:
        return decode(message)
    except ValueError as error:
        raise ValueError(f"{error}; mend what publishes it, or drop the message") from error


def _check_pose(message: msg_adapters.Message, _vertex_count: int | None) -> None:
    position, _ = _decoded(msg_adapters.decode_pose_stamped, message)
    _check_length(position, "pose")


def _check_wrench(message: msg_adapters.Message, _vertex_count: int | None) -> None:
    force, _ = _decoded(msg_adapters.decode_wrench_stamped, message)
    largest = float(np.abs(force).max())
    if largest > LARGEST_FORCE_N:
        raise ValueError(
            f"the force is {largest:.4g} N, expected newtons and at most {LARGEST_FORCE_N} N; "
            "if these are millinewtons or raw counts, convert them"
        )


def _check_skin(message: msg_adapters.Message, vertex_count: int | None) -> None:
    position = _decoded(msg_adapters.decode_cloud, message).position
    _check_length(position, "skin")
    if vertex_count is not None and len(position) != vertex_count:
        raise ValueError(
            f"the skin has {len(position)} points, the data set's mesh {vertex_count}; record the "
            "vertices of skin_mesh.npz, or remove that file so that points need not correspond"
        )


_CHECKS: dict[str, Callable[[msg_adapters.Message, int | None], None]] = {
    "pose": _check_pose,
    "wrench": _check_wrench,
    "skin": _check_skin,
}
