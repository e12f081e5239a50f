# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the milliseconds of a frame go, by traces of running nodes (`-p trace:=FILE` of any node).

A part's time is that of its spans less what other spans take within them: by the wall clock, which
counts the waits for a core and for Python's lock, and of a core, which does not. Parts of the gel
have no time of a core: "gel" has it. Parts of two threads may run at once.
"""

from __future__ import annotations

import json
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.cli.demo_loop import POLICY
from dotsim_ros.control.loop.judge import trial_start
from dotsim_ros.control.policy.demonstration import contact_of
from dotsim_ros.control.policy.network import read_policy
from dotsim_ros.control.policy.paths import reference_path
from dotsim_ros.control.policy.rollout import APPROACH_S
from dotsim_ros.data.motion import Motion
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.nodes.loop.closed_loop import (
    REALTIME,
    SENSOR,
    ClosedLoop,
    LoopSetup,
    loop_parameters,
    policy_name,
)
from dotsim_ros.nodes.tactile_policy.files import policy_folder
from dotsim_ros.sensor import FRAME_S
from dotsim_ros.specification import load_sensor
from dotsim_ros.view.sensors import motion
from studies.run import expect_positive
from studies.speed.realtime import FRAME_RATE_HZ, LEARNED_SENSOR, measure_node

MARKED_SENSOR = "gelsight_mini"
LOOP = "loop"
FRAMES = ("frames", "inference", "arm")
"""Spans that count as a frame: of the sensor, the policy, the arm; a process has one of them."""


@dataclass
class Part:
    """A part of the frames: times without what lies within, in microseconds."""

    wall_us: float = 0.0
    core_us: float = 0.0
    longest_us: float = 0.0


def shares(file: Path) -> dict[str, Any]:
    """Return the rate of a trace's frames, and of each part milliseconds of a frame, by the wall
    clock and of a core, and its longest span, the largest part first.

    Raises:
        ValueError: it is no trace of a node, or one without two frames.
    """
    try:
        # The list has no end.
        events = json.loads(file.read_text(encoding="utf-8").rstrip().rstrip(",") + "]")
        spans = sorted(
            (e["tid"], e["ts"], -e["dur"], e["name"], e.get("tdur", 0.0))
            for e in events
            if e["ph"] == "X"
        )
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{file} is no trace of a node ({error!r}); write one with -p trace:=FILE"
        ) from error
    frames_us = [span[1] for span in spans if span[3] in FRAMES]
    if len(frames_us) < 2:
        raise ValueError(f"{file} holds {len(frames_us)} frames in real time, expected 2 or more")
    first_us = min(frames_us)
    parts: defaultdict[str, Part] = defaultdict(Part)
    around: list[tuple[int, float, Part]] = []
    for thread, begun_us, minus_us, name, core_us in spans:
        if begun_us < first_us:
            continue
        while around and (around[-1][0] != thread or around[-1][1] <= begun_us):
            around.pop()
        part = parts[name]
        part.wall_us -= minus_us
        part.core_us += core_us
        part.longest_us = max(part.longest_us, -minus_us)
        if around:
            around[-1][2].wall_us += minus_us
            around[-1][2].core_us -= core_us
        around.append((thread, begun_us - minus_us, part))
    count = len(frames_us)
    return {
        "frames_per_second": round(1e6 * (count - 1) / (max(frames_us) - first_us), 2),
        "parts": [
            {
                "part": name,
                "wall_ms_per_frame": round(1e-3 * part.wall_us / count, 2),
                "core_ms_per_frame": round(1e-3 * part.core_us / count, 2),
                "longest_ms": round(1e-3 * part.longest_us, 1),
            }
            for name, part in sorted(parts.items(), key=lambda each: -each[1].wall_us)
        ],
    }


def traced_node(sensor: str, seconds: float, file: Path) -> None:
    """Trace a sensor's node while a ball presses, slides and lifts."""
    specification = load_sensor(sensor)
    apex_m = skin_of(specification.gel).apex_m
    poses = tuple(pose.on(apex_m) for pose in motion(specification))
    moves = Motion(FRAME_S * np.arange(len(poses), dtype=np.float64), poses)
    measure_node(seconds, FRAME_RATE_HZ, sensor, {"trace": file}, motion=moves)


def traced_loop(seconds: float, file: Path) -> None:
    """Trace the sensor's node in the closed loop in real time."""
    policy = policy_folder(POLICY)
    card, _ = read_policy(policy)
    ball = load_indenter(loop_parameters(SENSOR)["indenter"])
    contact = contact_of(load_sensor(card.sensor), ball)
    setup = LoopSetup(
        policy_name(policy),
        sensor=card.sensor,
        sensor_parameters={"trace": file},
    )
    path = reference_path("figure_eight", contact)
    with ClosedLoop(setup, contact=contact, clock=REALTIME) as loop:
        loop.start(path.name)
        loop.trial(trial_start(path, contact, seed=0, number=0), APPROACH_S + seconds)
        loop.close()


def frame_shares(*, files: tuple[Path, ...] = (), seconds: float = 20.0) -> dict[str, Any]:
    """Where the milliseconds of a frame go: shares of its parts, by traces of running nodes.

    Args:
        files: traces; none: of a dome with a learned image, a pad with markers, and the loop.
        seconds: that each of these is traced.
    """
    expect_positive(seconds=seconds)
    with tempfile.TemporaryDirectory() as name:
        if not files:
            folder = Path(name)
            for sensor in (LEARNED_SENSOR, MARKED_SENSOR):
                traced_node(sensor, seconds, folder / sensor)
            traced_loop(seconds, folder / LOOP)
            files = tuple(sorted(folder.iterdir()))
        return {"traces": {file.name: shares(file) for file in files}}
