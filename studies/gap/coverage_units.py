# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether the calibration's 95 % intervals hold the constants of units that another solver made.

    python benchmarks/coverage_units.py --sets data/hidden_17 --json FILE

Each set in which nothing is missing is one unit with constants of its own, eight trajectories that
CalculiX solved, and noise. It is calibrated as `dotsim_ros calibrate --hold-out 0` does, from the
sensor as its maker states it; its truth is read after the fit. Young's modulus is compared as the
unit's gauge shows it: times the gauge's gain, from which no calibration can tell it. Beside the
intervals of the effective constants stand those of the material's own, which hold what the model is
off by (`dotsim_ros.calibration.parameters`). That was learnt from the half for development; the
other half judges it.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

from dotsim_ros.calibration.calibrate import calibrate
from dotsim_ros.calibration.report import figures
from dotsim_ros.files import write_json
from dotsim_ros.measured.data_set import INDEX, SKIN_MESH
from dotsim_ros.provenance import provenance
from studies.gap.rates import rate
from studies.gap.solved_score import opened_truth
from studies.hidden.solved_draw import COMMISSIONING, HALVES, NULL
from studies.hidden.solved_sets import SetRecord, read_series

SEED = 0
COMBINATIONS = ("joint", "median")
KINDS = (*COMBINATIONS, "material")


def main() -> None:
    """Calibrate the units and print a line for each constant."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sets", type=Path, required=True, help="folder of a series of sets")
    parser.add_argument("--sensor", default="densetact2", help="before the fit")
    parser.add_argument("--half", choices=HALVES, help="of the sets; both if left out")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    _, records = read_series(arguments.sets)
    # The kind alone says which sets are units without an effect; no constant is read before a fit.
    nulls = [
        r
        for r in records
        if arguments.half in (None, r.half) and opened_truth(arguments.sets, r)["kind"] == NULL
    ]
    rows = [row for record in nulls for row in _rows(record, arguments)]
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
    for half, by_name in shares.items():
        for name, by_kind in by_name.items():
            covered = (f"{kind}: {found['share']:.0%}" for kind, found in by_kind.items())
            print(half, name, *covered)
    if arguments.json is not None:
        write_json(
            arguments.json,
            {"units": len(nulls), "coverage": shares, "rows": rows, "provenance": provenance()},
        )


def _rows(record: SetRecord, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as temporary:
        data = Path(temporary)
        for name in ("bags", INDEX, SKIN_MESH):
            (data / name).symlink_to((arguments.sets / record.name / name).resolve())
        # The series keeps the meshes once.
        (data / "indenters").symlink_to((arguments.sets / COMMISSIONING / "indenters").resolve())
        calibration = calibrate(
            data, sensor=arguments.sensor, hold_out=0, workers=arguments.workers, seed=SEED
        )
    found = figures(calibration, seed=SEED)["parameters"]
    unit = opened_truth(arguments.sets, record)["unit"]
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
        joint = row["joint"]
        print(
            f"{record.name} {name}: true {value:.4g}, found {joint['value']:.4g} "
            f"[{joint['low']:.4g}, {joint['high']:.4g}]",
            flush=True,
        )
    return rows


if __name__ == "__main__":
    main()
