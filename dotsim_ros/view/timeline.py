# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a bag shows at each moment, one moment in memory at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import msg_adapters
from dotsim_ros.data.bag import BagMessage, BagReader
from dotsim_ros.data.mcap.reader import Tolerance
from dotsim_ros.data.trajectory import decode_colour
from dotsim_ros.io.arrays import FloatArray

LARGEST_FORCE_N = 1e6
"""What is larger is no force that was measured, and leaves no scale for the others."""

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


@dataclass(frozen=True)
class ViewTopics:
    """Topics of a bag to look at; None where it has none such.

    Attributes:
        image: Image or CompressedImage.
        depth: Image of encoding 32FC1.
        points: PointCloud2 of the skin.
        wrench: WrenchStamped.
    """

    image: str | None = None
    depth: str | None = None
    points: str | None = None
    wrench: str | None = None


SUFFIXES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "image": (("image_raw", "image_raw/compressed", "image_raw_1"), IMAGE_TYPES),
    "depth": (("depth/image",), ("sensor_msgs/msg/Image",)),
    "points": (("points", "skin"), ("sensor_msgs/msg/PointCloud2",)),
    "wrench": (("wrench", "force"), ("geometry_msgs/msg/WrenchStamped",)),
}
"""How topics end that show each thing, the most wanted first, and the types they may have."""


def find_topics(there: dict[str, str], *, given: ViewTopics | None = None) -> ViewTopics:
    """Return which topics to look at, of those that a bag holds.

    Args:
        there: message type of each topic of the bag.
        given: what the user named; the rest is found by how names end.

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


@dataclass(frozen=True)
class BagMoment:
    """The newest of everything at one time.

    Attributes:
        stamp_ns: the time.
        image: (H, W, 3) uint8 RGB, or None before the first.
        depth_m: (H, W) float32, NaN where invalid, or None.
        cloud: the skin, or None.
    """

    stamp_ns: int
    image: NDArray[np.uint8] | None = None
    depth_m: NDArray[np.float32] | None = None
    cloud: msg_adapters.Cloud | None = None


@dataclass(frozen=True)
class Forces:
    """Force over time.

    Attributes:
        stamp_ns: (N,).
        force_n: (N, 3).
    """

    stamp_ns: NDArray[np.int64]
    force_n: FloatArray

    def at(self, stamp_ns: int) -> FloatArray:
        """Return the (3,) force measured nearest to a time."""
        return np.asarray(self.force_n[int(np.argmin(np.abs(self.stamp_ns - stamp_ns)))])


def _changed(moment: BagMoment, message: BagMessage, topics: ViewTopics) -> BagMoment:
    """Return the moment with what a message shows.

    Raises:
        ValueError: the message is malformed.
    """
    content = message.message()
    with _named(message, moment.stamp_ns):
        if message.topic == topics.image:
            return replace(moment, image=decode_colour(content))
        if message.topic == topics.depth:
            if content.encoding != "32FC1":
                raise ValueError(f"holds a {content.encoding} image, expected 32FC1")
            return replace(moment, depth_m=msg_adapters.decode_image(content))
        return replace(moment, cloud=msg_adapters.decode_cloud(content))


@contextmanager
def _named(message: BagMessage, stamp_ns: int) -> Iterator[None]:
    """Put bag, topic and time before what is wrong with a message."""
    try:
        yield
    except ValueError as error:
        place = f"{message.bag}, {message.topic}, message of {1e-9 * stamp_ns:.3f} s"
        raise ValueError(f"{place}: {error}") from error


@dataclass(frozen=True)
class Stamps:
    """Times of what a bag shows.

    Attributes:
        stamp_ns: (N,) increasing, those at which `iterate_moments` yields.
        refused_count: messages whose stamp is no time; they are not shown.
        damage: what is wrong with the bag, in words.
    """

    stamp_ns: NDArray[np.int64]
    refused_count: int
    damage: tuple[str, ...]


def read_stamps(path: str | Path, topics: ViewTopics) -> Stamps:
    """Return the times of what a bag shows.

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag that can be read.
    """
    stamps: set[int] = set()
    refused_count = 0
    with BagReader(path, Tolerance.UNFINISHED) as bag:
        visible = _visible(topics)
        for message in bag.messages(*visible, *([topics.wrench] if topics.wrench else [])):
            stamp_ns = _stamp_ns(message)
            if stamp_ns is None:
                refused_count += 1
            elif message.topic in visible:
                stamps.add(stamp_ns)
        return Stamps(np.array(sorted(stamps), dtype=np.int64), refused_count, bag.damage)


def _stamp_ns(message: BagMessage) -> int | None:
    try:
        return msg_adapters.serialized_stamp_ns(message.serialized)
    except ValueError:
        return None


def _visible(topics: ViewTopics) -> list[str]:
    return [topic for topic in (topics.image, topics.depth, topics.points) if topic is not None]


def iterate_moments(path: str | Path, topics: ViewTopics) -> Iterator[BagMoment]:
    """Yield what the bag shows, once for each stamp, when all of that stamp has been read.

    A bag that was not finished is read up to its end; messages whose stamp is no time are left out.

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag that can be read, or a message is malformed.
    """
    moment: BagMoment | None = None
    with BagReader(path, Tolerance.UNFINISHED) as bag:
        for message in bag.messages(*_visible(topics)):
            stamp_ns = _stamp_ns(message)
            if stamp_ns is None:
                continue
            if moment is None:
                moment = BagMoment(stamp_ns)
            elif stamp_ns != moment.stamp_ns:
                yield moment
                moment = replace(moment, stamp_ns=stamp_ns)
            moment = _changed(moment, message, topics)
    if moment is not None:
        yield moment


def read_forces(path: str | Path, topic: str | None) -> Forces | None:
    """Return the forces of a bag, or None where it has no such topic.

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag that can be read, or a message is malformed.
    """
    if topic is None:
        return None
    stamps, forces = [], []
    with BagReader(path, Tolerance.UNFINISHED) as bag:
        for bag_message in bag.messages(topic):
            stamp_ns = _stamp_ns(bag_message)
            if stamp_ns is None:
                continue
            message = bag_message.message()
            with _named(bag_message, stamp_ns):
                force_n = msg_adapters.decode_wrench_stamped(message)[0]
                if np.abs(force_n).max() > LARGEST_FORCE_N:
                    raise ValueError(
                        f"a force of {np.abs(force_n).max():.3g} N, expected at most "
                        f"{LARGEST_FORCE_N:g} N"
                    )
            stamps.append(stamp_ns)
            forces.append(force_n)
    if not stamps:
        return None
    order = np.argsort(stamps, kind="stable")
    return Forces(np.array(stamps, dtype=np.int64)[order], np.array(forces)[order])
