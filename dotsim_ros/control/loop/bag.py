# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A closed loop's bag as a recording: what `tactile_record` writes by params/closed_loop.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import msg_adapters
from dotsim_ros.control.loop.recording import LoopRecording
from dotsim_ros.data.bag import BagReader
from dotsim_ros.geometry.pose import Pose, compose
from dotsim_ros.io.arrays import FloatArray

_DECODERS = {
    "ee_pose": (msg_adapters.decode_pose_stamped, 7),
    "ee_twist": (msg_adapters.decode_twist_stamped, 6),
    "cmd_vel": (msg_adapters.decode_twist_stamped, 6),
    "indenter/pose": (msg_adapters.decode_pose_stamped, 7),
    "wrench": (msg_adapters.decode_wrench_stamped, 6),
}


def read_loop_bag(
    path: Path,
    *,
    tool_from_sensor: Pose | None = None,
    notes: Mapping[str, Any] | None = None,
) -> LoopRecording:
    """Read a recording; where the indenter stands is what its newest pose says that has a tool pose
    of its own time (a recorder may stop between the two).

    Args:
        path: folder of the bag.
        tool_from_sensor: pose of the sensor's base in the tool's frame.
        notes: what else is known.

    Raises:
        FileNotFoundError: nothing is there.
        ValueError: no bag, one that lacks a topic of the loop, or no place of the indenter.
    """
    times: dict[str, FloatArray] = {}
    rows: dict[str, FloatArray] = {}
    with BagReader(path) as bag:
        for name, (decode, width) in _DECODERS.items():
            topic = _topic(name, bag.topics())
            if topic is None:
                raise ValueError(
                    f"{path} holds no topic {name}, expected those of params/closed_loop.yaml"
                )
            messages = [each.message() for each in bag.messages(topic)]
            times[name] = np.array([1e-9 * msg_adapters.message_stamp_ns(m) for m in messages])
            found = [np.concatenate(decode(message)) for message in messages]
            rows[name] = np.reshape(found, (-1, width))
    shared_s, of_indenter, of_tool = np.intersect1d(
        times["indenter/pose"], times["ee_pose"], return_indices=True
    )
    if not len(shared_s):
        raise ValueError(
            f"{path}: no pose of the indenter has the time of a pose of the tool, so that it "
            "cannot be placed; expected both as xarm_sim publishes them"
        )
    tool_from_sensor = tool_from_sensor or Pose()
    seen, held = rows["indenter/pose"][of_indenter[-1]], rows["ee_pose"][of_tool[-1]]
    tool = Pose(held[:3], held[3:])
    indenter = compose(compose(tool, tool_from_sensor), Pose(seen[:3], seen[3:]))
    return LoopRecording(
        pose_s=times["ee_pose"],
        pose=rows["ee_pose"],
        twist_s=times["ee_twist"],
        twist=rows["ee_twist"],
        command_s=times["cmd_vel"],
        command=rows["cmd_vel"],
        frame_s=times["wrench"],
        force_n=rows["wrench"][:, :3],
        indenter=indenter,
        tool_from_sensor=tool_from_sensor,
        notes=notes or {},
    )


def _topic(name: str, topics: Mapping[str, str]) -> str | None:
    """Return the topic of a relative name, in whatever namespace."""
    found = [topic for topic in topics if topic == name or topic.endswith(f"/{name}")]
    return found[0] if found else None
