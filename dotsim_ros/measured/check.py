"""Measured presses to fit to, each bag checked message by message before it is used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import msg_adapters
from dotsim_ros.arrays import FloatArray
from dotsim_ros.geometry.indenter import Indenter, load_mesh
from dotsim_ros.measured.bag import BagReader
from dotsim_ros.measured.data_set import DataSet, DataSetEntry
from dotsim_ros.measured.presses import Press, press_of
from dotsim_ros.measured.trajectory import (
    MEASURED_TOPICS,
    MESSAGE_TYPES,
    Topics,
    read_trajectory,
)

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
    vertex_count: int | None,
    topics: Topics = MEASURED_TOPICS,
) -> Observation:
    """Read a press and its indenter.

    Args:
        data_set: that holds it.
        entry: the trajectory.
        vertex_count: of the data set's skin; None where it has none, so that clouds may differ.
        topics: where the channels lie.

    Raises:
        BadBagError: the bag, or its indenter, cannot be used.
    """
    try:
        check_bag(entry, vertex_count=vertex_count, topics=topics)
        trajectory = read_trajectory(entry.bag, topics=topics, channels=CHANNELS)
        press = press_of(trajectory, name=entry.name, indenter=entry.indenter)
        indenter = load_mesh(data_set.indenter_mesh(entry.indenter))
    except BadBagError:
        raise
    except FileNotFoundError as error:
        raise BadBagError(
            f"{entry.name}: {error}; add the file, or correct the name in dataset.yaml"
        ) from error
    except ValueError as error:
        raise BadBagError(f"{entry.name}: {error}") from error
    if press.skin_position_m is None and press.force_n is None:
        raise BadBagError(
            f"{entry.name}: neither {topics.skin} nor {topics.wrench} in the bag; record one of "
            "them, or name its topic"
        )
    return Observation(press, indenter)


def read_observations(
    data_set: DataSet,
    names: Sequence[str],
    *,
    vertex_count: int | None,
    topics: Topics = MEASURED_TOPICS,
) -> tuple[list[Observation], list[Omission]]:
    """Return what can be used of the named trajectories, and why the others cannot."""
    entries = {entry.name: entry for entry in data_set.entries}
    found, omitted = [], []
    for name in names:
        try:
            found.append(
                read_observation(data_set, entries[name], vertex_count=vertex_count, topics=topics)
            )
        except BadBagError as error:
            omitted.append(Omission(name, str(error)))
    return found, omitted


def check_bag(
    entry: DataSetEntry, *, vertex_count: int | None, topics: Topics = MEASURED_TOPICS
) -> None:
    """Look at each message of poses, wrenches and skins in the order of their recording.

    Raises:
        BadBagError: a topic of the wrong type, no poses, stamps out of order, a number that is not
            finite, lengths in millimetres, another number of skin points.
        FileNotFoundError, ValueError: as `BagReader`.
    """
    channel_of = {getattr(topics, channel): channel for channel in CHANNELS}
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
                _CHECKS[channel](content, vertex_count)
            except ValueError as error:
                raise BadBagError(f"{place}: {error}") from error
            if stamp <= last.get(channel, -1):
                raise BadBagError(
                    f"{place}: stamp {stamp} ns does not come after {last[channel]} ns of the "
                    "message before; record with one clock, and each message once"
                )
            last[channel] = stamp


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
