# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Show which effects a set of protocols can distinguish, before anyone measures.

Takes the poses of a data set (no force or skin needed), simulates the twin with each effect along
them, and prints the isolability matrix: cosines of pairs of signatures once the nuisances are
projected out; how large each effect must be to be found; the pairs that are too alike, and what to
add. The poses can be of a trial run in the air, or be written by `indenter_player`.

example:
  dotsim_ros plan-gap --protocols measured/planned --sensor sensor_a --json plan.json
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from dotsim_ros.cli._options import HERE, Meshes, Whole, WorkerOptions


def run(
    *,
    protocols: Path,
    out: Path = Path("plan"),
    sensor: str = "sensor_a",
    indenters: Meshes = None,
    effects: tuple[Path, ...] = (),
    channels: tuple[Literal["skin", "force"], ...] = ("skin", "force"),
    seed: Whole = 0,
    workers: WorkerOptions = HERE,
    json: Path | None = None,
) -> int:
    """Simulate, and print the matrix.

    Args:
        protocols: data set whose poses are the protocols.
        out: folder of the solves.
        sensor: name or YAML file of the calibrated twin.
        effects: folders of your own effects: every NAME.py there is run as a program; they are
            listed before.
        channels: used.
        seed: of the draws.
        json: write the figures here.
    """
    from dotsim_ros.gap.plan import plan, plan_lines
    from dotsim_ros.gap.presses.search_state import GapRequest
    from dotsim_ros.io.files import write_json
    from dotsim_ros.specification import load_sensor

    request = GapRequest(
        measured=protocols,
        sensor=load_sensor(sensor),
        directory=out / "run",
        indenters=indenters,
        effects=effects,
        channels=channels,
        seed=seed,
        workers=workers.crew(),
    )
    planned = plan(request)
    for line in plan_lines(planned):
        print(line)
    if json is not None:
        write_json(json, planned)
    return 0
