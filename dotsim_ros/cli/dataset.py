# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Make simulated touches by the thousand, to learn from.

Indenters press, hold, slide, twist, roll on a sensor, or two sensors grasp an object; ranges of a
plan say what differs from touch to touch. OUT gets a LeRobotDataset v3.0, archives of WebDataset or
bags, and contact_sheet.jpg to look at. An interrupted run resumes where it stopped; the data depend
on plan and seed alone. docs/learners.md has the plan and the keys.

example:
  dotsim_ros dataset
  dotsim_ros dataset --sensor digit --indenters my_stl_files --touches 1000 --out out/digit
  dotsim_ros dataset --plan my_plan.yaml --format webdataset --ray-address auto --workers 64
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from dotsim_ros.cli._options import Whole, WorkerOptions, show_stage
from dotsim_ros.io.cores import available_core_count

ALL_CORES = WorkerOptions(available_core_count())


def run(
    *,
    plan: Path | None = None,
    sensor: str | None = None,
    indenters: tuple[str, ...] = (),
    kinds: tuple[str, ...] = (),
    touches: Whole = 200,
    format: Literal["lerobot", "webdataset", "bags"] = "lerobot",
    seed: Whole = 0,
    workers: WorkerOptions = ALL_CORES,
    out: Path = Path("out/touches"),
    json: Path | None = None,
) -> int:
    """Make the touches.

    Args:
        plan: YAML file with the ranges; without it params/touches/default.yaml.
        sensor: a sensor's file or name, in place of the plan's.
        indenters: names, definitions or files, or folders of files, in place of the plan's.
        kinds: press, hold, slide, twist, roll, or grasp alone; in place of the plan's.
        touches: how many.
        format: of what is written.
        seed: of all draws.
        out: folder to write.
        json: write what was made to this file as well.
    """
    from dataclasses import asdict

    from dotsim_ros.io.files import write_json
    from dotsim_ros.learning.touches.plan import read_plan
    from dotsim_ros.learning.touches.run import make_touches

    made = make_touches(
        read_plan(plan, sensor=sensor, indenters=indenters, touches=kinds),
        out,
        count=touches,
        seed=seed,
        kind=format,
        workers=workers.crew(),
        progress=show_stage,
    )
    if json is not None:
        write_json(json, asdict(made) | {"sheet": str(made.sheet)})
    print(f"{made.touches} touches in {out}; look at {made.sheet}")
    return 0
