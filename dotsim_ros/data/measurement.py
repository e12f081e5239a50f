# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a measured data set for the gap finder, and reports what of it cannot be used."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dotsim_ros.data.bag import BagReader
from dotsim_ros.data.data_set import INDEX, DataSet, DataSetEntry, find_indenter, read_data_set
from dotsim_ros.data.reading import BadBagError, read_motion, read_observation, summarize_reasons
from dotsim_ros.data.recording import Recording, phases_of
from dotsim_ros.data.session import Span, session_starts, span_of
from dotsim_ros.data.trajectory import MEASURED_TOPICS, Topics
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m

CHANNELS = ("pose", "wrench", "skin")
HELD_OUT_SHARE = 0.4
"""At most this share of the trajectories is kept for the figures after the search."""
IGNORED = ("truth.json", "truth.yaml")
"""Files that say what was done to a data set: never read; that they are there is reported."""


@dataclass(frozen=True)
class Measurement:
    """A data set, as far as it can be used.

    Attributes:
        directory: its folder.
        skin: the skin that its clouds list, or the sensor's own where no clouds are.
        recordings: those that can be used, in the order of the index.
        warnings: what was left out, and why.
        digest: of all that was read.
    """

    directory: Path
    skin: SkinMesh
    recordings: tuple[Recording, ...]
    warnings: tuple[str, ...]
    digest: str


def holds_skin_or_force(
    directory: str | Path | DataSet, *, topics: Topics = MEASURED_TOPICS
) -> bool:
    """Return whether a bag of a data set holds the skin or the force; a bag that cannot be read
    counts as one that does, so that reading it tells what is wrong.

    Raises:
        FileNotFoundError, ValueError: as `read_data_set`.
    """
    for entry in read_data_set(directory).entries:
        try:
            with BagReader(entry.bag) as bag:
                there = bag.topics()
        except (OSError, ValueError):
            return True
        if topics.skin in there or topics.wrench in there:
            return True
    return False


def read_measurement(
    data: str | Path | DataSet,
    *,
    own_skin: SkinMesh,
    indenters: str | Path | None = None,
    topics: Topics = MEASURED_TOPICS,
) -> Measurement:
    """Read a data set.

    Args:
        data: its folder, or what its index says.
        own_skin: of the sensor's file, used where the data set has no mesh of its own.
        indenters: folder of the indenters' meshes; None as `DataSet.indenter_file`.
        topics: where the channels lie.

    Raises:
        FileNotFoundError: no data set there.
        ValueError: no trajectory of it can be used; the text lists why.
    """
    data_set = read_data_set(data)
    folder = data_set.directory
    warnings = [
        f"{name} lies in the data set: it was not read"
        for name in IGNORED
        if _lies_in(folder, name)
    ]
    skin = data_set.skin_mesh() if data_set.has_skin_mesh else own_skin
    digest = hashlib.sha256((folder / INDEX).read_bytes())
    found: list[Recording | None] = []
    for entry in data_set.entries:
        try:
            recording = _read(data_set, entry, skin, indenters, topics)
        except (BadBagError, FileNotFoundError, ValueError) as error:
            warnings.append(f"{entry.name} was left out: {error}")
            found.append(None)
            continue
        found.append(recording)
        _add(digest, recording)
    recordings = _in_session(found, data_set, topics)
    if not recordings:
        raise ValueError(f"{folder}: no trajectory can be used: {summarize_reasons(warnings)}")
    return Measurement(folder, skin, tuple(recordings), tuple(warnings), digest.hexdigest()[:16])


