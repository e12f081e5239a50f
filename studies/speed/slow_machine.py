# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The node in real time, and the closed loop, on a quiet machine and on one that others use.

Each profile runs twice, undisturbed and with one busy process pinned to each core at the node's own
priority, one run after the other. The node is measured as in realtime.py, the loop as in
trajectory/closed_loop.py; their heads say what a latency is. A missed deadline is one that
`tactile_sim` left out: it makes no frame for it.

The loop's own parameters set a wide grid for every profile; here it is left to the profile.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dotsim_ros.control.policy.network import read_policy
from dotsim_ros.nodes.tactile_policy.files import policy_folder
from dotsim_ros.nodes.tactile_sim.profiles import NAMES
from studies.run import FAILED, expect_known, expect_positive
from studies.speed.realtime import measure_node
from studies.timing import competition, percentiles_ms
from studies.trajectory.closed_loop import measure

SETTLE_S = 1.0
PROFILES = tuple(name for name in NAMES if name != "by_clock")


def node_row(profile: str, seconds: float, rate_hz: float, sensor: str) -> dict[str, Any]:
    """Return the figures of the node alone."""
    found = measure_node(seconds, rate_hz, sensor, {"profile": profile})
    latency = percentiles_ms(found["latency_s"])
    return {
        "frames_per_second": found["frames_per_second"],
        "latency_p50_ms": latency["p50_ms"],
        "latency_p99_ms": latency["p99_ms"],
        "longest_gap_ms": found["longest_gap_ms"],
        **reported(found["node"]),
    }


def loop_row(profile: str, seconds: float, policy: Path) -> dict[str, Any]:
    """Return the figures of the closed loop; its latency is that from a pose to its frame."""
    given = {"profile": profile, "grid_spacing_m": 0.0}
    card, _ = read_policy(policy)
    found = measure(policy, "figure_eight", seconds / 60.0, card.sensor, sensor_parameters=given)
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
        **reported(found["told_by_the_sensor"]),
    }


def reported(values: Mapping[str, str]) -> dict[str, Any]:
    """Return what `tactile_sim` reports of its deadlines and its profile."""
    return {
        "missed_deadlines": int(values.get("dropped", -1)),
        "late_frames": int(values.get("late", -1)),
        "profile": values.get("profile", "?"),
        "profile_changes": int(values.get("profile_changes", 0)),
        "profile_changes_refused": int(values.get("profile_changes_refused", 0)),
        "profile_largest_jump_mm": float(values.get("profile_largest_jump_mm", 0.0)),
        "profile_reason": values.get("profile_reason", "?"),
    }


def slow_machine(
    *,
    seconds: float = 10.0,
    rate_hz: float = 25.0,
    sensor: str = "densetact2",
    profiles: tuple[str, ...] = PROFILES,
    loop: bool = False,
    policy: str = "densetact2_sphere",
) -> dict[str, Any]:
    """The node, and the closed loop, on a quiet machine and next to busy processes.

    Args:
        seconds: under load, a run.
        rate_hz: of the node.
        sensor: of the node; the loop has its policy's.
        profiles: of `tactile_sim`.
        loop: run the closed loop, too.
        policy: folder or name of the loop's policy.
    """
    expect_positive(seconds=seconds, rate_hz=rate_hz)
    expect_known("profile", profiles, PROFILES)
    load_before = os.getloadavg()
    rows = []
    for profile in profiles:
        for is_disturbed in (False, True):
            head = {"asked": profile, "is_disturbed": is_disturbed}
            with competition(is_disturbed):
                time.sleep(SETTLE_S)
                row = node_row(profile, seconds, rate_hz, sensor)
                rows.append({"subject": "node", **head, **row})
                if loop:
                    row = loop_row(profile, seconds, policy_folder(policy))
                    rows.append({"subject": "closed loop", **head, **row})
    return {
        "seconds": seconds,
        "load_average_before": [round(each, 2) for each in load_before],
        "rows": rows,
        FAILED: [
            f"{row['asked']}: the loop exceeded {', '.join(row['exceeded'])}"
            for row in rows
            if row.get("exceeded")
        ],
    }
