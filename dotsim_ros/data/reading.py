# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads measured presses: the one way from a data set's bags to arrays.

`read_bag` opens a bag once, and decodes and checks each of its messages once, in the order of their
recording; presses and footage are views of what it returns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import msg_adapters
from dotsim_ros.data.bag import BagMessage, BagReader
from dotsim_ros.data.data_set import DataSet, DataSetEntry, find_indenter
from dotsim_ros.data.plausibility import check_press, check_same_shape
from dotsim_ros.data.presses import Press
from dotsim_ros.data.recording import Span, session_starts
from dotsim_ros.data.trajectory import (
    MEASURED_TOPICS,
    Row,
    Topics,
    Trajectory,
    channel_of,
    check_types,
    decode_colour,
    decoded,
    read_trajectory,
)
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, ImageArray, IntArray

LARGEST_LENGTH_M = 0.5
"""Nothing on a fingertip sensor is farther from its base."""
LARGEST_FORCE_N = 500.0
PRESS_CHANNELS = ("pose", "wrench", "skin")
FILM_CHANNELS = ("pose", "wrench", "image")
SAME_DELAY_S = 1e-3
"""Delays that differ by less are one delay of a whole channel."""
LARGEST_DELAY_S = 0.5
"""Of one channel after another by the same clock; cameras and arms are late by tenths at most."""
MOVED_M = 1.0e-3
MOST_REASONS = 3


class BadBagError(ValueError):
    """A bag that cannot be used; the text names bag, message and likely mend."""


@dataclass(frozen=True)
class Observation:
    """A press to fit to, as measured, and what pressed."""

    press: Press
    indenter: Indenter


@dataclass(frozen=True)
class Omission:
    """The name of a trajectory that was left out, and why, with the likely mend."""

    name: str
    reason: str


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

    def check_size(self, idle: ImageArray) -> None:
        """Refuse images of another size than an idle one (H, W, 3).

        Raises:
            BadBagError: they are.
        """
        if self.pixels.shape[1:] != idle.shape:
            (height, width), expected = self.pixels.shape[1:3], idle.shape
            raise BadBagError(
                f"{self.press.name}: its images are {width}x{height}, but the idle images "
                f"{expected[1]}x{expected[0]}; take all with one camera and setting"
            )


