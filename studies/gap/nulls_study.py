# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How often the whole search gives a name to presses in which nothing is missing.

    python benchmarks/gap_nulls.py --data DIR --sensor NAME --json docs/results/gap_nulls.json

Each case is a data set of eight trajectories of an independent solver, read, calibrated, screened
and refitted as any other. All that the search knows of presses without an effect comes from the
half of the trajectories that the case was not drawn from. Cases share presses.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dotsim_ros.files import cache_directory, write_json
from dotsim_ros.gap.presses.covariance import save_discrepancy
from dotsim_ros.gap.presses.search import search_presses
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.measured.data_set import INDEX, read_data_set
from dotsim_ros.provenance import provenance
from dotsim_ros.specification import load_sensor
from studies.gap.discrepancy import calibrated_discrepancy
from studies.gap.presses import CASE_SIZE, Source, halves, silent


def main() -> None:
    """Search the cases and print a line for each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="a data set without any effect")
    parser.add_argument("--sensor", default="sensor_a", help="calibrated to it")
    parser.add_argument("--count", type=int, default=12, help="cases")
    parser.add_argument("--run", type=Path, help="folder of the solves (the user's cache)")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    run = arguments.run or cache_directory() / "gap"
    sensor = load_sensor(arguments.sensor)
    source = Source(arguments.data, sensor, run, arguments.workers, silent)
    names = [entry.name for entry in read_data_set(arguments.data).entries]
    # Before a file is written: a tracked one that has changed would count as a changed tree.
    origin, false = provenance(), 0
    cases: list[dict[str, Any]] = []
    for seed in range(arguments.count):
        known, tested = halves(names, seed)
        discrepancy = calibrated_discrepancy(source, known, seed)
        random = np.random.default_rng([seed, 5])
        drawn = sorted(random.choice(tested, CASE_SIZE, replace=False).tolist())
        with tempfile.TemporaryDirectory() as folder:
            data, covariance = Path(folder) / "data", Path(folder) / "discrepancy.npz"
            _link(arguments.data.resolve(), data, drawn)
            save_discrepancy(discrepancy, covariance)
            begun_s = time.monotonic()
            findings, _ = search_presses(
                GapRequest(
                    measured=data,
                    sensor=sensor,
                    directory=run,
                    seed=seed,
                    workers=arguments.workers,
                    discrepancy=covariance,
                ),
                silent,
            )
        cases.append(
            {
                "seed": seed,
                "trajectories": drawn,
                "verdict": findings.verdict.value,
                "named": list(findings.named),
                "gain": round(findings.statistic, 1),
                "limit": round(findings.threshold, 1),
                "seconds": round(time.monotonic() - begun_s, 1),
            }
        )
        shown = cases[-1]
        print(
            f"{seed}: {shown['verdict']} {' '.join(shown['named'])} "
            f"({shown['gain']} of {shown['limit']}, {shown['seconds']} s)",
            flush=True,
        )
        # After each: one takes minutes, and those before it stand if it is broken off.
        false = sum(bool(case["named"]) for case in cases)
        if arguments.json is not None:
            figures = {"false_names": false, "of": len(cases), "cases": cases}
            write_json(arguments.json, {**figures, "provenance": origin})
    print(f"false names: {false} of {len(cases)}")


def _link(source: Path, target: Path, names: list[str]) -> None:
    """Make a data set of some trajectories of another one."""
    target.mkdir()
    index = yaml.safe_load((source / INDEX).read_text(encoding="utf-8"))
    index["trajectories"] = [
        {**entry, "bag": str(source / entry["bag"])}
        for entry in index["trajectories"]
        if Path(entry["bag"]).name in names
    ]
    (target / INDEX).write_text(yaml.safe_dump(index), encoding="utf-8")
    shutil.copy(source / "skin_mesh.npz", target)
    (target / "indenters").symlink_to(source / "indenters")


if __name__ == "__main__":
    main()
