# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `xarm_sim` reports on /diagnostics. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.control.arm.command import ANGULAR, LINEAR
from dotsim_ros.control.arm.kinematics import JOINT_NAMES, SINGULAR_M
from dotsim_ros.control.arm.simulated import ArmFaults, ArmState
from dotsim_ros.nodes.common.health import Report, fault_values, is_recent, statuses_of
from dotsim_ros.nodes.common.ingest import FaultLog
from msg_adapters import Level, Status

SIMULATED = "simulated xArm 7"


@dataclass(frozen=True)
class ArmCondition:
    """What the node knows at one moment.

    Attributes:
        state: the newest.
        is_emergency: an emergency stop holds.
        is_stale: the arm stands because commands have ceased, or none has come.
        silence_s: since the last command; infinite before the first.
        faults: injected.
        published: feedback messages so far.
        late: ticks that started late.
        dropped: ticks that were left out.
    """

    state: ArmState
    is_emergency: bool
    is_stale: bool
    silence_s: float
    faults: ArmFaults
    published: int
    late: int
    dropped: int


def arm_statuses(
    node_name: str, condition: ArmCondition, faults: FaultLog, *, now_s: float
) -> list[Status]:
    """Return the states of the arm and of its input."""
    reports = {"arm": _arm(condition), "input": _input(condition, faults, now_s)}
    return statuses_of(node_name, SIMULATED, reports)


def _arm(condition: ArmCondition) -> Report:
    motion, twist = condition.state.motion, condition.state.twist
    held = [JOINT_NAMES[index] for index in motion.at_limit]
    values = {
        "speed_m_s": f"{float(np.linalg.norm(twist[LINEAR])):.4f}",
        "angular_speed_rad_s": f"{float(np.linalg.norm(twist[ANGULAR])):.4f}",
        "fastest_joint_rad_s": f"{float(np.abs(motion.rates_rad_s).max()):.3f}",
        "smallest_singular_value_m": f"{motion.smallest_m:.4f}",
        "joints_at_limit": ", ".join(held) or "none",
        "feedback_count": str(condition.published),
        "late": str(condition.late),
        "dropped": str(condition.dropped),
        "emergency_stop": str(condition.is_emergency).lower(),
        "fail_drop_feedback": str(condition.faults.drops_feedback).lower(),
        "fail_delay_s": f"{condition.faults.delay_s:g}",
        "fail_stop": str(condition.faults.is_stopped).lower(),
    }
    if condition.is_emergency:
        return Level.ERROR, "emergency stop: call reset to continue", values
    if condition.faults != ArmFaults():
        return Level.WARN, "failing on request", values
    if held:
        return Level.WARN, f"held back by the limit of {', '.join(held)}", values
    if motion.slowed < 1.0:
        return Level.WARN, "slowed down: a joint is at its greatest speed", values
    if motion.smallest_m < SINGULAR_M:
        return Level.WARN, "nearly singular: some directions are slowed down", values
    return Level.OK, "standing" if condition.is_stale else "following", values


def _input(condition: ArmCondition, faults: FaultLog, now_s: float) -> Report:
    heard = np.isfinite(condition.silence_s)
    values = {
        "silence_s": f"{condition.silence_s:.2f}" if heard else "none received",
        **fault_values(faults),
    }
    if is_recent(faults, now_s):
        return Level.WARN, faults.last_reason, values
    if not heard:
        return Level.OK, "no velocity so far", values
    if condition.is_stale:
        return Level.OK, f"no velocity for {condition.silence_s:.1f} s: the arm stands", values
    return Level.OK, "input is valid", values
