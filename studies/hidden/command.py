# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Make data sets with hidden effects that finite elements (CalculiX) have solved.

Each set is a unit of the sensor, measured along eight trajectories (two holds, four presses, two
slides), with constants, mesh and noise of its own. In some nothing is wrong, and two constants are
nearly out of tolerance; in some one effect is hidden, in some two, in some one that the library
does not know. The effect is part of what CalculiX solves: none of our own gel takes part. Writes
OUT/index.json, which says of each set which half it belongs to, and OUT/set_NN in the layout of
measured data, with the sealed truth.json. A trajectory is saved once it is solved, so that an
interrupted run resumes with the same command; one that CalculiX cannot finish is tried again with
smaller steps, then with larger elements, and then listed as failed (--retry). Uses one core.
Needs CalculiX: apt-get install calculix-ccx

OUT/commissioning is the unit as declared, on three meshes, to calibrate the twin with and to learn
what it is off by: what a model calls friction or stiffness is an effective constant, and that of
another solver's units is not that of another sensor's.

exit status: 0 all trajectories made, 1 some failed

example:
  dotsim_ros hide --count 32 --seed 7 --out out/hidden
  dotsim_ros calibrate --data out/hidden/commissioning --sensor sensor_a --hold-out 0 \\
      --out sensor_a.yaml
  dotsim_ros evaluate gap --data out/hidden/commissioning --sensor sensor_a.yaml \\
      --fit-discrepancy discrepancy.npz
  dotsim_ros evaluate gap --sets out/hidden --sensor sensor_a.yaml \\
      --discrepancy discrepancy.npz --out docs/results
"""

from __future__ import annotations

import argparse
from pathlib import Path


def _whole(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} is not 0 or a positive number")
    return value


def _count(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"{text} is not a number from 1 to 1000")
    return value


def _coarseness(text: str) -> float:
    value = float(text)
    if not 1.0 <= value <= 2.0:
        raise argparse.ArgumentTypeError(f"{text} is not a number from 1 to 2")
    return value


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--count", type=_count, default=32, help="sets (32)")
    add("--seed", type=_whole, default=0, help="of everything that is drawn (0)")
    add("--out", type=Path, default=Path("out/hidden"), help="folder of the sets (out/hidden)")
    add("--sensor", default="sensor_a", help="name or YAML file of what is declared (sensor_a)")
    add("--trajectories", nargs="+", default=[], metavar="NAME", help="which of each set (all)")
    add("--retry", action="store_true", help="try trajectories that failed before again")
    add("--coarseness", type=_coarseness, default=1.0, help="larger elements, for a quick look (1)")


def run(arguments: argparse.Namespace) -> int:
    """Make the sets; 1 where a trajectory failed."""
    from dotsim_ros.specification import load_sensor
    from studies.hidden.solved_sets import (
        SeriesPlan,
        make_sets,
        read_series,
        size_bytes,
    )

    plan = SeriesPlan(
        load_sensor(arguments.sensor),
        arguments.count,
        arguments.seed,
        tuple(arguments.trajectories),
        arguments.coarseness,
    )
    make_sets(
        arguments.out,
        plan,
        lambda text: print(text, flush=True),
        failed_again=arguments.retry,
    )
    index, records = read_series(arguments.out)
    commissioning = index.get("commissioning") or {"made": (), "failures": ()}
    made = sum(len(record.made) for record in records) + len(commissioning["made"])
    failed = sum(len(record.failures) for record in records) + len(commissioning["failures"])
    megabytes = 1e-6 * size_bytes(arguments.out)
    print(f"{len(records)} sets, {made} trajectories, {failed} failed, {megabytes:.1f} MB")
    return 1 if failed else 0
