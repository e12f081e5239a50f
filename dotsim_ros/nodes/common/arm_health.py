"""What `xarm_sim` and `xarm_adapter` say of themselves on /diagnostics. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.nodes.common.ingest import FaultLog
from dotsim_ros.nodes.tactile_sim.health import FAULT_MEMORY_S
from dotsim_ros.nodes.xarm_adapter.link import Hindrance, VelocityLink
from dotsim_ros.tasks.arm.command import ANGULAR, LINEAR
from dotsim_ros.tasks.arm.kinematics import JOINT_NAMES, SINGULAR_M
from dotsim_ros.tasks.arm.simulated import ArmFaults, ArmState
from msg_adapters import Level, Status

SIMULATED, REAL = "simulated xArm 7", "xArm"


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
    named = [("arm", _arm(condition)), ("input", _input(condition, faults, now_s))]
    return [
        Status(f"{node_name}: {part}", level, message, SIMULATED, values)
        for part, (level, message, values) in named
    ]


Report = tuple[Level, str, dict[str, str]]


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
        return Level.ERROR, "emergency stop: call reset to go on", values
    if condition.faults != ArmFaults():
        return Level.WARN, "failing on request", values
    if held:
        return Level.WARN, f"held back by the limit of {', '.join(held)}", values
    if motion.slowed < 1.0:
        return Level.WARN, "slowed down: a joint is at its greatest speed", values
    if motion.smallest_m < SINGULAR_M:
        return Level.WARN, "nearly singular: some directions are slowed down", values
    return Level.OK, "standing" if condition.is_stale else "following", values


def link_statuses(
    node_name: str, link: VelocityLink, faults: FaultLog, *, now_s: float
) -> list[Status]:
    """Return the state of the link to a real arm and of its input."""
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
        level, message = Level.OK, "the arm takes velocities"
    else:
        level, message = Level.ERROR, f"not commanding: {link.detail}"
    status = Status(f"{node_name}: arm", level, message, REAL, values)
    told = {
        **{fault.value: str(count) for fault, count in faults.counts().items()},
        "last_fault": faults.last_reason,
    }
    if now_s - faults.last_s < FAULT_MEMORY_S:
        return [
            status,
            Status(f"{node_name}: input", Level.WARN, faults.last_reason, REAL, told),
        ]
    moves = link.is_commanded(now_s)
    message = "commanded" if moves else "no velocity: the arm stands"
    return [status, Status(f"{node_name}: input", Level.OK, message, REAL, told)]


def _input(condition: ArmCondition, faults: FaultLog, now_s: float) -> Report:
    heard = np.isfinite(condition.silence_s)
    values = {
        "silence_s": f"{condition.silence_s:.2f}" if heard else "never heard",
        **{fault.value: str(count) for fault, count in faults.counts().items()},
        "last_fault": faults.last_reason,
    }
    if now_s - faults.last_s < FAULT_MEMORY_S:
        return Level.WARN, faults.last_reason, values
    if not heard:
        return Level.OK, "no velocity so far", values
    if condition.is_stale:
        return Level.OK, f"no velocity for {condition.silence_s:.1f} s: the arm stands", values
    return Level.OK, "input is valid", values
