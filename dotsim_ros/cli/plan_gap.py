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

import argparse
from pathlib import Path

from dotsim_ros.cli._workers import add_worker_arguments, crew_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--protocols", type=Path, required=True, help="data set whose poses are the protocols")
    add("--out", type=Path, default=Path("plan"), help="folder of the solves (plan)")
    add("--sensor", default="sensor_a", help="name or YAML file of the calibrated twin (sensor_a)")
    add(
        "--indenters",
        type=Path,
        metavar="DIR",
        help="folder of the indenters' meshes (in the data set, then next to it)",
    )
    add(
        "--effects",
        type=Path,
        nargs="+",
        default=[],
        metavar="DIR",
        help="folders of your own effects: every NAME.py there is run as a program; they are "
        "listed before",
    )
    add(
        "--channels",
        nargs="+",
        choices=("skin", "force"),
        default=["skin", "force"],
        help="used (all)",
    )
    add("--seed", type=int, default=0, help="seed of the draws (0)")
    add_worker_arguments(parser)
    add("--json", type=Path, help="write the figures here")


def run(arguments: argparse.Namespace) -> int:
    """Simulate, and print the matrix."""
    from dotsim_ros.gap.plan import plan, plan_lines
    from dotsim_ros.gap.presses.search_state import GapRequest
    from dotsim_ros.io.files import write_json
    from dotsim_ros.specification import load_sensor

    request = GapRequest(
        measured=arguments.protocols,
        sensor=load_sensor(arguments.sensor),
        directory=arguments.out / "run",
        indenters=arguments.indenters,
        effects=tuple(arguments.effects),
        channels=tuple(arguments.channels),
        seed=arguments.seed,
        workers=crew_of(arguments),
    )
    planned = plan(request)
    for line in plan_lines(planned):
        print(line)
    if arguments.json is not None:
        write_json(arguments.json, planned)
    return 0
