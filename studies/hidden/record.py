# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Data sets with hidden effects that finite elements (CalculiX) have solved.

Each set is a unit of the sensor, measured along eight trajectories (two holds, four presses, two
slides), with constants, mesh and noise of its own. In some nothing is wrong, and two constants are
nearly out of tolerance; in some one effect is hidden, in some two, in some one that the library
does not know. The effect is part of what CalculiX solves: none of our own gel takes part. OUT has
index.json, which says of each set which half it belongs to, and set_NN in the layout of measured
data, with the sealed truth.json. A trajectory is saved once it is solved, so that an interrupted
run resumes with the same command; one that CalculiX cannot finish is tried again with smaller
steps, then with larger elements, and then listed as failed.

OUT/commissioning is the unit as declared, on three meshes, to calibrate the twin with and to learn
what it is off by: what a model calls friction or stiffness is an effective constant, and that of
another solver's units is not that of another sensor's.

    python -m studies hide --count 32 --seed 7 --out out/hidden
    dotsim_ros calibrate --data out/hidden/commissioning --sensor sensor_a --hold-out 0 \\
        --out out/sensor_a.yaml
    python -m studies gap_discrepancy --data out/hidden/commissioning --sensor out/sensor_a.yaml \\
        --out out/discrepancy.npz
    python -m studies gap_physics --sets out/hidden --sensor out/sensor_a.yaml \\
        --discrepancy out/discrepancy.npz
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dotsim_ros.specification import load_sensor
from studies.hidden.solved_draw import COMMISSIONING
from studies.hidden.solved_sets import SeriesPlan, make_sets, read_series, size_bytes


def hide(
    *,
    count: int = 32,
    seed: int = 0,
    out: Path = Path("out/hidden"),
    sensor: str = "sensor_a",
    trajectories: tuple[str, ...] = (),
    retry: bool = False,
    coarseness: float = 1.0,
) -> dict[str, Any]:
    """Make data sets with hidden effects that CalculiX solves, for the gap finder.

    Args:
        count: sets.
        seed: of everything that is drawn.
        out: folder of the sets.
        sensor: name or file of what is declared.
        trajectories: which of each set (all).
        retry: whether trajectories that failed before are tried again.
        coarseness: factor on the size of elements, for a quick look.

    Raises:
        CalculixMissingError, OSError, ValueError: as `SeriesPlan` and `make_sets`.
    """
    plan = SeriesPlan(load_sensor(sensor), count, seed, trajectories, coarseness)
    make_sets(out, plan, print, failed_again=retry)
    index, records = read_series(out)
    made = {record.name: record.made for record in records}
    failures = {record.name: record.failures for record in records}
    if COMMISSIONING in index:
        made[COMMISSIONING] = tuple(index[COMMISSIONING]["made"])
        failures[COMMISSIONING] = index[COMMISSIONING]["failures"]
    return {
        "sets": len(records),
        "trajectories": sum(map(len, made.values())),
        "megabytes": round(1e-6 * size_bytes(out), 1),
        "failed": {
            f"{name}/{trajectory}": reason
            for name, of_set in failures.items()
            for trajectory, reason in of_set.items()
        },
    }
