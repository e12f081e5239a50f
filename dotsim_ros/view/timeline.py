# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a bag shows at each moment, one moment in memory at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import msg_adapters
from dotsim_ros.data.bag import BagMessage, BagReader
from dotsim_ros.data.mcap.reader import Tolerance
from dotsim_ros.data.trajectory import Topics, decode_colour
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.printable import placed

LARGEST_FORCE_N = 1e6
"""What is larger is no force that was measured, and leaves no scale for the others."""

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


@dataclass(frozen=True)
class ViewTopics:
    """Topics of a bag to look at, depth as Image of encoding 32FC1; None where it has none."""

    image: str | None = None
    depth: str | None = None
    points: str | None = None
    wrench: str | None = None
    pose: str | None = None


SUFFIXES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "image": (("image_raw", "image_raw/compressed", "image_raw_1"), IMAGE_TYPES),
    "depth": (("depth/image",), ("sensor_msgs/msg/Image",)),
    "points": (("points", "skin"), ("sensor_msgs/msg/PointCloud2",)),
    "wrench": (("wrench", "force"), ("geometry_msgs/msg/WrenchStamped",)),
    "pose": (("indenter/state", "indenter/pose"), ("geometry_msgs/msg/PoseStamped",)),
}
"""How topics end that show each thing, the most wanted first, and the types they may have."""


def find_topics(there: dict[str, str], *, given: ViewTopics | None = None) -> ViewTopics:
    """Return which topics to look at, of those that a bag holds: those the user named, and the rest
    by how names end.

    Raises:
        ValueError: a given topic is not in the bag or has another type, or nothing is found.
    """
    found = given or ViewTopics()
    named = [topic for topic in vars(found).values() if topic is not None]
    if len(set(named)) < len(named):
        raise ValueError(f"one topic is named for two things: {', '.join(named)}")
    for name, (endings, types) in SUFFIXES.items():
        wanted = getattr(found, name)
        if wanted is not None:
            if there.get(wanted) not in types:
                raise ValueError(
                    f"the bag has no topic {wanted} of type {' or '.join(types)}; it holds "
                    + ", ".join(f"{topic} ({kind})" for topic, kind in there.items())
                )
            continue
        matches = [
            topic
            for ending in endings
            for topic, kind in there.items()
            if kind in types and f"/{topic}".endswith(f"/{ending}") and topic not in named
        ]
        if matches:
            found = replace(found, **{name: matches[0]})
    if found == ViewTopics():
        raise ValueError(f"the bag holds nothing to look at: {', '.join(there) or 'no message'}")
    return found


def bag_topics(path: Path, given: ViewTopics | None = None) -> Topics:
    """Return where a bag has the channels of a trajectory; as `find_topics`."""
    with BagReader(path) as bag, placed(path):
        found = find_topics(bag.topics(), given=given)
    return Topics(found.pose or "", found.wrench or "", found.points or "", found.image or "")


@dataclass(frozen=True)
class BagMoment:
    """The newest of everything at one time; None before the first. Depth is NaN where not valid."""

    stamp_ns: int
    image: NDArray[np.uint8] | None = None
    depth_m: NDArray[np.float32] | None = None
    cloud: msg_adapters.Cloud | None = None


@dataclass(frozen=True)
class Forces:
    """Forces (N, 3) over time (N,)."""

    stamp_ns: NDArray[np.int64]
    force_n: FloatArray

    def at(self, stamp_ns: int) -> FloatArray:
        """Return the (3,) force measured nearest to a time."""
        return np.asarray(self.force_n[int(np.argmin(np.abs(self.stamp_ns - stamp_ns)))])


