# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The closed loop in simulated time: is it the same on a quiet machine and on a busy one?

Every trial is led twice: undisturbed, and with one busy process pinned to each core at equal
priority. Of each the bag is hashed (topics, stamps, serialized messages, in order), and compared.
Then faults are injected at drawn simulated times, again in both, and the times after which the arm
is commanded nothing, or stands, are compared. The speed is simulated seconds for each real one as
the policy leads; starts are not in it.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.control.loop.judge import judge, trial_start
from dotsim_ros.control.policy.paths import PATHS, DomeContact, reference_path
from dotsim_ros.data.bag import bag_sha256
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.nodes.common.transport import stay_local
from dotsim_ros.nodes.loop.closed_loop import ClosedLoop, LoopFault, LoopSetup, TimedFault
from dotsim_ros.nodes.loop.loop_time import SIMULATED
from studies.run import FAILED, expect_known, expect_positive
from studies.timing import competition

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


def stopped(faults: list[tuple[LoopFault, float]]) -> list[dict[str, Any]]:
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


def simulated_loop(
    *,
    trials: int = 10,
    seconds: float = 4.0,
    paths: tuple[str, ...] = tuple(PATHS),
    faults: int = 100,
    seed: int = 0,
) -> dict[str, Any]:
    """The closed loop in simulated time: whether a busy machine gives what a quiet one gives.

    Args:
        trials: of each path.
        seconds: of simulated time that the policy leads.
        paths: that it follows.
        faults: to inject; 0 for none.
        seed: of the faults.
    """
    expect_positive(trials=trials, seconds=seconds)
    expect_known("path", paths, PATHS)
    stay_local()
    load_before = os.getloadavg()
    drawn = drawn_faults(faults, seed)
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, is_busy in CONDITIONS.items():
            begun_s = time.monotonic()
            with competition(is_busy):
                rows = [
                    row
                    for path in paths
                    for row in led(path, range(trials), seconds, Path(folder) / name / path)
                ]
                stops = stopped(drawn) if drawn else []
            speeds = [row["speed_factor"] for row in rows]
            found[name] = {
                "trials": rows,
                "faults": stops,
                "wall_s": round(time.monotonic() - begun_s, 1),
                "speed_factor_median": round(float(np.median(speeds)), 3),
            }
    quiet, busy = found["quiet"], found["busy"]
    pairs = list(zip(quiet["trials"], busy["trials"], strict=True))
    twins = list(zip(quiet["faults"], busy["faults"], strict=True))
    other_bags = [a for a, b in pairs if a["sha256"] != b["sha256"]]
    other_stops = [a for a, b in twins if a != b or not a["zero_after_ms"]]
    return {
        "load_before": load_before,
        **found,
        "identical_bags": len(pairs) - len(other_bags),
        "bags": len(pairs),
        "stopped_faults": sum(bool(a["zero_after_ms"]) for a, _ in twins),
        "identical_stops": len(twins) - len(other_stops),
        "faults": len(twins),
        FAILED: [
            *(f"{row['path']} {row['number']}: the bags differ" for row in other_bags),
            *(
                f"{row['fault']} at {row['at_s']} s: no stop, or not the same"
                for row in other_stops
            ),
        ],
    }
