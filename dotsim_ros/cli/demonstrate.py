# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Make demonstrations of path following by touch, for train-policy.

An expert that knows where the indenter is moves the simulated sensor against a ball along the
paths, with errors injected, and between them. Each motion is seen by several cameras, lights and
coats drawn at random. OUT gets one episode a file and demonstrations.json; an interrupted run
resumes where it stopped. One core makes about 15 frames a second, each seen by all looks.

example:
  dotsim_ros demonstrate --sensor densetact2 --out out/demonstrations
  dotsim_ros demonstrate --paths line press --episodes 4 --frames 100 --out out/few
  dotsim_ros demonstrate --policy out/policy --wander 0 --episodes 12 --seed 1 --out out/driven
"""

from __future__ import annotations

import time
from pathlib import Path

from dotsim_ros.cli._options import HERE, Whole, WorkerOptions, say


def run(
    *,
    sensor: str = "densetact2",
    indenter: str = "sphere_4mm",
    paths: tuple[str, ...] = (),
    episodes: Whole = 24,
    frames: Whole = 250,
    looks: Whole = 2,
    wander: float = 0.5,
    policy: Path | None = None,
    seed: Whole = 0,
    workers: WorkerOptions = HERE,
    out: Path = Path("out/demonstrations"),
    json: Path | None = None,
) -> int:
    """Make the demonstrations.

    Args:
        sensor: the sensor's file, or its name.
        indenter: a ball's name or definition.
        paths: line, arc, figure_eight, press; without it all.
        episodes: motions.
        frames: of each motion, at 25 Hz.
        looks: cameras that see each motion.
        wander: share of motions off the paths.
        policy: folder of the policy that drives in the expert's place.
        seed: of all draws.
        out: folder to write.
        json: write what was made to this file as well.
    """
    from dotsim_ros.control.policy.demonstration import Plan, demonstrate, read_card
    from dotsim_ros.control.policy.paths import PATHS, reference_path
    from dotsim_ros.geometry.indenter import load_indenter
    from dotsim_ros.io.files import write_json
    from dotsim_ros.specification import load_sensor

    paths = paths or PATHS
    for name in paths:
        reference_path(name)
    specification = load_sensor(sensor)
    plan = Plan(
        sensor=specification.name,
        paths=paths,
        episode_count=episodes,
        frame_count=frames,
        look_count=looks,
        wander_share=wander,
        seed=seed,
        policy="" if policy is None else str(policy),
    )
    begun_s = time.monotonic()

    def show(done: int, count: int) -> None:
        spent_s = time.monotonic() - begun_s
        left_min = spent_s * (count - done) / done / 60.0
        say(f"episode {done}/{count}  {left_min:.1f} min left")

    made = demonstrate(
        specification,
        load_indenter(indenter),
        plan,
        out,
        progress=show,
        workers=workers.crew(),
    )
    if json is not None:
        write_json(json, {"frames": made, **read_card(out)})
    print(f"{plan.episode_count} episodes, {made} images of {', '.join(paths)} in {out}")
    return 0