@dataclass(frozen=True)
class Timeline:
    """What a bag shows over time; by `open_timeline`.

    Attributes:
        bag: open.
        topics: those looked at.
        stamp_ns: (N,) increasing, those at which `moments` yields.
        forces: None where it has none.
        refused_count: messages whose stamp is no time; they are not shown.
    """

    bag: BagReader
    topics: ViewTopics
    stamp_ns: NDArray[np.int64]
    forces: Forces | None
    refused_count: int

    def moments(self) -> Iterator[BagMoment]:
        """Yield what the bag shows, once for each stamp, when all of that stamp has been read.

        Raises:
            ValueError: the bag breaks off, or a message is malformed.
        """
        moment: BagMoment | None = None
        for message in self.bag.messages(*_visible(self.topics)):
            stamp_ns = _stamp_ns(message)
            if stamp_ns is None:
                continue
            if moment is None:
                moment = BagMoment(stamp_ns)
            elif stamp_ns != moment.stamp_ns:
                yield moment
                moment = replace(moment, stamp_ns=stamp_ns)
            moment = _changed(moment, message, self.topics)
        if moment is not None:
            yield moment

    def shortcomings(self) -> list[str]:
        """Return what of the bag is not shown and why, a sentence each."""
        said = []
        if self.bag.damage:
            said.append(
                f"{'; '.join(self.bag.damage)}; what comes before is shown (`dotsim_ros record "
                f"--repair {self.bag.path}` makes a whole bag of it)"
            )
        if self.refused_count:
            said.append(f"{self.refused_count} messages are not shown: their stamp is no time")
        return said

    def messages(self) -> Iterator[tuple[str, msg_adapters.Message]]:
        """Yield each message that has a stamp, poses and wrenches too, with its name in
        `ViewTopics`.

        Raises:
            ValueError: as `moments`.
        """
        names = {topic: name for name, topic in vars(self.topics).items() if topic is not None}
        for message in self.bag.messages(*names):
            if _stamp_ns(message) is not None:
                yield names[message.topic], message.message()


@contextmanager
def open_timeline(path: str | Path, given: ViewTopics | None = None) -> Iterator[Timeline]:
    """Open a bag, whole or not finished, and read the times and the forces that it shows.

    Args:
        path: of the bag; one that was not finished is read up to its end.
        given: topics that the user named; the rest is found by how names end.

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag that can be read, a force is malformed, or it shows nothing.
    """
    with BagReader(path, Tolerance.UNFINISHED) as bag:
        there = bag.topics()
        if not there:
            reason = "; ".join(bag.damage)
            raise ValueError(
                f"{path} holds no message that can be read{f': {reason}' if reason else ''}; "
                "record the bag again"
            )
        with placed(path):
            topics = find_topics(there, given=given)
        visible, stamps, refused_count = _visible(topics), set(), 0
        forces: list[tuple[int, FloatArray]] = []
        for message in bag.messages(*visible, *([topics.wrench] if topics.wrench else [])):
            stamp_ns = _stamp_ns(message)
            if stamp_ns is None:
                refused_count += 1
            elif message.topic in visible:
                stamps.add(stamp_ns)
            else:
                forces.append((stamp_ns, _force_n(message, stamp_ns)))
        if not stamps:
            raise ValueError(f"{path} shows nothing: no image, no depth and no skin")
        forces.sort(key=itemgetter(0))
        times, forces_n = zip(*forces, strict=True) if forces else ((), ())
        yield Timeline(
            bag,
            topics,
            np.array(sorted(stamps), dtype=np.int64),
            Forces(np.array(times, dtype=np.int64), np.array(forces_n)) if forces else None,
            refused_count,
        )


def _visible(topics: ViewTopics) -> list[str]:
    return [topic for topic in (topics.image, topics.depth, topics.points) if topic is not None]


def _stamp_ns(message: BagMessage) -> int | None:
    try:
        return msg_adapters.serialized_stamp_ns(message.serialized)
    except ValueError:
        return None


def _named(message: BagMessage, stamp_ns: int) -> AbstractContextManager[None]:
    """Put bag, topic and time before what is wrong with a message."""
    return placed(f"{message.bag}, {message.topic}, message of {1e-9 * stamp_ns:.3f} s")


def _force_n(message: BagMessage, stamp_ns: int) -> FloatArray:
    content = message.message()
    with _named(message, stamp_ns):
        force_n = msg_adapters.decode_wrench_stamped(content)[0]
        largest = np.abs(force_n).max()
        if largest > LARGEST_FORCE_N:
            raise ValueError(f"a force of {largest:.3g} N, expected at most {LARGEST_FORCE_N:g} N")
    return force_n


def _changed(moment: BagMoment, message: BagMessage, topics: ViewTopics) -> BagMoment:
    """Return the moment with what a message shows."""
    content = message.message()
    with _named(message, moment.stamp_ns):
        if message.topic == topics.image:
            return replace(moment, image=decode_colour(content))
        if message.topic == topics.depth:
            if content.encoding != "32FC1":
                raise ValueError(f"holds a {content.encoding} image, expected 32FC1")
            return replace(moment, depth_m=msg_adapters.decode_image(content))
        return replace(moment, cloud=msg_adapters.decode_cloud(content))
