# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `xarm_adapter` reports on /diagnostics. Needs no ROS."""

from __future__ import annotations

from dotsim_ros.nodes.common.health import Report, fault_values, is_recent, statuses_of
from dotsim_ros.nodes.common.ingest import FaultLog
from dotsim_ros.nodes.xarm_adapter.link import Hindrance, VelocityLink
from msg_adapters import Level, Status

REAL = "xArm"


def link_statuses(
    node_name: str, link: VelocityLink, faults: FaultLog, *, now_s: float
) -> list[Status]:
    """Return the state of the link to a real arm and of its input."""
    reports = {"arm": _arm(link), "input": _input(link, faults, now_s)}
    return statuses_of(node_name, REAL, reports)


def _arm(link: VelocityLink) -> Report:
    robot = link.robot
    values = {
        **{name: str(link.counts[name]) for name in ("calls", "held_back", "refused", "failed")},
        "last_refusal": link.last_refusal,
        "hindrance": link.hindrance.value,
    }
    if robot is not None:
        values |= {
            "robot_mode": str(robot.mode),
            "robot_state": str(robot.state),
            "robot_error": str(robot.error),
            "robot_warning": str(robot.warning),
        }
    if link.hindrance is Hindrance.NONE:
        return Level.OK, "the arm takes velocities", values
    return Level.ERROR, f"not commanding: {link.detail}", values


def _input(link: VelocityLink, faults: FaultLog, now_s: float) -> Report:
    values = fault_values(faults)
    if is_recent(faults, now_s):
        return Level.WARN, faults.last_reason, values
    if link.is_commanded(now_s):
        return Level.OK, "commanded", values
    return Level.OK, "no velocity: the arm stands", values