@dataclass(frozen=True)
class MeasuredBag:
    """What a bag of a data set holds, each message decoded and checked; by `read_bag`.

    What is wrong with a channel is raised when the channel is used.

    Attributes:
        entry: of the data set.
        topics: where the channels lie.
        trajectory: its poses, and forces and skin where they were asked for and measured.
        images: messages, decoded when they are used, by their stamps; none where not asked for.
        faults: of the channels that cannot be used.
    """

    entry: DataSetEntry
    topics: Topics
    trajectory: Trajectory
    images: dict[int, BagMessage]
    faults: dict[str, BadBagError]

    @property
    def span_s(self) -> Span | None:
        """First and last pose; None where poses cannot be used."""
        pose = self.trajectory.pose
        return None if pose is None else _span(pose.stamp_ns)

    def _check(self, *channels: str) -> None:
        for channel in channels:
            if channel in self.faults:
                raise self.faults[channel]

    def press(self) -> Press:
        """Return poses, forces and skin.

        Raises:
            BadBagError: one of them cannot be used, or their stamps differ.
        """
        self._check("pose", "wrench", "skin")
        pose, skin, wrench = self.trajectory.pose, self.trajectory.skin, self.trajectory.wrench
        assert pose is not None
        for what, channel in (("skin", skin), ("wrench", wrench)):
            if channel is not None and not np.array_equal(channel.stamp_ns, pose.stamp_ns):
                differ = _stamps_differ(what, channel.stamp_ns, pose.stamp_ns)
                raise BadBagError(f"{self.entry.name}: {differ}")
        return Press(
            name=self.entry.name,
            indenter=self.entry.indenter,
            poses=pose.poses(),
            stamp_s=_seconds(pose.stamp_ns),
            skin_position_m=None if skin is None else skin.position_m.astype(np.float64),
            force_n=None if wrench is None else wrench.force_n,
        )

    def footage(self, *, most: int | None = None) -> PressImages:
        """Return the images, with poses and forces interpolated to their times.

        Args:
            most: frames to keep at most, evenly spread; None for all.

        Raises:
            BadBagError: no image, one that is malformed or of another size, none within the poses'
                time, channels by different clocks, or poses or forces that cannot be used.
        """
        self._check("pose", "wrench", "image")
        entry, topics = self.entry, self.topics
        pose, wrench = self.trajectory.pose, self.trajectory.wrench
        assert pose is not None
        if not self.images:
            raise BadBagError(
                f"{entry.name} holds no image on {topics.image}; record the camera's images, or "
                "name their topic"
            )
        image_ns = np.array(sorted(self.images), dtype=np.int64)
        within = (image_ns >= pose.stamp_ns[0]) & (image_ns <= pose.stamp_ns[-1])
        if not within.any():
            raise BadBagError(
                f"{entry.name}: no image was taken while poses were recorded; record both at once, "
                "stamped by one clock"
            )
        _check_clocks(entry, image_ns, pose.stamp_ns, topics.image, topics.pose)
        if wrench is not None:
            _check_clocks(entry, wrench.stamp_ns, pose.stamp_ns, topics.wrench, topics.pose)
        stamp_ns = image_ns[within]
        if most is not None and len(stamp_ns) > most:
            places = np.linspace(0, len(stamp_ns) - 1, most).round().astype(int)
            stamp_ns = stamp_ns[np.unique(places)]
        pixels = self._pixels(stamp_ns.tolist())
        way_m = float(np.ptp(pose.position_m, axis=0).max())
        # Noise alone makes any two images of a live camera differ.
        if len(pixels) > 1 and way_m >= MOVED_M and bool((pixels == pixels[0]).all()):
            raise BadBagError(
                f"{entry.name}, {topics.image}: all {len(pixels)} images are the same to the bit "
                f"while the indenter moves {1e3 * way_m:.1f} mm, expected a live camera; record "
                "its images again or leave the trajectory out"
            )
        stamp_s = _seconds(stamp_ns)
        force_n = None
        if wrench is not None:
            axes = wrench.force_n.T
            times_s = _seconds(wrench.stamp_ns)
            force_n = np.stack([np.interp(stamp_s, times_s, axis) for axis in axes], axis=1)
        poses = _poses_at(stamp_ns, pose.stamp_ns, pose.poses())
        press = Press(entry.name, entry.indenter, poses, stamp_s, force_n=force_n)
        delay_s = 1e-9 * float(stamp_ns[0] - pose.stamp_ns[0])
        return PressImages(press, pixels, delay_s)

    def _pixels(self, stamps_ns: Sequence[int]) -> ImageArray:
        """Return the images (F, H, W, 3) of some stamps, all of one size."""
        found = []
        for stamp_ns in stamps_ns:
            place = f"{self.entry.name}, {self.topics.image}, image of {1e-9 * stamp_ns:.3f} s"
            try:
                found.append(decode_colour(self.images[stamp_ns].message()))
            except ValueError as error:
                raise BadBagError(f"{place}: {error}") from error
            if found[-1].shape != found[0].shape:
                (height, width), expected = found[-1].shape[:2], found[0].shape
                raise BadBagError(
                    f"{place}: it is {width}x{height}, but the first {expected[1]}x{expected[0]}; "
                    "take all with one camera and setting"
                )
        return np.stack(found)


