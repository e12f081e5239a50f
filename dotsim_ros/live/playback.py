# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A bag as the page scrubs through it: every moment ready to be sent."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import msg_adapters
from dotsim_ros.data.bag import BagReader, bag_name
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, IntArray
from dotsim_ros.live.moments import Picture, Scene, SkinMoment
from dotsim_ros.live.payloads import (
    IndentationScale,
    history_payload,
    picture_payload,
    scene_payload,
    skin_payload,
)
from dotsim_ros.live.recorder import NAME_TOPIC, NAME_TYPE
from dotsim_ros.view.skin_map import rest_position_m, skin_triangles
from dotsim_ros.view.timeline import BagMoment, Forces, Timeline, open_timeline

LARGEST_MOMENT_COUNT = 1500
"""A minute at 25 Hz, some 200 MB; of a longer bag as many are shown, evenly spread."""
POSE_ENDINGS = ("indenter/state", "indenter/pose")
"""The pose that a frame shows first: the commanded one may be ahead of it."""
POSE_TYPE = "geometry_msgs/msg/PoseStamped"


@dataclass(frozen=True)
class Playback:
    """What a page shows of a bag.

    Attributes:
        name: of the bag.
        scene: payload; None where the bag holds no skin.
        history: payload of all forces; None where it holds none.
        stamp_ns: (N,) of the moments.
        skins: N payloads, None where there is no skin yet.
        pictures: N payloads.
    """

    name: str
    scene: bytes | None
    history: bytes | None
    stamp_ns: IntArray
    skins: tuple[bytes | None, ...]
    pictures: tuple[bytes, ...]


def read_playback(path: Path) -> Playback:
    """Return a bag, whole or unfinished, with all that a page shows of it.

    Raises:
        FileNotFoundError: no bag at `path`.
        ValueError: it is no bag that can be read, a message is malformed, or it shows nothing.
    """
    with open_timeline(path) as timeline:
        return _playback(path, timeline)


def _playback(path: Path, timeline: Timeline) -> Playback:
    forces, poses = timeline.forces, _Poses(timeline.bag)
    chosen = _spread(timeline.stamp_ns)
    scene: Scene | None = None
    scale = IndentationScale()
    rest_depth_m: NDArray[np.floating] | None = None
    before: BagMoment | None = None
    skins: list[bytes | None] = []
    pictures: list[bytes] = []
    last_ns = -1
    for moment in timeline.moments():
        # Each stamp once, in order.
        if moment.stamp_ns not in chosen or moment.stamp_ns <= last_ns:
            continue
        last_ns = moment.stamp_ns
        if moment.cloud is not None and scene is None:
            rest_m = rest_position_m(moment.cloud)
            scene = Scene(rest_m, skin_triangles(rest_m), _indenter(timeline.bag))
        if not _have_one_size(moment.depth_m, rest_depth_m):
            rest_depth_m = None
        if rest_depth_m is None and _shows_rest(moment, before, scene):
            rest_depth_m = moment.depth_m
        before = moment
        skins.append(_skin(moment, forces, poses, path, scene))
        picture = Picture(moment.stamp_ns, moment.image, moment.depth_m, rest_depth_m)
        pictures.append(picture_payload(picture, scale))
    return Playback(
        bag_name(path),
        None if scene is None else scene_payload(scene),
        None if forces is None else history_payload(1e-9 * forces.stamp_ns, forces.force_n),
        np.array(sorted(chosen), dtype=np.int64),
        tuple(skins),
        tuple(pictures),
    )


class _Poses:
    """The poses of a bag by their stamps; none where it holds none."""

    def __init__(self, bag: BagReader) -> None:
        found = [
            topic
            for ending in POSE_ENDINGS
            for topic, kind in bag.topics().items()
            if kind == POSE_TYPE and f"/{topic}".endswith(f"/{ending}")
        ]
        self._stamp_ns: IntArray = np.zeros(0, dtype=np.int64)
        if not found:
            return
        posed: dict[int, Pose] = {}
        for message in bag.messages(found[0]):
            content = message.message()
            stamp_ns = msg_adapters.message_stamp_ns(content)
            posed[stamp_ns] = Pose(*msg_adapters.decode_pose_stamped(content))
        self._stamp_ns = np.array(sorted(posed), dtype=np.int64)
        self._poses = [posed[stamp_ns] for stamp_ns in sorted(posed)]

    def at(self, stamp_ns: int) -> Pose | None:
        """Return the newest pose at a time."""
        index = int(np.searchsorted(self._stamp_ns, stamp_ns, side="right")) - 1
        return self._poses[index] if index >= 0 else None


def _indenter(bag: BagReader) -> Indenter | None:
    """Return what pressed, where the bag names a shipped shape or defines one."""
    if bag.topics().get(NAME_TOPIC) != NAME_TYPE:
        return None
    name = next((str(each.message().data) for each in bag.messages(NAME_TOPIC)), "")
    # Never a path: a bag may come from anywhere.
    if not re.fullmatch(r"(?!mesh)\w{1,100}(\([\w=., \[\]+-]{1,200}\))?", name):
        return None
    try:
        return load_indenter(name)
    except (ValueError, OSError):
        return None


def _have_one_size(
    depth_m: NDArray[np.floating] | None, rest_depth_m: NDArray[np.floating] | None
) -> bool:
    return depth_m is None or rest_depth_m is None or depth_m.shape == rest_depth_m.shape


def _shows_rest(moment: BagMoment, before: BagMoment | None, scene: Scene | None) -> bool:
    """Return whether the depth of a moment is that of the skin at rest; a bag without skin begins
    at rest."""
    if moment.depth_m is None or scene is None or moment.cloud is None:
        return True
    is_of_one_time = before is None or (
        moment.depth_m is not before.depth_m and moment.cloud is not before.cloud
    )
    skin_m = np.asarray(moment.cloud.position, dtype=np.float64)
    return is_of_one_time and skin_m.shape == scene.rest_m.shape and scene.is_at_rest(skin_m)


def _spread(stamps_ns: IntArray) -> set[int]:
    if len(stamps_ns) <= LARGEST_MOMENT_COUNT:
        return set(stamps_ns.tolist())
    index = np.linspace(0, len(stamps_ns) - 1, LARGEST_MOMENT_COUNT).round().astype(int)
    return set(stamps_ns[index].tolist())


def _skin(
    moment: BagMoment, forces: Forces | None, poses: _Poses, path: Path, scene: Scene | None
) -> bytes | None:
    if moment.cloud is None or scene is None:
        return None
    skin_m: FloatArray = np.asarray(moment.cloud.position, dtype=np.float64)
    if skin_m.shape != scene.rest_m.shape:
        raise ValueError(
            f"{path}: the skin has {len(skin_m)} points after {len(scene.rest_m)}: it must keep "
            "its vertices"
        )
    force_n = None if forces is None else forces.at(moment.stamp_ns)
    return skin_payload(
        SkinMoment(moment.stamp_ns, skin_m, force_n, np.zeros(3), poses.at(moment.stamp_ns))
    )
