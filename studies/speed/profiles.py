# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Error and time of a frame under each profile of `tactile_sim`, against `exact`, in one run.

Each indenter is pressed to a fifth of the gel's thickness, 0.2 mm a frame, lifted by a quarter of
that, and slid there and back over 3.2 mm, 0.4 mm a frame: 5 and 10 mm/s at 25 Hz. Each pose is
solved with every profile, one after the other, so that what else the machine does slows all alike.
The error of a frame is the distance of a skin marker from where `exact` has it: of the worst marker
of each frame the median and the 99th percentile over the frames, and the largest of all. The force
error is a share of the motion's largest force.

In the slide each gel then hands its state to the one of the next profile, there and back, as `auto`
does: how far the skin jumps, and how long it takes. Next to it: how far it would jump if the other
gel were pressed again at the same pose.

The ball is pressed and slid once more twice as deep, which is beyond what is documented: there a
frame of two iterations may be far from the equilibrium, and is marked as not converged.

At last the profiles are made side by side in a process of their own: time and memory.
"""

from __future__ import annotations

import resource
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.gel.implicit.handover import SkinJumpError
from dotsim_ros.gel.make import make_gel, skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.nodes.tactile_sim.active_profile import ladder_of
from dotsim_ros.nodes.tactile_sim.profiles import AUTO, EXACT, PROFILES
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SensorSpecification, SolverSpecification, load_sensor
from studies.run import FAILED
from studies.timing import percentiles_ms

SENSORS = ("densetact2", "sensor_a", "flat_pad")
INDENTERS = ("sphere_4mm", "box_edge", "flat_punch")
DEPTH_SHARE, DEEP_SHARE = 0.2, 0.4
DEEP_INDENTER = "sphere_4mm"
LIFT_SHARE = 0.25
PRESS_STEP_M, SLIDE_STEP_M, SLIDE_STEPS = 0.2e-3, 0.4e-3, 8
FRAME_S = 0.04
HANDOVER_EVERY = 4


def motion(sensor: SensorSpecification, depth_share: float = DEPTH_SHARE) -> list[Pose]:
    """Return the press to a share of the gel's thickness and the slide, a pose a frame."""
    top_m = float(skin_of(sensor.gel).rest_position_m[:, 2].max())
    depth_m = depth_share * sensor.gel.thickness_m
    lifted_m = (1.0 - LIFT_SHARE) * depth_m
    steps = int(np.ceil(depth_m / PRESS_STEP_M))
    places = [(0.0, depth) for depth in np.linspace(0.0, depth_m, steps + 1)[1:]]
    places += [(0.0, depth) for depth in np.linspace(depth_m, lifted_m, 3)[1:]]
    there = [SLIDE_STEP_M * step for step in range(1, SLIDE_STEPS + 1)]
    places += [(x, lifted_m) for x in (*there, *reversed(there[:-1]), 0.0)]
    return [Pose(np.array([x, 0.0, top_m - depth])) for x, depth in places]


def errors(
    sensor: SensorSpecification, indenter: str, depth_share: float = DEPTH_SHARE
) -> dict[str, Any]:
    """Return errors and times of each profile in the motion, by name."""
    poses, skin, shape = motion(sensor, depth_share), skin_of(sensor.gel), load_indenter(indenter)
    rungs = {name: ladder_of(name, sensor)[0] for name in PROFILES}
    gels = {name: make_gel(_with(sensor, rung.solver), skin, shape) for name, rung in rungs.items()}
    # Once before, so that no frame waits for a compiler.
    for gel in gels.values():
        gel.step(poses[0], FRAME_S)
        gel.reset()
    skins: dict[str, list[FloatArray]] = {name: [] for name in gels}
    forces: dict[str, list[FloatArray]] = {name: [] for name in gels}
    spent_s: dict[str, list[float]] = {name: [] for name in gels}
    unconverged = dict.fromkeys(gels, 0)
    for pose in poses:
        for name, gel in gels.items():
            begun_s = time.perf_counter()
            frame = gel.step(pose, FRAME_S)
            spent_s[name].append(time.perf_counter() - begun_s)
            skins[name].append(frame.skin_position_m)
            forces[name].append(frame.wrench.force_n)
            unconverged[name] += not frame.converged
    exact_skin, exact_force = np.array(skins[EXACT.name]), np.array(forces[EXACT.name])
    largest_n = float(np.linalg.norm(exact_force, axis=1).max())
    whole_s = sum(spent_s[EXACT.name])
    found = {}
    for name in gels:
        worst_mm = 1e3 * np.linalg.norm(np.array(skins[name]) - exact_skin, axis=2).max(axis=1)
        share = np.linalg.norm(np.array(forces[name]) - exact_force, axis=1) / largest_n
        found[name] = {
            "skin_p50_mm": round(float(np.percentile(worst_mm, 50)), 4),
            "skin_p99_mm": round(float(np.percentile(worst_mm, 99)), 4),
            "skin_max_mm": round(float(worst_mm.max()), 4),
            "force_mean_percent": round(100.0 * float(share.mean()), 2),
            "force_max_percent": round(100.0 * float(share.max()), 2),
            "time_ratio": round(sum(spent_s[name]) / whole_s, 3),
            **{
                f"gel_{key}": value
                for key, value in percentiles_ms(spent_s[name], (50, 95)).items()
            },
            "unconverged_frames": unconverged[name],
            "grid_spacing_mm": round(1e3 * rungs[name].solver.grid_spacing_m, 3),
        }
    return {
        "sensor": sensor.name,
        "indenter": indenter,
        "depth_mm": round(1e3 * depth_share * sensor.gel.thickness_m, 2),
        "frames": len(poses),
        "largest_force_n": round(largest_n, 3),
        "profiles": found,
    }


