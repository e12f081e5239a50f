# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What every node reports on /diagnostics: the states of its parts. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping

from dotsim_ros.nodes.common.ingest import FaultLog
from msg_adapters import Level, Status

FAULT_MEMORY_S = 5.0
"""A fault is a warning for so long."""

Report = tuple[Level, str, dict[str, str]]
"""Level, message and values of one part of a node."""


def statuses_of(
    node_name: str,
    hardware_id: str,
    reports: Mapping[str, Report],
    warnings: Mapping[str, str] | None = None,
) -> list[Status]:
    """Return the states of a node's parts.

    Args:
        node_name: of the node.
        hardware_id: of what it stands for.
        reports: by part.
        warnings: what else is wrong, by part.
    """
    found = []
    for part, (level, message, values) in reports.items():
        if warnings is not None and part in warnings and level < Level.WARN:
            level, message = Level.WARN, warnings[part]
        found.append(Status(f"{node_name}: {part}", level, message, hardware_id, values))
    return found


def fault_values(faults: FaultLog) -> dict[str, str]:
    """Return what was refused, by kind, and why the last time."""
    return {
        **{fault.value: str(count) for fault, count in faults.counts().items()},
        "last_fault": faults.last_reason,
    }


def is_recent(faults: FaultLog, now_s: float) -> bool:
    """Return whether the last fault is still to be warned of."""
    return now_s - faults.last_s < FAULT_MEMORY_S
