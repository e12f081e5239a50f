# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The closed loop in simulated time: is it the same on a quiet machine and on a busy one?

    python benchmarks/simulated_loop.py --faults 100 --json docs/results/simulated_loop.json

Every trial is led twice: undisturbed, and with one busy process pinned to each core at equal
priority. Of each the bag is hashed (topics, stamps, serialized messages, in order), and compared.
Then faults are injected at drawn simulated times, again in both, and the times after which the arm
is commanded nothing, or stands, are compared. The speed is simulated seconds for each real one as
the policy leads; starts are not in it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from slow_machine import competition

from dotsim_ros.arrays import FloatArray
from dotsim_ros.files import write_json
from dotsim_ros.measured.bag_hash import bag_sha256
from dotsim_ros.nodes.common.transport import stay_local
from dotsim_ros.nodes.loop.closed_loop import ClosedLoop, LoopFault, LoopSetup, TimedFault
from dotsim_ros.nodes.loop.loop_time import SIMULATED
from dotsim_ros.provenance import provenance
from dotsim_ros.tasks.loop.judge import judge, trial_start
from dotsim_ros.tasks.policy.paths import PATHS, DomeContact, reference_path

POLICY = "densetact2_sphere"
CONDITIONS = {"quiet": False, "busy": True}
FAULT_EARLIEST_S, FAULT_LATEST_S, WATCHED_S = 0.6, 1.4, 0.6


def led(path_name: str, numbers: range, seconds: float, folder: Path) -> list[dict[str, Any]]:
    """Lead trials of a path in one loop; return hash, error and speed of each."""
    contact = DomeContact()
    path = reference_path(path_name, contact)
    setup = LoopSetup(POLICY)
    rows = []
    with ClosedLoop(setup, contact=contact, clock=SIMULATED) as loop:
        loop.start(path.name)
        for number in numbers:
            bag = folder / str(number) / "loop"
            start_m = trial_start(path, contact, seed=0, number=number)
            recording = loop.trial(start_m, seconds, bag=bag)
            row = judge(recording, path, setup.limits())
            rows.append(
                {
                    "path": path_name,
                    "number": number,
                    "sha256": bag_sha256(bag),
                    "mean_error_mm": row.get("mean_error_mm"),
                    "frame_rate_hz": row["frame_rate_hz"],
                    "stops": row["stops"],
                    "speed_factor": round(loop.led_speed_factor, 3),
                }
            )
            shutil.rmtree(bag.parent)
    return rows


def failed(faults: list[tuple[LoopFault, float]]) -> list[dict[str, Any]]:
    """Inject faults one after the other; return when the commands became zero after each."""
    contact = DomeContact()
    path = reference_path("line", contact)
    rows = []
    with ClosedLoop(LoopSetup(POLICY), contact=contact, clock=SIMULATED) as loop:
        loop.start(path.name)
        for number, (fault, at_s) in enumerate(faults):
            loop.heal()
            start_m = trial_start(path, contact, seed=1, number=number)
            recording = loop.trial(start_m, at_s + WATCHED_S, faults=[TimedFault(at_s, fault)])
            fault_s = recording.notes["enabled_s"] + at_s
            watched = recording.between(fault_s, fault_s + WATCHED_S)
            # It is stopped by its controller or, where that sees nothing wrong, by itself.
            ways = {
                "commands": zero_from_s(watched.command_s, watched.command),
                "motion": zero_from_s(watched.twist_s, watched.twist),
            }
            found = {name: each - fault_s for name, each in ways.items() if each is not None}
            rows.append(
                {
                    "fault": str(fault),
                    "at_s": round(at_s, 3),
                    "zero_after_ms": {name: round(1e3 * each, 3) for name, each in found.items()},
                    "stops": recording.notes["stops"],
                }
            )
    return rows


def zero_from_s(times_s: FloatArray, rows: FloatArray) -> float | None:
    """Return the time from which all rows are zero; None where the last one is not."""
    moving = np.flatnonzero(rows.any(axis=1))
    first = int(moving[-1]) + 1 if len(moving) else 0
    return float(times_s[first]) if first < len(times_s) else None


def drawn_faults(count: int, seed: int) -> list[tuple[LoopFault, float]]:
    """Return faults in turn, each at a drawn time on the grid of the steps."""
    random = np.random.default_rng(seed)
    kinds = list(LoopFault)
    times_s = np.round(random.uniform(FAULT_EARLIEST_S, FAULT_LATEST_S, count), 2)
    return [(kinds[n % len(kinds)], float(time_s)) for n, time_s in enumerate(times_s)]


def main() -> None:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--trials", type=int, default=10, help="of each path")
    add("--seconds", type=float, default=4.0, help="of simulated time that the policy leads")
    add("--paths", nargs="+", default=list(PATHS), choices=PATHS)
    add("--faults", type=int, default=0, help="how many to inject")
    add("--seed", type=int, default=0, help="of the faults")
    add("--json", type=Path, help="file for the figures")
    arguments = parser.parse_args()
    stay_local()
    figures: dict[str, Any] = {"load_before": os.getloadavg()}
    faults = drawn_faults(arguments.faults, arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        for name, is_busy in CONDITIONS.items():
            begun_s = time.monotonic()
            with competition(is_busy):
                rows = [
                    row
                    for path in arguments.paths
                    for row in led(
                        path, range(arguments.trials), arguments.seconds, Path(folder) / name / path
                    )
                ]
                stopped = failed(faults) if faults else []
            figures[name] = {
                "trials": rows,
                "faults": stopped,
                "wall_s": round(time.monotonic() - begun_s, 1),
                "speed_factor_median": round(
                    float(np.median([row["speed_factor"] for row in rows])), 3
                ),
            }
    quiet, busy = figures["quiet"], figures["busy"]
    pairs = list(zip(quiet["trials"], busy["trials"], strict=True))
    twins = list(zip(quiet["faults"], busy["faults"], strict=True))
    figures["identical_bags"] = sum(a["sha256"] == b["sha256"] for a, b in pairs)
    figures["bags"] = len(pairs)
    figures["stopped_faults"] = sum(bool(a["zero_after_ms"]) for a, _ in twins)
    figures["identical_stops"] = sum(bool(a["zero_after_ms"]) and a == b for a, b in twins)
    figures["faults"] = len(twins)
    shown = {key: value for key, value in figures.items() if key not in CONDITIONS}
    shown |= {f"{name}_speed_factor": figures[name]["speed_factor_median"] for name in CONDITIONS}
    print(json.dumps(shown, indent=2))
    if arguments.json is not None:
        write_json(arguments.json, figures | {"provenance": provenance()})


if __name__ == "__main__":
    main()