def read_bag(
    entry: DataSetEntry,
    *,
    topics: Topics = MEASURED_TOPICS,
    channels: Sequence[str] = PRESS_CHANNELS,
    vertex_count: int | None = None,
) -> MeasuredBag:
    """Read a bag of a data set: open it, and decode and check each message, once.

    Args:
        entry: the trajectory.
        topics: where the channels lie.
        channels: which to read, "pose" among them, and of "wrench", "skin" and "image".
        vertex_count: of the data set's skin; None where clouds may differ.

    Returns:
        What can be read. In its `faults`, of all channels: no bag that can be read, or no poses; of
        one channel: a topic of the wrong type, another frame than the sensor's base, stamps out of
        order, a number that is not finite, lengths in millimetres, another number of skin points.
    """
    topic_of = {name: str(getattr(topics, name)) for name in channels}
    name_of = {topic: name for name, topic in topic_of.items()}
    rows: dict[str, list[Row]] = {name: [] for name in channels}
    images: dict[int, BagMessage] = {}
    made: dict[str, Any] = {}
    faults: dict[str, BadBagError] = {}

    @contextmanager
    def noted(name: str) -> Iterator[None]:
        """Keep why a channel cannot be used."""
        try:
            yield
        except ValueError as error:
            faults[name] = _bad(entry, error)

    try:
        with BagReader(entry.bag) as bag:
            there = bag.topics()
            for name, topic in topic_of.items():
                with noted(name):
                    check_types(there, {name: topic}, entry.name)
            if topics.pose not in there:
                raise BadBagError(
                    f"{entry.name}: no message on {topics.pose}; the bag holds "
                    f"{', '.join(there) or 'nothing'}; record the indenter's poses "
                    "(geometry_msgs/PoseStamped), or name their topic"
                )
            for message in bag.messages(*name_of):
                name = name_of[message.topic]
                if name in faults:
                    continue
                with noted(name):
                    if name == "image":
                        _add_image(images, message, entry.name)
                        continue
                    found = rows[name]
                    place = f"{entry.name}, {message.topic}, message {len(found)}"
                    found.append(decoded(message, name, place))
                    _check_row(name, found, place, entry.base_frame, vertex_count)
    except (FileNotFoundError, ValueError) as error:
        faults = dict.fromkeys(channels, _bad(entry, error))
    for name, each in rows.items():
        if each and name not in faults:
            with noted(name):
                made[name] = channel_of(name, each)
    return MeasuredBag(entry, topics, Trajectory(**made, name=entry.name), images, faults)


def _bad(entry: DataSetEntry, error: Exception) -> BadBagError:
    named = "" if str(error).startswith(entry.name) else f"{entry.name}: "
    return error if isinstance(error, BadBagError) else BadBagError(f"{named}{error}")


def _add_image(images: dict[int, BagMessage], message: BagMessage, name: str) -> None:
    place = f"{name}, {message.topic}, message {len(images)}"
    try:
        stamp_ns = msg_adapters.serialized_stamp_ns(message.serialized)
    except ValueError as error:
        raise BadBagError(f"{place}: {error}") from error
    if stamp_ns in images:
        raise BadBagError(
            f"{place}: a second image of the stamp {stamp_ns} ns; record each message once"
        )
    images[stamp_ns] = message


