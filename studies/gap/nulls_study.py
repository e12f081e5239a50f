# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How often the whole search gives a name to presses in which nothing is missing.

Each case is a data set of eight trajectories of an independent solver, read, calibrated, screened
and refitted as any other. All that the search knows of presses without an effect comes from the
half of the trajectories that the case was not drawn from. Cases share presses.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dotsim_ros.data.data_set import INDEX, read_data_set
from dotsim_ros.gap.presses.covariance import save_discrepancy
from dotsim_ros.gap.presses.search import read_measurements, search_presses
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.io.files import cache_directory
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.specification import load_sensor
from studies.data import SENSOR_A
from studies.gap.discrepancy import calibrated_discrepancy
from studies.gap.presses import CASE_SIZE, Source, halves, silent
from studies.run import expect_positive


def gap_nulls(
    *,
    data: Path = SENSOR_A,
    sensor: str = "sensor_a",
    count: int = 12,
    run: Path | None = None,
    workers: int = 1,
) -> dict[str, Any]:
    """How often the whole search gives a name to presses in which nothing is missing.

    Args:
        data: a data set without any effect.
        sensor: calibrated to it.
        count: of the cases.
        run: folder of the solves; the user's cache where none is given.
        workers: processes.
    """
    expect_positive(count=count, workers=workers)
    source = Source(data, load_sensor(sensor), run or cache_directory() / "gap", workers, silent)
    progress, cases = PrintedProgress(), []
    for seed in range(count):
        progress("searches", seed, count)
        cases.append(_searched(source, seed))
    return {
        "false_names": sum(bool(case["named"]) for case in cases),
        "of": len(cases),
        "cases": cases,
    }


def _searched(source: Source, seed: int) -> dict[str, Any]:
    """Return what the search makes of a draw of trajectories, knowing half of the others."""
    known, tested = halves([entry.name for entry in read_data_set(source.directory).entries], seed)
    discrepancy = calibrated_discrepancy(source, known, seed)
    random = np.random.default_rng([seed, 5])
    drawn = sorted(random.choice(tested, CASE_SIZE, replace=False).tolist())
    with tempfile.TemporaryDirectory() as folder:
        measured, covariance = Path(folder) / "data", Path(folder) / "discrepancy.npz"
        _link(source.directory.resolve(), measured, drawn)
        save_discrepancy(discrepancy, covariance)
        begun_s = time.monotonic()
        request = GapRequest(
            measured=measured,
            sensor=source.sensor,
            directory=source.run,
            seed=seed,
            workers=source.workers,
            discrepancy=covariance,
        )
        findings, _ = search_presses(request, *read_measurements(request), silent)
    return {
        "seed": seed,
        "trajectories": drawn,
        "verdict": findings.verdict.value,
        "named": list(findings.named),
        "gain": round(findings.statistic, 1),
        "limit": round(findings.threshold, 1),
        "seconds": round(time.monotonic() - begun_s, 1),
    }


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