def handovers(sensor: SensorSpecification, indenter: str) -> list[dict[str, Any]]:
    """Return how far the skin jumps where one profile follows another during the slide, and how far
    it would if the second one were pressed again at the same pose."""
    rungs = ladder_of(AUTO, sensor)
    shape = load_indenter(indenter)
    live = TactileSensor(_with(sensor, rungs[0].solver), indenter=shape)
    for rung in rungs:
        live.prepare_solver(rung.solver)
    skin = live.skin
    rows = []
    for first, second in pairwise([*rungs, *reversed(rungs[:-1])]):
        again = make_gel(_with(sensor, second.solver), skin, shape)
        live.reset()
        live.set_solver(first.solver)
        jump_m, anew_m, spent_s, refused = [0.0], [0.0], [0.0], 0
        limit_m = max(first.profile.skin_error_m, second.profile.skin_error_m)
        for number, pose in enumerate(motion(sensor)):
            before_m = live.press(pose, FRAME_S).skin_position_m
            if number % HANDOVER_EVERY:
                continue
            again.reset()
            other_m = again.step(pose, FRAME_S).skin_position_m
            anew_m.append(float(np.linalg.norm(other_m - before_m, axis=1).max()))
            begun_s = time.perf_counter()
            try:
                jump_m.append(live.set_solver(second.solver, largest_jump_m=limit_m))
            except SkinJumpError:
                refused += 1
            spent_s.append(time.perf_counter() - begun_s)
            live.set_solver(first.solver)
        rows.append(
            {
                "from": first.profile.name,
                "to": second.profile.name,
                "largest_jump_mm": round(1e3 * max(jump_m), 4),
                "largest_jump_if_pressed_anew_mm": round(1e3 * max(anew_m), 4),
                "tried": len(spent_s) - 1,
                "refused": refused,
                "longest_ms": round(1e3 * max(spent_s), 1),
            }
        )
    return rows


def start_cost(name: str) -> dict[str, float]:
    """Return time and memory of making one profile, and of making all after it, with the tables on
    disk. Memory is that of the process, which must be a new one."""
    sensor = load_sensor(name)
    rungs = ladder_of(AUTO, sensor)
    made: list[tuple[float, float]] = [(time.monotonic(), _memory_mb())]
    live = TactileSensor(_with(sensor, rungs[0].solver), indenter=load_indenter("sphere_4mm"))
    live.step(Pose(np.array([0.0, 0.0, 1.0])), FRAME_S)
    made.append((time.monotonic(), _memory_mb()))
    for rung in rungs:
        live.prepare_solver(rung.solver)
    made.append((time.monotonic(), _memory_mb()))
    return {
        "one_s": round(made[1][0] - made[0][0], 2),
        "one_mb": round(made[1][1] - made[0][1]),
        "others_s": round(made[2][0] - made[1][0], 2),
        "others_mb": round(made[2][1] - made[1][1]),
    }


def _memory_mb() -> float:
    """Return the memory that this process holds."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def _with(sensor: SensorSpecification, solver: SolverSpecification) -> SensorSpecification:
    return replace(sensor, solver=solver)


def summary(cases: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the worst of all cases, by profile; of `time_ratio` the range."""
    found: dict[str, Any] = {}
    for name in PROFILES:
        rows = [case["profiles"][name] for case in cases]
        ratios = [row["time_ratio"] for row in rows]
        found[name] = {
            **{
                key: max(row[key] for row in rows)
                for key in ("skin_p99_mm", "skin_max_mm", "force_mean_percent", "force_max_percent")
            },
            "skin_p50_mm": max(row["skin_p50_mm"] for row in rows),
            "time_ratio": [min(ratios), max(ratios)],
            "documented_mm": round(1e3 * PROFILES[name].skin_error_m, 3),
        }
    return found


def profiles(
    *, sensors: tuple[str, ...] = SENSORS, indenters: tuple[str, ...] = INDENTERS
) -> dict[str, Any]:
    """Error and time of a frame under each profile of `tactile_sim`, against `exact`.

    Args:
        sensors: names or files.
        indenters: names or files.
    """
    cases: list[dict[str, Any]] = []
    deep: list[dict[str, Any]] = []
    start: dict[str, dict[str, float]] = {}
    for name in sensors:
        sensor = load_sensor(name)
        cases += [
            {**errors(sensor, indenter), "handovers": handovers(sensor, indenter)}
            for indenter in indenters
        ]
        deep.append(errors(sensor, DEEP_INDENTER, DEEP_SHARE))
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
            start[name] = process.submit(start_cost, name).result()
    worst = summary(cases)
    return {
        "cases": cases,
        "worst": worst,
        "deep": deep,
        "start": start,
        FAILED: [
            f"{name} is off by {row['skin_max_mm']} mm, documented are {row['documented_mm']} mm"
            for name, row in worst.items()
            if row["skin_max_mm"] > row["documented_mm"]
        ],
    }
