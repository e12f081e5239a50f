# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How long `dotsim_ros find-gap` takes from nothing, and how right the time left is that it prints.

Runs the command as a user does, on one set after the other, each with an empty folder and an empty
cache of solves; the kernels are compiled before. Every line of progress is timed as it arrives.
What a step says to be left is compared with how long it went on, where at least `JUDGED_S` were
left: below that a rounded second decides.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.gap.findings import Verdict
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.io.warp_runtime import wp
from studies.run import expect_positive

JUDGED_S = 5.0
WITHIN = 1.0 / 3.0
SETS = tuple(Path(f"data/hidden_23/set_{number:02d}") for number in (0, 3, 10, 12))
ANSWERED = {verdict.exit_status for verdict in Verdict if verdict is not Verdict.UNUSABLE}


def steps_of(told: list[tuple[float, str]]) -> list[dict[str, Any]]:
    """Return each step's duration in seconds, and what it said to be left against what was.

    Args:
        told: lines of progress, each behind the time in seconds at which it came.
    """
    steps: list[dict[str, Any]] = []
    before = ""
    for at_s, line in told:
        found = re.match(r"(?P<name>[a-z ]+): (?P<done>\d+)/(\d+)(, (?P<left>\d+) s left)?$", line)
        if found is None:
            continue
        # A step that is run twice counts from its first line again.
        if found["name"] != before or int(found["done"]) <= steps[-1]["done"]:
            steps.append({"name": found["name"], "from_s": at_s, "told": []})
        before = found["name"]
        steps[-1]["done"], steps[-1]["to_s"] = int(found["done"]), at_s
        if found["left"] is not None:
            steps[-1]["told"].append((at_s, float(found["left"])))
    for step in steps:
        left = [(said_s, step["to_s"] - at_s) for at_s, said_s in step.pop("told")]
        step["said_and_left_s"] = [pair for pair in left if pair[1] >= JUDGED_S]
    return steps


def cold_run(measured: Path, options: list[str], kernels: Path) -> dict[str, Any]:
    """Return how long the command took on one set, and its steps.

    Raises:
        RuntimeError: the command had no answer.
    """
    with tempfile.TemporaryDirectory() as folder:
        caches = {"XDG_CACHE_HOME": f"{folder}/cache", "WARP_CACHE_PATH": str(kernels)}
        command = [sys.executable, "-m", "dotsim_ros.cli.main", "find-gap", *options]
        command += ["--measured", str(measured), "--out", f"{folder}/out"]
        begun_s = time.monotonic()
        process = subprocess.Popen(
            command,
            env={**os.environ, **caches},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert process.stdout is not None
        told = [(time.monotonic() - begun_s, line.rstrip()) for line in process.stdout]
        status = process.wait()
        took_s = time.monotonic() - begun_s
    if status not in ANSWERED:
        raise RuntimeError("\n".join([f"{measured}: exit status {status}", *(t for _, t in told)]))
    return {"set": measured.name, "exit_status": status, "wall_s": took_s, "steps": steps_of(told)}


def find_gap(
    *,
    measured: tuple[Path, ...] = SETS,
    sensor: str = "data/hidden_17/sensor_a.yaml",
    discrepancy: Path | None = Path("data/hidden_17/discrepancy.npz"),
    workers: int = 2,
) -> dict[str, Any]:
    """How long `dotsim_ros find-gap` takes from nothing, and how right its time left is.

    Args:
        measured: data sets.
        sensor: name or file of the twin.
        discrepancy: see `dotsim_ros find-gap --help`.
        workers: processes.
    """
    expect_positive(workers=workers, sets=len(measured))
    options = ["--sensor", sensor, "--workers", str(workers)]
    if discrepancy is not None:
        options += ["--discrepancy", str(discrepancy)]
    wp.init()
    assert wp.config.kernel_cache_dir is not None
    # Warp adds its version to the folder that it is given.
    kernels = Path(wp.config.kernel_cache_dir).parent
    progress, runs = PrintedProgress(), []
    for number, each in enumerate(measured):
        progress("searches", number, len(measured))
        runs.append(cold_run(each, options, kernels))
    shares = np.array(
        [
            said_s / left_s
            for run in runs
            for step in run["steps"]
            for said_s, left_s in step["said_and_left_s"]
        ]
    )
    is_right = np.abs(shares - 1.0) <= WITHIN
    return {
        "workers": workers,
        "runs": runs,
        "times_left": {"told": len(shares), "within_a_third": int(is_right.sum())},
    }
