# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Write a published recording on a real gel as a data set.

densetact: 241 presses on two DenseTact gels, poses alone. ecoflex_compression: cylinders of
Ecoflex between plates, to 67 %. gelsight_mini_force: the force of a GelSight Mini under a ball at
a few depths. The folder is read as it was published, and refused with a reason where units, columns
or the order of its rows are not what they should be. docs/real_data.md says where each comes from.

example:
  dotsim_ros import-data gelsight_mini_force --from real/gelsight_mini_force --out measured/mini
"""

from __future__ import annotations

import argparse
from pathlib import Path

SETS = ("densetact", "ecoflex_compression", "gelsight_mini_force")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    parser.add_argument("name", choices=SETS, metavar="NAME", help=", ".join(SETS))
    parser.add_argument(
        "--from", dest="source", type=Path, required=True, metavar="DIR", help="folder as published"
    )
    parser.add_argument(
        "--out", type=Path, required=True, help="folder of the data set, which must not exist"
    )
    parser.add_argument("--seed", type=int, default=0, help="accepted; nothing here is random")


def run(arguments: argparse.Namespace) -> int:
    """Write the data set, and say what it holds."""
    from dotsim_ros.data.importers.registry import IMPORTERS

    made = IMPORTERS[arguments.name](arguments.source, arguments.out)
    frames = sum(entry.frame_count for entry in made.entries)
    print(f"{made.directory}: {len(made.entries)} trajectories, {frames} frames")
    return 0