def _check_row(
    name: str, rows: Sequence[Row], place: str, base_frame: str, vertex_count: int | None
) -> None:
    """Check the last of the messages of a channel.

    Raises:
        BadBagError: another frame than the base, a stamp out of order, or a number out of range.
    """
    row, value = rows[-1], rows[-1].values[0]
    if row.frame_id.removeprefix("/") != base_frame.removeprefix("/"):
        raise BadBagError(
            f"{place}: frame_id is {row.frame_id!r}, expected {base_frame!r}, the sensor's base "
            "frame; transform poses, forces and skin into it, or where it only has another name, "
            f"add the line 'base_frame: {row.frame_id or repr('')}' to dataset.yaml"
        )
    if not np.isfinite(value).all():
        raise BadBagError(
            f"{place}: the {name} holds a number that is not finite; drop such frames while "
            "recording"
        )
    largest = float(np.abs(value).max(initial=0.0))
    if name == "wrench" and largest > LARGEST_FORCE_N:
        raise BadBagError(
            f"{place}: the force is {largest:.4g} N, expected newtons and at most "
            f"{LARGEST_FORCE_N} N; if these are millinewtons or raw counts, convert them"
        )
    if name != "wrench" and largest > LARGEST_LENGTH_M:
        raise BadBagError(
            f"{place}: the {name} reaches {largest:.4g} m from the base, expected metres and at "
            f"most {LARGEST_LENGTH_M} m; if these are millimetres, multiply by 0.001"
        )
    if name == "skin" and vertex_count is not None and len(value) != vertex_count:
        raise BadBagError(
            f"{place}: the skin has {len(value)} points, the data set's mesh {vertex_count}; "
            "record the vertices of skin_mesh.npz, or remove that file so that points need not "
            "correspond"
        )
    if len(rows) > 1 and row.stamp_ns <= rows[-2].stamp_ns:
        raise BadBagError(
            f"{place}: stamp {row.stamp_ns} ns does not come after {rows[-2].stamp_ns} ns of the "
            "message before; record with one clock, and each message once"
        )


@dataclass(frozen=True)
class PressReader:
    """Reads the presses of a data set, each checked against its indenter and the skin.

    Attributes:
        data_set: where bags and indenters are looked for.
        skin: at rest; the data set's, or the sensor's own where it has none.
        has_vertices: whether the clouds list the skin's vertices; where not, they may differ.
        topics: where the channels lie.
        indenters: folder of the indenters' meshes; None as `DataSet.indenter_file`.
    """

    data_set: DataSet
    skin: SkinMesh
    has_vertices: bool
    topics: Topics = MEASURED_TOPICS
    indenters: str | Path | None = None
    _indenters: dict[str, Indenter] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        data_set: DataSet,
        own_skin: SkinMesh,
        *,
        sensor: str | None = None,
        topics: Topics = MEASURED_TOPICS,
        indenters: str | Path | None = None,
    ) -> PressReader:
        """Return the reader of a data set.

        Args:
            data_set: with a skin, or without.
            own_skin: of the sensor's file, used where the data set has none.
            sensor: the sensor's name, to refuse the skin of another one; None takes any.
            topics, indenters: as above.

        Raises:
            ValueError: the data set's skin is no mesh, or not that of the sensor.
        """
        if not data_set.has_skin_mesh:
            return cls(data_set, own_skin, False, topics, indenters)
        skin = data_set.skin_mesh()
        if sensor is not None:
            check_same_shape(skin, own_skin, data=str(data_set.directory), sensor=sensor)
        return cls(data_set, skin, True, topics, indenters)

    def read(self, entry: DataSetEntry) -> Observation:
        """Read a press and its indenter.

        Raises:
            BadBagError: the bag, or its indenter, cannot be used.
        """
        return self.observation(self.open(entry, PRESS_CHANNELS))

    def open(self, entry: DataSetEntry, channels: Sequence[str]) -> MeasuredBag:
        """Read channels of a bag; see `read_bag`."""
        vertex_count = self.skin.vertex_count if self.has_vertices else None
        return read_bag(entry, topics=self.topics, channels=channels, vertex_count=vertex_count)

    def indenter(self, entry: DataSetEntry) -> Indenter:
        """Return what pressed; its mesh is read, and found to be closed, once.

        Raises:
            BadBagError: it cannot be used.
        """
        name = entry.indenter
        if name not in self._indenters:
            try:
                self._indenters[name] = find_indenter(self.data_set, name, self.indenters)
            except FileNotFoundError as error:
                raise BadBagError(
                    f"{entry.name}: {error}; add the file, or correct the name in dataset.yaml"
                ) from error
            except ValueError as error:
                raise BadBagError(f"{entry.name}: {error}") from error
        return self._indenters[name]

    def observation(self, bag: MeasuredBag) -> Observation:
        """Return the press of a bag, checked, and its indenter.

        Raises:
            BadBagError: the press, or its indenter, cannot be used.
        """
        entry, topics, press = bag.entry, self.topics, bag.press()
        indenter = self.indenter(entry)
        if press.skin_position_m is None and press.force_n is None:
            raise BadBagError(
                f"{entry.name}: neither {topics.skin} nor {topics.wrench} in the bag; record one "
                "of them, or name its topic"
            )
        try:
            check_press(press, indenter, self.skin, has_vertices=self.has_vertices, topics=topics)
        except ValueError as error:
            raise BadBagError(f"{entry.name}, {error}") from error
        return Observation(press, indenter)

    def read_all(self, names: Sequence[str]) -> tuple[list[Observation], list[Omission]]:
        """Return what can be used of the named trajectories, and why the others cannot."""
        found, omitted = [], []
        for entry in self.data_set.named(names) if names else ():
            try:
                found.append(self.read(entry))
            except BadBagError as error:
                omitted.append(Omission(entry.name, str(error)))
        return found, omitted


