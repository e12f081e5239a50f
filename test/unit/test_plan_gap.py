# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `plan-gap` says of two small protocols: which effects look alike, and what tells them apart.

A latency moves the indenter along its way, an offset of the pose does so along z: during a press at
one speed they are the same, on the way back they are opposite.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.cli.main import main
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.scripted import Site, press_hold_release
from dotsim_ros.data.trajectory import PoseChannel, Trajectory
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.io.worker_pool import pool

MOTION = press_hold_release(Site(clearance_m=1e-4), depth_m=2e-3, hold_s=0.0)
SENSOR = "name: coarse\nsolver: {refined: false, grid_spacing_m: 4.2e-3}\n"


def in_this_process(_count: int, begin: Callable[..., None], *given: Any) -> ThreadPoolExecutor:
    """Return a pool that works here: starting a process takes as long as the solves."""
    return ThreadPoolExecutor(1, initializer=begin, initargs=given)


def planned(folder: Path, times_s: np.ndarray) -> dict[str, Any]:
    """Plan a protocol of the frames at these times, as the command does."""
    poses = [MOTION.at(float(time)) for time in times_s]
    pose = PoseChannel(
        (1e9 * (1.0 + times_s)).astype(np.int64),
        np.stack([pose.position_m for pose in poses]),
        np.stack([pose.quaternion_xyzw for pose in poses]),
    )
    data = [(Trajectory(pose=pose, name="press"), sphere(0.004))]
    write_data_set(folder / "data", data, skin=dome_skin(0.01575, 3e-3))
    (folder / "coarse.yaml").write_text(SENSOR, encoding="utf-8")
    line = "--protocols {0}/data --sensor {0}/coarse.yaml --out {0}/plan --json {0}/plan.json"
    assert main(["plan-gap", *line.format(folder).split(), "--workers", "1"]) == 0
    found: dict[str, Any] = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    return found


def alike(plan: dict[str, Any]) -> dict[frozenset[str], dict[str, Any]]:
    return {frozenset((pair["first"], pair["second"])): pair for pair in plan["alike"]}


def test_a_press_cannot_tell_a_latency_from_an_offset_and_the_way_back_can(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(pool, "open_worker_pool", in_this_process)
    (tmp_path / "press").mkdir()
    (tmp_path / "back").mkdir()
    pair = frozenset(("latency", "pose_offset"))

    press = planned(tmp_path / "press", np.linspace(0.0, MOTION.duration_s / 2.0, 4))
    assert press["cosines"]["latency"]["pose_offset"] > 0.95
    assert "there and back at two speeds" in alike(press)[pair]["add"]
    # What lies across the way is no latency.
    assert abs(press["cosines"]["latency"]["pose_offset_x"]) < 0.3
    assert "latency and pose_offset look alike" in capsys.readouterr().out

    back = planned(tmp_path / "back", np.linspace(0.0, MOTION.duration_s, 7))
    assert abs(back["cosines"]["latency"]["pose_offset"]) < 0.3
    assert pair not in alike(back)
    smallest = [plan["effects"]["latency"]["smallest_found"] for plan in (press, back)]
    assert smallest[1] < smallest[0]

    # A relaxation shows on the way back only; nothing slides in either.
    assert "viscoelastic_relaxation" in press["silent"].keys() - back["silent"].keys()
    assert "coulomb_slip" in press["silent"].keys() & back["silent"].keys()
    assert press["add"].keys() == {"weight"}
