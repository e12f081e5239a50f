"""What a bag shows at each moment, one moment in memory at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import msg_adapters
from dotsim_ros.arrays import FloatArray
from dotsim_ros.measured.bag import BagMessage, BagReader, serialized_stamp_ns
from dotsim_ros.measured.trajectory import decode_colour

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
    content = message.message()
    if message.topic == topics.image:
        return replace(moment, image=decode_colour(content))
    if message.topic == topics.depth:
        if content.encoding != "32FC1":
            raise ValueError(f"{message.topic} holds {content.encoding} images, expected 32FC1")
        return replace(moment, depth_m=msg_adapters.decode_image(content))
    return replace(moment, cloud=msg_adapters.decode_cloud(content))


def read_stamps(path: str | Path, topics: ViewTopics) -> NDArray[np.int64]:
    """Return the increasing times (ns) at which `iterate_moments` yields.

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag that can be read.
    """
    with BagReader(path) as bag:
        stamps = {serialized_stamp_ns(m.serialized) for m in bag.messages(*_visible(topics))}
    return np.array(sorted(stamps), dtype=np.int64)


def _visible(topics: ViewTopics) -> list[str]:
    return [topic for topic in (topics.image, topics.depth, topics.points) if topic is not None]


def iterate_moments(path: str | Path, topics: ViewTopics) -> Iterator[BagMoment]:
    """Yield what the bag shows, once for each stamp, when all of that stamp has been read.

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag that can be read, or a message is malformed.
    """
    moment: BagMoment | None = None
    with BagReader(path) as bag:
        for message in bag.messages(*_visible(topics)):
            stamp_ns = serialized_stamp_ns(message.serialized)
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
    with BagReader(path) as bag:
        for bag_message in bag.messages(topic):
            message = bag_message.message()
            stamps.append(msg_adapters.message_stamp_ns(message))
            forces.append(msg_adapters.decode_wrench_stamped(message)[0])
    if not stamps:
        return None
    order = np.argsort(stamps, kind="stable")
    return Forces(np.array(stamps, dtype=np.int64)[order], np.array(forces)[order])
