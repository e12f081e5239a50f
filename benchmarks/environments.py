# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Steps a second of the environment for learning, in one process and in one for each core.

python benchmarks/environments.py --json docs/results/environments.json

DenseTactBoxYaw-v0 with depth and normals at 64 x 64: the box is pressed face up against the dome in
every step, and turned by the move that goes around it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import dotsim_ros.tasks.environments  # noqa: F401
from dotsim_ros.cores import available_core_count
from dotsim_ros.files import write_json
from dotsim_ros.provenance import provenance

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
        worlds.reset(seed=list(range(count)))
        worlds.step(np.zeros(count, dtype=np.int64))
        begun_s = time.perf_counter()
        for _ in range(step_count):
            worlds.step(random.integers(0, 9, count))
        return count * step_count / (time.perf_counter() - begun_s)
    finally:
        worlds.close()


def main() -> None:
    """Measure, print, and write JSON where asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--steps", type=int, default=200, help="steps of each world (200)")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    cores = available_core_count()
    figures: dict[str, Any] = {"cores": cores, "steps": arguments.steps}
    for count in dict.fromkeys((1, cores, 2 * cores)):
        rate = steps_per_second(count, arguments.steps)
        figures[f"steps_per_second_{count}"] = round(rate, 1)
        print(f"{count} worlds: {rate:.1f} steps/s in sum", flush=True)
    if arguments.json is not None:
        write_json(arguments.json, {**provenance(), **figures})


if __name__ == "__main__":
    main()
