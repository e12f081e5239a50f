# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The node in real time, and the closed loop, on a quiet machine and on one that others use.

    python benchmarks/slow_machine.py --seconds 10 --json slow_machine.json
    python benchmarks/slow_machine.py --loop --profiles auto --seconds 30

Each profile runs twice, undisturbed and with one busy process pinned to each core at the node's own
priority, one run after the other. The node is measured as in realtime.py, the loop as in
closed_loop.py, whose head tells what a latency is. A missed deadline is one that `tactile_sim` left
out: it makes no frame for it.

The loop's own parameters set a wide grid for every profile; here it is left to the profile.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import closed_loop
import realtime

from dotsim_ros.files import write_json
from dotsim_ros.nodes.tactile_policy.files import policy_folder
from dotsim_ros.nodes.tactile_sim.profiles import NAMES
from dotsim_ros.provenance import provenance

BUSY = """
import os, sys
os.sched_setaffinity(0, {int(sys.argv[1])})
starter = os.getppid()
while os.getppid() == starter:
    for _ in range(1_000_000):
        pass
"""
"""Ends by itself where its starter has ended."""
SETTLE_S = 1.0
COLUMNS = {
    "frames_per_second": "frames/s",
    "latency_p50_ms": "latency p50, ms",
    "latency_p99_ms": "p99, ms",
    "missed_deadlines": "missed deadlines",
    "profile": "profile at the end",
    "profile_changes": "changes",
    "stops_per_minute": "stops/min",
}


@contextmanager
def competition(is_wanted: bool) -> Iterator[None]:
    """Keep each core busy with a process of the usual priority, where wanted."""
    cores = sorted(os.sched_getaffinity(0)) if is_wanted else []
    busy = [subprocess.Popen([sys.executable, "-c", BUSY, str(core)]) for core in cores]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def node_row(profile: str, seconds: float, rate_hz: float, sensor: str) -> dict[str, Any]:
    """Return the figures of the node alone."""
    found = realtime.measure_node(seconds, rate_hz, sensor, {"profile": profile})
    latency = realtime.quantiles_ms(found["latency_s"])
    return {
        "frames_per_second": found["frames_per_second"],
        "latency_p50_ms": latency["p50_ms"],
        "latency_p99_ms": latency["p99_ms"],
        "longest_gap_ms": found["longest_gap_ms"],
        **told(found["node"]),
    }


def loop_row(profile: str, seconds: float, policy: Path) -> dict[str, Any]:
    """Return the figures of the closed loop; its latency is that from a pose to its frame."""
    given = {"profile": profile, "grid_spacing_m": 0.0}
    card, _ = closed_loop.read_policy(policy)
    found = closed_loop.measure(
        policy, "figure_eight", seconds / 60.0, card.sensor, sensor_parameters=given
    )
    way = found["ways"]["pose_to_frame"]
    return {
        "frames_per_second": found["frames"]["mean_hz"],
        "latency_p50_ms": way["p50_ms"],
        "latency_p99_ms": way["p99_ms"],
        "commands_per_second": found["commands"]["mean_hz"],
        "stops": found["stops"],
        "stops_per_minute": round(sum(found["stops"].values()) / found["minutes"], 2),
        "latched": found["latched"],
        "exceeded": found["motion"]["exceeded"],
        **told(found["told_by_the_sensor"]),
    }


def told(values: Mapping[str, str]) -> dict[str, Any]:
    """Return what `tactile_sim` says of its deadlines and its profile."""
    return {
        "missed_deadlines": int(values.get("dropped", -1)),
        "late_frames": int(values.get("late", -1)),
        "profile": values.get("profile", "?"),
        "profile_changes": int(values.get("profile_changes", 0)),
        "profile_changes_refused": int(values.get("profile_changes_refused", 0)),
        "profile_largest_jump_mm": float(values.get("profile_largest_jump_mm", 0.0)),
        "profile_reason": values.get("profile_reason", "?"),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rows side by side: quiet and disturbed."""
    lines = []
    for subject in dict.fromkeys(row["subject"] for row in rows):
        lines += ["", f"{subject}: undisturbed | one busy process on each core"]
        lines.append(
            "  ".join(["profile".ljust(10), *(each.rjust(20) for each in COLUMNS.values())])
        )
        for profile in dict.fromkeys(row["asked"] for row in rows if row["subject"] == subject):
            pair = [r for r in rows if (r["subject"], r["asked"]) == (subject, profile)]
            cells = [" | ".join(str(row.get(key, "-")) for row in pair) for key in COLUMNS]
            lines.append("  ".join([profile.ljust(10), *(cell.rjust(20) for cell in cells)]))
    return "\n".join(lines)


def main() -> int:
    """Run, print, write; return 1 where a safety limit was exceeded."""
    parser = argparse.ArgumentParser(
        description="tactile_sim and the closed loop, undisturbed and beside busy processes.",
        epilog="example: python benchmarks/slow_machine.py --seconds 10 --json slow_machine.json",
    )
    add = parser.add_argument
    add("--seconds", type=float, default=10.0, help="time under load, a run (10)")
    add("--rate-hz", type=float, default=25.0, help="rate of the node (25)")
    add("--sensor", default="densetact2", help="of the node; the loop has its policy's")
    known = [name for name in NAMES if name != "by_clock"]
    add("--profiles", nargs="+", choices=known, default=known, help="which (all)")
    add("--loop", action="store_true", help="run the closed loop, too")
    add("--policy", default="densetact2_sphere", help="folder or name of the loop's policy")
    add("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    load_before = os.getloadavg()
    rows = []
    for profile in arguments.profiles:
        for is_disturbed in (False, True):
            head = {"asked": profile, "is_disturbed": is_disturbed}
            with competition(is_disturbed):
                time.sleep(SETTLE_S)
                row = node_row(profile, arguments.seconds, arguments.rate_hz, arguments.sensor)
                rows.append({"subject": "node", **head, **row})
                if arguments.loop:
                    row = loop_row(profile, arguments.seconds, policy_folder(arguments.policy))
                    rows.append({"subject": "closed loop", **head, **row})
    print(f"load average before: {load_before[0]:.1f}, {os.cpu_count()} cores")
    print(table(rows))
    if arguments.json:
        figures = {
            "seconds": arguments.seconds,
            "load_average_before": [round(each, 2) for each in load_before],
            "rows": rows,
            "provenance": provenance(),
        }
        write_json(arguments.json, figures)
    return 1 if any(row.get("exceeded") for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
