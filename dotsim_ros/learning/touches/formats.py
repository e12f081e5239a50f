# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The formats of a data set of touches. Each is written in groups, whole or not at all."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dotsim_ros.data.data_set_writer import DataSetWriter, trajectory_of_frames
from dotsim_ros.data.lerobot.bags import POSE_NAMES, WRENCH_NAMES
from dotsim_ros.data.lerobot.writer import LeRobotWriter
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.io.files import encoded_image, no_room_named, whole_file
from dotsim_ros.learning.touches.making import Side, Touch
from dotsim_ros.learning.touches.plan import TouchPlan

KEYS = {
    "image": "observation.images.{side}",
    "difference": "observation.images.{side}_difference",
    "depth": "observation.tactile.{part}depth",
    "normal": "observation.tactile.{part}normal",
    "markers": "observation.tactile.{part}marker_displacement",
    "skin": "observation.tactile.{part}skin_displacement",
    "wrench": "observation.tactile.{part}wrench",
    "contact": "observation.tactile.{part}contact",
    "slip": "observation.tactile.{part}slip_share",
    "pose": "observation.state{end}",
}
"""What each array is called: `side` is gel, or left and right of a grasp, which alone has `part`
(the side and a dot) and `end` (a dot and the side)."""
CONSTANTS = "constants"
"""Key of what was drawn for a touch, in every frame."""
IMAGES = ("image", "difference")
NAMES = {"wrench": WRENCH_NAMES, "pose": POSE_NAMES}
LEROBOT, WEBDATASET, BAGS = "lerobot", "webdataset", "bags"
FIELD_WIDTH_PX = {LEROBOT: 80, WEBDATASET: 100_000, BAGS: 80}
"""Most columns of depth, normals and contact: in a table of numbers each place takes four bytes or
more, in an archive they are as fine as the image."""


def key_of(name: str, side: int, side_count: int) -> str:
    """Return what data sets call an array of one side of a touch."""
    if side_count == 1:
        return KEYS[name].format(side="gel", part="", end="")
    word = ("left", "right")[side]
    return KEYS[name].format(side=word, part=f"{word}.", end=f".{word}")


def arrays_of(touch: Touch) -> dict[str, np.ndarray[Any, Any]]:
    """Return all arrays (F, ...) of a touch by their keys."""
    return {
        key_of(name, number, len(touch.sides)): values
        for number, side in enumerate(touch.sides)
        for name, values in side.arrays.items()
    }


class TouchFormat(Protocol):
    """Writes groups of touches into a folder."""

    def holds(self, number: int) -> bool:
        """Return whether a group is there, whole."""

    def add(self, number: int, touches: Sequence[Touch]) -> None:
        """Write a group; groups come in order."""


class LeRobotFormat:
    """A LeRobotDataset v3.0: an episode a touch, a file a group."""

    def __init__(self, folder: Path, plan: TouchPlan) -> None:
        self._folder, self._plan = folder, plan
        self._writer: LeRobotWriter | None = None
        self._written = 0
        info = folder / "meta/info.json"
        if info.is_file():
            self._written = int(json.loads(info.read_text())["total_episodes"])

    def holds(self, number: int) -> bool:
        return number * self._plan.touches_a_gel < self._written

    def add(self, number: int, touches: Sequence[Touch]) -> None:
        if self._writer is None:
            self._writer = LeRobotWriter(
                self._folder,
                _features(touches[0], self._plan),
                self._plan.rate_hz,
                robot_type=self._plan.sensor.name,
            )
        for touch in touches:
            arrays = arrays_of(touch)
            if "constants" in self._plan.contents:
                row = np.array(list(touch.constants.values()), dtype=np.float32)
                arrays[CONSTANTS] = np.tile(row, (self._plan.frames, 1))
            self._writer.add_episode(arrays, touch.task)
        self._writer.flush()


