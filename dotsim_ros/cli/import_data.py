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

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from dotsim_ros.cli._options import NoSeed

Set = Literal["densetact", "ecoflex_compression", "gelsight_mini_force"]


def run(
    name: Set, /, *, source: Annotated[Path, Parameter(name="--from")], out: Path, seed: NoSeed = 0
) -> int:
    """Write the data set, and say what it holds.

    Args:
        name: of the recording.
        source: folder as published.
        out: folder of the data set, which must not exist.
    """
    from dotsim_ros.data.importers.registry import IMPORTERS

    made = IMPORTERS[name](source, out)
    frames = sum(entry.frame_count for entry in made.entries)
    print(f"{made.directory}: {len(made.entries)} trajectories, {frames} frames")
    return 0
