# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether the calibration's 95 % intervals hold the constants of units that another solver made.

Each set in which nothing is missing is one unit with constants of its own, eight trajectories that
CalculiX solved, and noise. It is calibrated as `dotsim_ros calibrate --hold-out 0` does, from the
sensor as its maker states it; its truth is read after the fit. Young's modulus is compared as the
unit's gauge shows it: times the gauge's gain, from which no calibration can separate it. Next to
the intervals of the effective constants stand those of the material's own, which hold what the
model is off by (`dotsim_ros.calibration.parameters`). That was learnt from the half for
development; the other half judges it.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from dotsim_ros.calibration.calibrate import calibrate
from dotsim_ros.calibration.report import figures
from dotsim_ros.data.data_set import INDEX, SKIN_MESH
from dotsim_ros.io.progress import PrintedProgress
from studies.gap.rates import rate
from studies.gap.solved_score import opened_truth
from studies.hidden.solved_draw import COMMISSIONING, HALVES, NULL
from studies.hidden.solved_sets import SetRecord, read_series
from studies.run import expect_known, expect_positive

SEED = 0
COMBINATIONS = ("joint", "median")
KINDS = (*COMBINATIONS, "material")


def coverage_units(
    *,
    sets: Path = Path("data/hidden_17"),
    sensor: str = "densetact2",
    half: str | None = None,
    workers: int = 1,
) -> dict[str, Any]:
    """Whether the calibration's intervals hold the constants of units that another solver made.

    Args:
        sets: folder of a series of sets.
        sensor: before the fit.
        half: of the sets, development or opened; both where none is given.
        workers: processes.
    """
    expect_positive(workers=workers)
    expect_known("half", HALVES if half is None else [half], HALVES)
    _, records = read_series(sets)
    # The kind alone says which sets are units without an effect; no constant is read before a fit.
    nulls = [
        record
        for record in records
        if half in (None, record.half) and opened_truth(sets, record)["kind"] == NULL
    ]
    progress, rows = PrintedProgress(), []
    for number, record in enumerate(nulls):
        progress("units", number, len(nulls))
        rows += _rows(sets, record, sensor, workers)
    names = list(dict.fromkeys(row["parameter"] for row in rows))
    halves = list(dict.fromkeys(row["half"] for row in rows))
    shares = {
        half: {
            name: {
                kind: rate(
                    [
                        row[kind]["covers"]
                        for row in rows
                        if (row["half"], row["parameter"]) == (half, name)
                    ]
                )
                for kind in KINDS
            }
            for name in names
        }
        for half in halves
    }
    return {"units": len(nulls), "coverage": shares, "rows": rows}


def _rows(sets: Path, record: SetRecord, sensor: str, workers: int) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as temporary:
        data = Path(temporary)
        for name in ("bags", INDEX, SKIN_MESH):
            (data / name).symlink_to((sets / record.name / name).resolve())
        # The series keeps the meshes once.
        (data / "indenters").symlink_to((sets / COMMISSIONING / "indenters").resolve())
        calibration = calibrate(data, sensor=sensor, hold_out=0, workers=workers, seed=SEED)
    found = figures(calibration, seed=SEED)["parameters"]
    unit = opened_truth(sets, record)["unit"]
    true = {
        "E": unit["youngs_modulus_pa"] * unit["force_gain"],
        "nu": unit["poisson_ratio"],
        "friction": unit["friction"],
    }
    rows = []
    for name, value in true.items():
        if name not in found:
            continue
        row: dict[str, Any] = {
            "set": record.name,
            "half": record.half,
            "parameter": name,
            "true": value,
        }
        intervals = {k: (found[name][k]["low"], found[name][k]["high"]) for k in COMBINATIONS}
        intervals["material"] = tuple(found[name]["joint"]["material"])
        for kind, (low, high) in intervals.items():
            estimate = found[name]["joint" if kind == "material" else kind]["value"]
            row[kind] = {
                "value": estimate,
                "low": low,
                "high": high,
                "covers": bool(low <= value <= high),
            }
        rows.append(row)
    return rows