def read_poses(
    data: str | Path | DataSet,
    *,
    skin: SkinMesh,
    indenters: str | Path | None = None,
    topics: Topics = MEASURED_TOPICS,
) -> tuple[tuple[Recording, ...], tuple[str, ...]]:
    """Return the motions of a data set, measured or only planned, and what was left out.

    The recordings have force and skin of zeros, so that their observables are those that would be
    measured.

    Raises:
        FileNotFoundError: no data set there.
        ValueError: no trajectory of it has poses.
    """
    data_set = read_data_set(data)
    found: list[Recording | None] = []
    warnings = []
    for entry in data_set.entries:
        try:
            press = read_motion(entry, topics=topics)
            indenter = find_indenter(data_set, entry.indenter, indenters)
        except (FileNotFoundError, ValueError) as error:
            warnings.append(f"{entry.name} was left out: {error}")
            found.append(None)
            continue
        count = press.frame_count
        planned = replace(
            press,
            skin_position_m=np.repeat(skin.rest_position_m[None], count, axis=0),
            force_n=np.zeros((count, 3)),
        )
        depth_m = np.asarray(tip_depth_m(skin, press.poses))
        phase = phases_of(press.poses, press.stamp_s, depth_m)
        found.append(Recording(planned, indenter, 0.0, depth_m, phase))
    recordings = _in_session(found, data_set, topics)
    if not recordings:
        raise ValueError(
            f"{data_set.directory}: no trajectory has poses: {summarize_reasons(warnings)}"
        )
    return tuple(recordings), tuple(warnings)


def _lies_in(folder: Path, name: str) -> bool:
    return any(folder.rglob(name))


def _read(
    data_set: DataSet,
    entry: DataSetEntry,
    skin: SkinMesh,
    indenters: str | Path | None,
    topics: Topics,
) -> Recording:
    found = read_observation(
        data_set,
        entry,
        skin=skin,
        has_vertices=data_set.has_skin_mesh,
        topics=topics,
        indenters=indenters,
    )
    press, indenter = found.press, found.indenter
    depth_m = np.asarray(tip_depth_m(skin, press.poses))
    phase = phases_of(press.poses, press.stamp_s, depth_m)
    return Recording(press, indenter, 0.0, depth_m, phase)


def _in_session(
    found: Sequence[Recording | None], data_set: DataSet, topics: Topics
) -> list[Recording]:
    """Return the recordings with the time of each in the session, to which trajectories that are
    left out belong, too."""
    spans: list[Span | None] = []
    for entry, recording in zip(data_set.entries, found, strict=True):
        if recording is None:
            spans.append(span_of(entry, topics))
        else:
            stamp_s = recording.press.stamp_s
            spans.append((float(stamp_s[0]), float(stamp_s[-1])))
    return [
        replace(recording, session_s=start_s)
        for recording, start_s in zip(found, session_starts(spans), strict=True)
        if recording is not None
    ]


def protocol_of(recording: Recording) -> str:
    """Return a key that trajectories of one kind share: the indenter and its phases in order."""
    steps: Sequence[str] = [phase.value for phase in recording.phase]
    changes = [step for k, step in enumerate(steps) if k == 0 or step != steps[k - 1]]
    return " ".join([recording.press.indenter, *(step for step in changes if step != "idle")])


def one_of_each(protocols: Sequence[str], random: np.random.Generator) -> list[int]:
    """Return the places of the trajectories to hold out: one of each protocol that is repeated,
    those repeated most first, and at most `HELD_OUT_SHARE` of all.

    Args:
        protocols: of each trajectory, by `protocol_of`.
        random: draws the one.
    """
    groups: dict[str, list[int]] = {}
    for place, protocol in enumerate(protocols):
        groups.setdefault(protocol, []).append(place)
    repeated = sorted((m for m in groups.values() if len(m) > 1), key=len, reverse=True)
    most = int(HELD_OUT_SHARE * len(protocols) + 0.5)
    return sorted(int(random.choice(members)) for members in repeated[:most])


def _add(digest: hashlib._Hash, recording: Recording) -> None:
    press = recording.press
    for pose in press.poses:
        digest.update(pose.position_m.tobytes() + pose.quaternion_xyzw.tobytes())
    for array in (press.stamp_s, press.skin_position_m, press.force_n):
        digest.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
