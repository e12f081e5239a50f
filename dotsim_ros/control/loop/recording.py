# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a closed loop did: the motion of the tool, the commands, the frames, with their times."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.geometry.pose import Pose, compose, inverse
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import parse_json, read_arrays
from dotsim_ros.io.files import whole_file

# Times, then values, of one stream after the other.
_ARRAYS = ("pose_s", "pose", "twist_s", "twist", "command_s", "command", "frame_s", "force_n")


@dataclass(frozen=True)
class LoopPlaces:
    """Where the arm starts, and how the sensor sits on it.

    Attributes:
        start: pose of the tool in the base.
        tool_from_sensor: pose of the sensor's base in the tool's frame.
    """

    start: Pose
    tool_from_sensor: Pose = field(default_factory=Pose)

    def indenter(self, position_m: FloatArray) -> Pose:
        """Return the pose in the base of an indenter that a sensor on the arm's start has at
        a place (3,), its axes parallel to the sensor's."""
        return compose(compose(self.start, self.tool_from_sensor), Pose(position_m))


@dataclass(frozen=True, eq=False)
class LoopRecording:
    """A stretch of a closed loop. Times are of the messages' stamps, in seconds.

    Attributes:
        pose_s, pose: (N,) and (N, 7) the tool in the base: position in m, quaternion x, y, z, w.
        twist_s, twist: (M,) and (M, 6) its velocity along the base's axes, m/s and rad/s.
        command_s, command: (K,) and (K, 6) velocity commands.
        frame_s, force_n: (F,) and (F, 3) the sensor's frames and the force on its indenter.
        indenter: pose in the base of what the sensor was held against.
        tool_from_sensor: pose of the sensor's base in the tool's frame.
        notes: what else is known, as JSON holds it.
    """

    pose_s: FloatArray
    pose: FloatArray
    twist_s: FloatArray
    twist: FloatArray
    command_s: FloatArray
    command: FloatArray
    frame_s: FloatArray
    force_n: FloatArray
    indenter: Pose
    tool_from_sensor: Pose = field(default_factory=Pose)
    notes: Mapping[str, Any] = field(default_factory=dict)

    def indenter_m(self) -> FloatArray:
        """Return (N, 3) where the indenter was in the sensor's frame, at `pose_s`."""
        places = np.empty((len(self.pose), 3))
        for index, row in enumerate(self.pose):
            sensor = compose(Pose(row[:3], row[3:]), self.tool_from_sensor)
            places[index] = compose(inverse(sensor), self.indenter).position_m
        return places

    def led_s(self) -> tuple[float, float]:
        """Return when the first and the last command other than zero was given.

        Raises:
            ValueError: none was.
        """
        moving = self.command_s[self.command.any(axis=1)]
        if not len(moving):
            raise ValueError("no command but zero: the policy never moved the arm")
        return float(moving[0]), float(moving[-1])

    def between(self, begun_s: float, ended_s: float) -> LoopRecording:
        """Return what lies between two times."""
        kept: dict[str, Any] = {}
        for times, values in (_ARRAYS[i : i + 2] for i in range(0, len(_ARRAYS), 2)):
            stamp_s = getattr(self, times)
            inside = (stamp_s >= begun_s) & (stamp_s <= ended_s)
            kept[times], kept[values] = stamp_s[inside], getattr(self, values)[inside]
        return replace(self, **kept)

    def save(self, path: Path) -> None:
        """Write the recording, whole or not at all."""
        known = {
            "indenter": [*self.indenter.position_m, *self.indenter.quaternion_xyzw],
            "tool_from_sensor": [
                *self.tool_from_sensor.position_m,
                *self.tool_from_sensor.quaternion_xyzw,
            ],
            "notes": dict(self.notes),
        }
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        with whole_file(path) as part:
            np.savez_compressed(part, known=np.array(json.dumps(known)), **arrays)

    @classmethod
    def load(cls, path: Path) -> LoopRecording:
        """Read a recording.

        Raises:
            FileNotFoundError: no such file.
            ValueError: it is none that `save` wrote.
        """
        try:
            stored = read_arrays(path)
            known = parse_json(str(stored["known"]), "what is known of it")
            arrays = {name: stored[name] for name in _ARRAYS}
            indenter, sensor = known["indenter"], known["tool_from_sensor"]
            return cls(
                **arrays,
                indenter=Pose(np.array(indenter[:3]), np.array(indenter[3:])),
                tool_from_sensor=Pose(np.array(sensor[:3]), np.array(sensor[3:])),
                notes=dict(known["notes"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f"{path} is no recording of a closed loop ({error}); remove it"
            ) from error
