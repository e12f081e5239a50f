# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many gels in one state, `gel.batched`: their time for each gel and frame, and what it is worth.

Each gel is pressed by the same ball along an axis of its own, in frames of 0.25 mm to 2 mm, and
then slides. One implicit gel makes the motion of the first of them by turns, so that both meet
the same machine; its answers, solved closely, are what the batch's errors are measured against.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from dotsim_ros.gel.batched.gel import BatchedGel, Effort
from dotsim_ros.gel.make import make_gel_batch
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import load_sensor

SENSOR, INDENTER = "densetact2", "sphere_4mm"
FRAME_M = 0.25e-3
DEEPEST_M = 2.0e-3
SLIDE_M = 1.0e-3
TILT = 0.6
"""Largest slope of an axis."""
FRAME_S = 0.04
CLOSE_M = 1.0e-6
CLOSE_ITERATIONS = 40


def motion(number: int, radius_m: float) -> list[Pose]:
    """Return the frames of a gel by its number; the first one is in contact."""
    slopes = np.random.default_rng(number).uniform(-TILT, TILT, 2)
    axis = np.array([*slopes, 1.0]) / np.linalg.norm([*slopes, 1.0])
    half = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    turn = half / np.linalg.norm(half)
    down = [
        Pose((radius_m - depth) * axis, turn)
        for depth in np.arange(FRAME_M, DEEPEST_M + 1e-9, FRAME_M)
    ]
    aside = down[-1].rotation()[:, 1]
    slide = [
        Pose(down[-1].position_m + way * aside, turn)
        for way in np.arange(FRAME_M, SLIDE_M + 1e-9, FRAME_M)
    ]
    return [*down, *slide]


def batch(
    *,
    counts: tuple[int, ...] = (1, 16, 64),
    threads: int = 1,
    outer: int = Effort.outer,
    newton: int = Effort.newton,
) -> dict[str, Any]:
    """Time and error of many gels in one state.

    Args:
        counts: of gels.
        threads: of torch.
        outer: steps of a substep at most.
        newton: steps of each contact problem at most.
    """
    torch.set_num_threads(threads)
    sensor, ball = load_sensor(SENSOR), load_indenter(INDENTER)
    radius_m = sensor.gel.outer_radius_m
    single = make_gel_batch(sensor, indenter=ball, environment_count=1)
    close = replace(sensor.solver, tolerance_m=CLOSE_M, iterations=CLOSE_ITERATIONS)
    right = make_gel_batch(replace(sensor, solver=close), indenter=ball, environment_count=1)
    truth = [right.step([pose], FRAME_S)[0] for pose in motion(0, radius_m)]
    figures: dict[str, Any] = {"sensor": SENSOR, "indenter": INDENTER}
    figures["steps"] = [outer, newton]
    for count in counts:
        paths = [motion(number, radius_m) for number in range(count)]
        gel = BatchedGel(sensor, ball, count, effort=Effort(outer, newton))
        single.reset()
        spent_s, alone_s, skin_m, force = [], [], [], []
        for frame, poses in enumerate(zip(*paths, strict=True)):
            position_m = np.array([pose.position_m for pose in poses])
            quaternion = np.array([pose.quaternion_xyzw for pose in poses])
            begun_s = time.perf_counter()
            state = gel.step(position_m, quaternion)
            between_s = time.perf_counter()
            single.step([poses[0]], FRAME_S)
            alone_s.append(time.perf_counter() - between_s)
            spent_s.append((between_s - begun_s) / count)
            off_m = state.skin_position_m[0].numpy() - truth[frame].skin_position_m
            skin_m.append(np.linalg.norm(off_m, axis=1).max())
            force_n = truth[frame].wrench.force_n
            off_n = np.linalg.norm(state.force_n[0].numpy() - force_n)
            force.append(off_n / np.linalg.norm(force_n))
        # The first frame comes from the air in many short moves.
        figures[str(count)] = {
            "ms_per_gel": round(1e3 * float(np.mean(spent_s[1:])), 3),
            "gel_frames_per_second": round(1.0 / float(np.mean(spent_s[1:])), 1),
            "single_ms": round(1e3 * float(np.mean(alone_s[1:])), 2),
            "cost_ratio": round(float(np.sum(spent_s[1:]) / np.sum(alone_s[1:])), 3),
            "skin_max_um": round(1e6 * float(np.max(skin_m)), 1),
            "force_error": round(float(np.max(force)), 4),
        }
    return figures
