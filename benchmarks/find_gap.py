# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How long `dotsim_ros find-gap` takes from nothing, and how well it says how long it will take.

python benchmarks/find_gap.py --measured data/hidden_23/set_03 data/hidden_23/set_10 \
    --sensor data/hidden_17/sensor_a.yaml --discrepancy data/hidden_17/discrepancy.npz --json FILE

Runs the command as a user does, on one set after the other, each with an empty folder and an empty
cache of solves; the kernels are compiled before. Every line of progress is timed as it arrives.
What a step says to be left is compared with how long it went on, where at least `JUDGED_S` were
left: below that a rounded second decides.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.files import write_json
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.provenance import provenance
from dotsim_ros.warp_runtime import wp

GOAL_S = 300.0
JUDGED_S = 5.0
WITHIN = 1.0 / 3.0
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


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--measured", type=Path, nargs="+", required=True, help="data sets")
    parser.add_argument("--sensor", default="sensor_a", help="name or file of the twin (sensor_a)")
    parser.add_argument("--discrepancy", type=Path, help="see find-gap")
    parser.add_argument("--workers", type=int, default=2, help="processes (2)")
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parser.parse_args()
    options = ["--sensor", arguments.sensor, "--workers", str(arguments.workers)]
    if arguments.discrepancy is not None:
        options += ["--discrepancy", str(arguments.discrepancy)]
    made_by = provenance()
    wp.init()
    assert wp.config.kernel_cache_dir is not None
    runs = []
    for measured in arguments.measured:
        # Warp adds its version to the folder that it is given.
        run = cold_run(measured, options, Path(wp.config.kernel_cache_dir).parent)
        runs.append(run)
        parts = ", ".join(f"{s['name']} {s['to_s'] - s['from_s']:.0f}" for s in run["steps"])
        print(f"{run['set']}: {run['wall_s']:.0f} s (goal {GOAL_S:.0f}); {parts}", flush=True)
    pairs = np.array(
        [pair for run in runs for step in run["steps"] for pair in step["said_and_left_s"]]
    ).reshape(-1, 2)
    share = pairs[:, 0] / pairs[:, 1]
    is_right = np.abs(share - 1.0) <= WITHIN
    print(
        f"time left: {is_right.sum()} of {len(share)} within a third; said over true "
        f"{share.min(initial=np.inf):.2f} to {share.max(initial=0.0):.2f}"
    )
    figures = {
        "provenance": made_by,
        "workers": arguments.workers,
        "runs": runs,
        "times_left": {"told": len(share), "within_a_third": int(is_right.sum())},
    }
    if arguments.json is not None:
        write_json(arguments.json, figures)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
