# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a measured data set for the gap finder, and reports what of it cannot be used."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dotsim_ros.data.bag import BagReader
from dotsim_ros.data.data_set import INDEX, DataSet, DataSetEntry, find_indenter, read_data_set
from dotsim_ros.data.reading import (
    PressReader,
    read_bag,
    starts_in_session,
    summarize_reasons,
)
from dotsim_ros.data.recording import Recording, recording_of
from dotsim_ros.data.trajectory import MEASURED_TOPICS
from dotsim_ros.geometry.skin_mesh import SkinMesh

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


def holds_skin_or_force(directory: str | Path | DataSet) -> bool:
    """Return whether a bag of a data set holds the skin or the force; a bag that cannot be read
    counts as one that does, so that reading it reports what is wrong."""
    for entry in read_data_set(directory).entries:
        try:
            with BagReader(entry.bag) as bag:
                there = bag.topics()
        except (OSError, ValueError):
            return True
        if MEASURED_TOPICS.skin in there or MEASURED_TOPICS.wrench in there:
            return True
    return False


def read_measurement(
    data: str | Path | DataSet,
    *,
    own_skin: SkinMesh,
    indenters: str | Path | None = None,
) -> Measurement:
    """Read a data set.

    Args:
        data: its folder, or what its index says.
        own_skin: of the sensor's file, used where the data set has no mesh of its own.
        indenters: folder of the indenters' meshes; None as `DataSet.indenter_file`.

    Raises:
        FileNotFoundError: no data set there.
        ValueError: no trajectory of it can be used; the text lists why.
    """
    data_set = read_data_set(data)
    folder = data_set.directory
    ignored = [
        f"{name} lies in the data set: it was not read"
        for name in IGNORED
        if any(folder.rglob(name))
    ]
    reader = PressReader.of(data_set, own_skin, indenters=indenters)

    def read(entry: DataSetEntry) -> Recording:
        found = reader.read(entry)
        return recording_of(found.press, found.indenter, reader.skin)

    recordings, left_out = _read_each(data_set, read)
    warnings = (*ignored, *left_out)
    if not recordings:
        raise ValueError(f"{folder}: no trajectory can be used: {summarize_reasons(warnings)}")
    digest = hashlib.sha256((folder / INDEX).read_bytes())
    for recording in recordings:
        press = recording.press
        for pose in press.poses:
            digest.update(pose.position_m.tobytes() + pose.quaternion_xyzw.tobytes())
        for array in (press.stamp_s, press.skin_position_m, press.force_n):
            digest.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    return Measurement(folder, reader.skin, recordings, warnings, digest.hexdigest()[:16])


def read_poses(
    data: str | Path | DataSet,
    *,
    skin: SkinMesh,
    indenters: str | Path | None = None,
) -> tuple[tuple[Recording, ...], tuple[str, ...]]:
    """Return the motions of a data set, measured or only planned, and what was left out.

    Force is zero and the skin at rest, so that the observables are those that would be measured.

    Raises:
        ValueError: no trajectory of it has poses.
    """
    data_set = read_data_set(data)

    def read(entry: DataSetEntry) -> Recording:
        press = read_bag(entry, channels=("pose",)).press()
        count = press.frame_count
        planned = replace(
            press,
            skin_position_m=np.repeat(skin.rest_position_m[None], count, axis=0),
            force_n=np.zeros((count, 3)),
        )
        return recording_of(planned, find_indenter(data_set, entry.indenter, indenters), skin)

    recordings, warnings = _read_each(data_set, read)
    if not recordings:
        raise ValueError(
            f"{data_set.directory}: no trajectory has poses: {summarize_reasons(warnings)}"
        )
    return recordings, warnings


def _read_each(
    data_set: DataSet, read: Callable[[DataSetEntry], Recording]
) -> tuple[tuple[Recording, ...], tuple[str, ...]]:
    """Return the recordings that can be read, with the time of each in the session, to which the
    others belong, too; and why those were left out."""
    found: list[Recording | None] = []
    left_out = []
    for entry in data_set.entries:
        try:
            found.append(read(entry))
        except (FileNotFoundError, ValueError) as error:
            left_out.append(f"{entry.name} was left out: {error}")
            found.append(None)
    spans = [
        None if one is None else (float(one.press.stamp_s[0]), float(one.press.stamp_s[-1]))
        for one in found
    ]
    starts_s = starts_in_session(data_set, spans)
    recordings = tuple(
        replace(one, session_s=start_s)
        for one, start_s in zip(found, starts_s, strict=True)
        if one is not None
    )
    return recordings, tuple(left_out)


def protocol_of(recording: Recording) -> str:
    """Return a key that trajectories of one kind share: the indenter and its phases in order."""
    steps: Sequence[str] = [phase.value for phase in recording.phase]
    changes = [step for k, step in enumerate(steps) if k == 0 or step != steps[k - 1]]
    return " ".join([recording.press.indenter, *(step for step in changes if step != "idle")])


def one_of_each(protocols: Sequence[str], random: np.random.Generator) -> list[int]:
    """Return the places of the trajectories to hold out, by their protocols: one of each that is
    repeated, those repeated most first, and at most `HELD_OUT_SHARE` of all."""
    groups: dict[str, list[int]] = {}
    for place, protocol in enumerate(protocols):
        groups.setdefault(protocol, []).append(place)
    repeated = sorted((m for m in groups.values() if len(m) > 1), key=len, reverse=True)
    most = int(HELD_OUT_SHARE * len(protocols) + 0.5)
    return sorted(int(random.choice(members)) for members in repeated[:most])
