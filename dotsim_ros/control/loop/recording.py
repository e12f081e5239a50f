# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a closed loop did: the motion of the tool, the commands, the frames, with their times; from
messages, from a bag, and in a file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import msg_adapters
from dotsim_ros.data.bag import BagReader
from dotsim_ros.geometry.pose import Pose, compose, inverse
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import parse_json, read_arrays
from dotsim_ros.io.files import whole_file

_DECODERS = {
    "ee_pose": (msg_adapters.decode_pose_stamped, 7),
    "ee_twist": (msg_adapters.decode_twist_stamped, 6),
    "cmd_vel": (msg_adapters.decode_twist_stamped, 6),
    "indenter/pose": (msg_adapters.decode_pose_stamped, 7),
    "wrench": (msg_adapters.decode_wrench_stamped, 6),
}

# Times, then values, of one stream after the other.
_ARRAYS = ("pose_s", "pose", "twist_s", "twist", "command_s", "command", "frame_s", "force_n")


@dataclass(frozen=True)
class LoopPlaces:
    """Where the arm starts (pose of the tool in the base), and how the sensor sits on it (pose of
    the sensor's base in the tool's frame)."""

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
            "indenter": _numbers_of(self.indenter),
            "tool_from_sensor": _numbers_of(self.tool_from_sensor),
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
            return cls(
                **{name: stored[name] for name in _ARRAYS},
                indenter=_pose_of(np.array(known["indenter"])),
                tool_from_sensor=_pose_of(np.array(known["tool_from_sensor"])),
                notes=dict(known["notes"]),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f"{path} is no recording of a closed loop ({error}); remove it"
            ) from error


def recording_of(messages: Mapping[str, Sequence[Any]], **known: Any) -> LoopRecording:
    """Return a recording of messages by relative topic; what else is known as its fields."""
    pose_s, pose = _decoded(messages, "ee_pose")
    twist_s, twist = _decoded(messages, "ee_twist")
    command_s, command = _decoded(messages, "cmd_vel")
    frame_s, wrench = _decoded(messages, "wrench")
    return LoopRecording(
        pose_s, pose, twist_s, twist, command_s, command, frame_s, wrench[:, :3], **known
    )


def read_loop_bag(path: Path, *, notes: Mapping[str, Any] | None = None) -> LoopRecording:
    """Read what `tactile_record` writes by params/closed_loop.yaml, with the sensor's base as the
    tool; where the indenter stands is what its newest pose says that has a tool pose of its own
    time (a recorder may stop between the two).

    Raises:
        FileNotFoundError: nothing is there.
        ValueError: no bag, one that lacks a topic of the loop, or no place of the indenter.
    """
    messages: dict[str, list[Any]] = {}
    with BagReader(path) as bag:
        for name in _DECODERS:
            topic = next((each for each in bag.topics() if f"/{each}".endswith(f"/{name}")), None)
            if topic is None:
                raise ValueError(
                    f"{path} holds no topic {name}, expected those of params/closed_loop.yaml"
                )
            messages[name] = [each.message() for each in bag.messages(topic)]
    seen_s, seen = _decoded(messages, "indenter/pose")
    held_s, held = _decoded(messages, "ee_pose")
    shared_s, of_indenter, of_tool = np.intersect1d(seen_s, held_s, return_indices=True)
    if not len(shared_s):
        raise ValueError(
            f"{path}: no pose of the indenter has the time of a pose of the tool, so that it "
            "cannot be placed; expected both as xarm_sim publishes them"
        )
    indenter = compose(_pose_of(held[of_tool[-1]]), _pose_of(seen[of_indenter[-1]]))
    return recording_of(messages, indenter=indenter, notes=notes or {})


def _decoded(messages: Mapping[str, Sequence[Any]], name: str) -> tuple[FloatArray, FloatArray]:
    """Return the stamps (N,) of a topic's messages, in seconds, and their numbers, a row each."""
    decode, width = _DECODERS[name]
    stamps_ns = [msg_adapters.message_stamp_ns(message) for message in messages[name]]
    rows = [np.concatenate(decode(message)) for message in messages[name]]
    return np.array([1e-9 * each for each in stamps_ns]), np.reshape(rows, (-1, width))


def _numbers_of(pose: Pose) -> list[float]:
    return [*pose.position_m, *pose.quaternion_xyzw]


def _pose_of(numbers: FloatArray) -> Pose:
    return Pose(numbers[:3], numbers[3:])
