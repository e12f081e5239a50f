# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The environment for learning, timed.

DenseTactBoxYaw-v0 with depth and normals at 64 x 64: the box is pressed face up against the dome in
every step, and turned by the move that goes around it.
"""

from __future__ import annotations

import time
from typing import Any

import gymnasium
import numpy as np

import dotsim_ros.control.environments  # noqa: F401
from dotsim_ros.io.cores import available_core_count
from studies.run import expect_positive

NAME = "DenseTactBoxYaw-v0"


def steps_per_second(count: int, step_count: int) -> float:
    """Return the steps of all worlds together, in a second."""
    worlds = gymnasium.make_vec(
        NAME,
        num_envs=count,
        vectorization_mode="async" if count > 1 else "sync",
        observation="depth",
        image_size_px=(64, 64),
    )
    random = np.random.default_rng(0)
    try:
        # Gymnasium gives world k this seed plus k.
        worlds.reset(seed=0)
        worlds.step(np.zeros(count, dtype=np.int64))
        begun_s = time.perf_counter()
        for _ in range(step_count):
            worlds.step(random.integers(0, 9, count))
        return count * step_count / (time.perf_counter() - begun_s)
    finally:
        worlds.close()


def environments(*, steps: int = 200) -> dict[str, Any]:
    """Steps a second of the environment for learning, in one process and in one for each core.

    Args:
        steps: of each world.
    """
    expect_positive(steps=steps)
    cores = available_core_count()
    figures: dict[str, Any] = {"cores": cores, "steps": steps}
    for count in dict.fromkeys((1, cores, 2 * cores)):
        figures[f"steps_per_second_{count}"] = round(steps_per_second(count, steps), 1)
    return figures