def _features(touch: Touch, plan: TouchPlan) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for number, side in enumerate(touch.sides):
        for name, values in side.arrays.items():
            is_image = name in IMAGES
            found[key_of(name, number, len(touch.sides))] = {
                "dtype": "video" if is_image else str(values.dtype),
                "shape": values.shape[1:] or (1,),
                "names": ["height", "width", "channels"] if is_image else NAMES.get(name),
            }
    if "constants" in plan.contents:
        names = list(touch.constants)
        found[CONSTANTS] = {"dtype": "float32", "shape": (len(names),), "names": names}
    return found


class WebDatasetFormat:
    """Archives of WebDataset: a sample a frame, an archive a group."""

    def __init__(self, folder: Path, plan: TouchPlan) -> None:
        self._folder, self._plan = folder, plan

    def _path(self, number: int) -> Path:
        return self._folder / f"touches-{number:06d}.tar"

    def holds(self, number: int) -> bool:
        return self._path(number).is_file()

    def add(self, number: int, touches: Sequence[Touch]) -> None:
        with whole_file(self._path(number)) as part, tarfile.open(part, "w") as archive:
            for touch in touches:
                for frame in range(self._plan.frames):
                    for ending, content in self._sample(touch, frame).items():
                        member = tarfile.TarInfo(f"{touch.number:06d}_{frame:04d}.{ending}")
                        member.size = len(content)
                        archive.addfile(member, io.BytesIO(content))

    def _sample(self, touch: Touch, frame: int) -> dict[str, bytes]:
        """Return the files of a sample by their endings."""
        files = {}
        numbers: dict[str, np.ndarray[Any, Any]] = {}
        for key, values in arrays_of(touch).items():
            if key.startswith("observation.images."):
                name = f"{key.removeprefix('observation.images.')}.png"
                files[name] = encoded_image(name, values[frame])
            else:
                numbers[key] = values[frame]
        stream = io.BytesIO()
        np.savez(stream, allow_pickle=False, **numbers)
        about = {"task": touch.task, "time_s": frame / self._plan.rate_hz}
        if "constants" in self._plan.contents:
            about |= {CONSTANTS: dict(touch.constants)}
        return {**files, "npz": stream.getvalue(), "json": json.dumps(about).encode()}


@dataclass(frozen=True)
class _BagFrame:
    time_s: float
    indenter_pose: Pose
    wrench: Wrench
    skin_position_m: FloatArray
    image: ImageArray


class BagFormat:
    """The layout of measured data sets: a bag a touch, of each side of a grasp one."""

    def __init__(self, folder: Path, plan: TouchPlan) -> None:
        self._plan = plan
        self._writer = DataSetWriter(folder, skin_of(plan.sensor.gel))

    def _name(self, touch: int, side: int) -> str:
        return f"touch_{touch:06d}" + (("_left", "_right")[side] if self._plan.is_grasp else "")

    def holds(self, number: int) -> bool:
        last = (number + 1) * self._plan.touches_a_gel - 1
        return self._writer.holds(self._name(last, int(self._plan.is_grasp)), {"group": number})

    def add(self, number: int, touches: Sequence[Touch]) -> None:
        with no_room_named(self._writer.directory):
            for touch in touches:
                for side, one in enumerate(touch.sides):
                    name = self._name(touch.number, side)
                    notes = {"group": number, "task": touch.task, **touch.constants}
                    if not self._writer.holds(name, {"group": number}):
                        trajectory = trajectory_of_frames(self._frames(one), name=name)
                        self._writer.add(trajectory, touch.indenter, notes)

    def _frames(self, side: Side) -> list[_BagFrame]:
        solved = side.solved
        return [
            _BagFrame(index / self._plan.rate_hz, *values)
            for index, values in enumerate(
                zip(
                    solved.poses,
                    solved.wrenches,
                    solved.skin_position_m,
                    side.images,
                    strict=True,
                )
            )
        ]


FORMATS: Mapping[str, type[LeRobotFormat] | type[WebDatasetFormat] | type[BagFormat]] = {
    LEROBOT: LeRobotFormat,
    WEBDATASET: WebDatasetFormat,
    BAGS: BagFormat,
}
