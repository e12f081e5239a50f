# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads a measured data set for the gap finder, and reports what of it cannot be used."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dotsim_ros.data.bag import BagReader
from dotsim_ros.data.data_set import INDEX, DataSet, read_data_set
from dotsim_ros.data.reading import (
    PRESS_CHANNELS,
    BadBagError,
    PressImages,
    PressReader,
    starts_in_session,
    summarize_reasons,
)
from dotsim_ros.data.recording import Recording, Span, recording_of
from dotsim_ros.data.trajectory import MEASURED_TOPICS
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh

HELD_OUT_SHARE = 0.4
"""At most this share of the trajectories is kept for the figures after the search."""
MOST_IMAGES = 300
"""Most images of a data set that are used; trajectories are thinned evenly to this number."""
LEAST_FRAMES = 4
"""Least number of frames of a trajectory that is thinned."""
IGNORED = ("truth.json", "truth.yaml")
"""Files that say what was done to a data set: never read; that they are there is reported."""


@dataclass(frozen=True)
class Footage:
    """Images of a trajectory.

    Attributes:
        images: with the motion at their times.
        indenter: what pressed.
        session_s: time from the start of the data set's first trajectory to the first image.
    """

    images: PressImages
    indenter: Indenter
    session_s: float


@dataclass(frozen=True)
class Measurement:
    """A data set, as far as it can be used.

    Attributes:
        data_set: its folder and index.
        skin: the skin that its clouds list, or the sensor's own where no clouds are.
        recordings: presses that can be used, in the order of the index; none where not asked for.
        footage: images that can be used, in the order of the index; none where not asked for.
        warnings: what was left out of the presses, and why.
        image_warnings: what was left out of the images, and why.
        digest: of the presses.
    """

    data_set: DataSet
    skin: SkinMesh
    recordings: tuple[Recording, ...]
    footage: tuple[Footage, ...]
    warnings: tuple[str, ...]
    image_warnings: tuple[str, ...]
    digest: str

    @property
    def directory(self) -> Path:
        """Folder of the data set."""
        return self.data_set.directory


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
    presses: bool = True,
    images: bool = False,
) -> Measurement:
    """Read a data set; each bag is opened, and each of its messages decoded, once.

    Args:
        data: its folder, or what its index says.
        own_skin: of the sensor's file, used where the data set has no mesh of its own.
        indenters: folder of the indenters' meshes; None as `DataSet.indenter_file`.
        presses: whether to read skin and force.
        images: whether to read images, of which at most `MOST_IMAGES` are kept.

    Raises:
        FileNotFoundError: no data set there.
        ValueError: presses were asked for and none can be used; the text lists why.
    """
    data_set = read_data_set(data)
    folder = data_set.directory
    warnings = [
        f"{name} lies in the data set: it was not read"
        for name in IGNORED
        if any(folder.rglob(name))
    ]
    image_warnings = []
    reader = PressReader.of(data_set, own_skin, indenters=indenters)
    most = _most_frames([entry.frame_count for entry in data_set.entries if entry.has_images])
    spans_s: list[Span | None] = []
    recordings: dict[str, Recording] = {}
    filmed: dict[str, tuple[PressImages, Indenter]] = {}
    for entry in data_set.entries:
        name = entry.name
        has_images = images and entry.has_images
        channels = PRESS_CHANNELS if presses else ("pose", "wrench")
        bag = reader.open(entry, (*channels, "image") if has_images else channels)
        spans_s.append(bag.span_s)
        if presses:
            try:
                found = reader.observation(bag)
                recordings[name] = recording_of(found.press, found.indenter, reader.skin)
            except BadBagError as error:
                warnings.append(f"{name} was left out: {error}")
        if has_images:
            try:
                filmed[name] = bag.footage(most=most), reader.indenter(entry)
            except BadBagError as error:
                image_warnings.append(f"the images of {name} were left out: {error}")
    if presses and not recordings:
        raise ValueError(f"{folder}: no trajectory can be used: {summarize_reasons(warnings)}")
    starts_s = _starts(data_set, spans_s)
    footage = tuple(
        Footage(one, indenter, starts_s[name] + one.delay_s)
        for name, (one, indenter) in filmed.items()
    )
    digest = hashlib.sha256((folder / INDEX).read_bytes())
    for recording in recordings.values():
        press = recording.press
        for pose in press.poses:
            digest.update(pose.position_m.tobytes() + pose.quaternion_xyzw.tobytes())
        for array in (press.stamp_s, press.skin_position_m, press.force_n):
            digest.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    return Measurement(
        data_set,
        reader.skin,
        _placed(recordings, starts_s),
        footage,
        tuple(warnings),
        tuple(image_warnings),
        digest.hexdigest()[:16],
    )


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
    reader = PressReader(data_set, skin, False, indenters=indenters)
    recordings: dict[str, Recording] = {}
    warnings = []
    spans_s = []
    for entry in data_set.entries:
        bag = reader.open(entry, ("pose",))
        spans_s.append(bag.span_s)
        try:
            press = bag.press()
            planned = replace(
                press,
                skin_position_m=np.repeat(skin.rest_position_m[None], press.frame_count, axis=0),
                force_n=np.zeros((press.frame_count, 3)),
            )
            recordings[entry.name] = recording_of(planned, reader.indenter(entry), skin)
        except BadBagError as error:
            warnings.append(f"{entry.name} was left out: {error}")
    if not recordings:
        raise ValueError(
            f"{data_set.directory}: no trajectory has poses: {summarize_reasons(warnings)}"
        )
    return _placed(recordings, _starts(data_set, spans_s)), tuple(warnings)


def _starts(data_set: DataSet, spans_s: Sequence[Span | None]) -> dict[str, float]:
    """Return when each trajectory began in the session, by its name."""
    names = [entry.name for entry in data_set.entries]
    return dict(zip(names, starts_in_session(data_set, spans_s), strict=True))


def _placed(
    recordings: Mapping[str, Recording], starts_s: Mapping[str, float]
) -> tuple[Recording, ...]:
    """Return recordings with the time of each in the session, to which those that were left out
    belong, too."""
    return tuple(replace(one, session_s=starts_s[name]) for name, one in recordings.items())


def _most_frames(counts: Sequence[int]) -> int:
    """Return to how many frames each trajectory is thinned; 0 stands for a count that is not
    known."""
    if all(counts) and sum(counts) <= MOST_IMAGES:
        return MOST_IMAGES
    return max(LEAST_FRAMES, MOST_IMAGES // max(len(counts), 1))


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