def read_press_images(
    entry: DataSetEntry, *, idle: ImageArray, topics: Topics = MEASURED_TOPICS
) -> PressImages:
    """Read the images of a press, with poses and forces at their times; see `MeasuredBag.footage`.

    Args:
        entry: the trajectory.
        idle: (H, W, 3) without contact, by the same camera.
        topics: where the channels lie.

    Raises:
        BadBagError: as `MeasuredBag.footage`; or images of another size.
    """
    footage = read_bag(entry, topics=topics, channels=FILM_CHANNELS).footage()
    footage.check_size(idle)
    return footage


def starts_in_session(data_set: DataSet, spans_s: Sequence[Span | None]) -> list[float]:
    """Return when each trajectory of a data set began, s after the first.

    The poses of one whose span is None, which was not read, are read alone.
    """
    known: list[Span | None] = []
    for entry, span_s in zip(data_set.entries, spans_s, strict=True):
        if span_s is None:
            try:
                pose = read_trajectory(entry.bag, channels=("pose",)).pose
                span_s = None if pose is None else _span(pose.stamp_ns)
            except (FileNotFoundError, ValueError):
                pass
        known.append(span_s)
    return session_starts(known)


def summarize_reasons(reasons: Sequence[str]) -> str:
    """Return the first reasons on one line, and how many more there are."""
    more = len(reasons) - MOST_REASONS
    return "; ".join(reasons[:MOST_REASONS]) + (f"; and {more} more" if more > 0 else "")


def _seconds(stamp_ns: IntArray) -> FloatArray:
    return 1e-9 * stamp_ns.astype(np.float64)


def _span(stamp_ns: IntArray) -> Span:
    return 1e-9 * float(stamp_ns[0]), 1e-9 * float(stamp_ns[-1])


def _stamps_differ(channel: str, stamp_ns: IntArray, pose_ns: IntArray) -> str:
    if len(stamp_ns) == len(pose_ns):
        later_s = _seconds(stamp_ns - pose_ns)
        if float(np.ptp(later_s)) < SAME_DELAY_S:
            return (
                f"every stamp of the {channel} is {abs(later_s[0]):.3g} s "
                f"{'after' if later_s[0] > 0.0 else 'before'} that of its pose, expected equal "
                "stamps: two clocks, or one channel stamped when it was received; stamp all by one "
                "clock, when they are measured"
            )
    return (
        f"{len(stamp_ns)} stamps of the {channel} differ from the {len(pose_ns)} of the pose, "
        "expected equal stamps; record one pose with each, interpolated to its time if need be"
    )


def _check_clocks(
    entry: DataSetEntry, stamp_ns: IntArray, pose_ns: IntArray, topic: str, pose_topic: str
) -> None:
    """Refuse a channel that begins and ends as much later, or earlier, than the poses.

    A channel that is recorded longer than the poses, at one end or both, passes.
    """
    begins_s = 1e-9 * float(stamp_ns[0] - pose_ns[0])
    ends_s = 1e-9 * float(stamp_ns[-1] - pose_ns[-1])
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
