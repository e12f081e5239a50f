# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `tactile_policy` reports on /diagnostics. Needs no ROS."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dotsim_ros.control.safety_layer.limits import State
from dotsim_ros.nodes.common.health import Report, statuses_of
from msg_adapters import Level, Status

if TYPE_CHECKING:
    from dotsim_ros.nodes.tactile_policy.inputs import PolicyInputs
    from dotsim_ros.nodes.tactile_policy.loops import ControlLoop, InferenceLoop

LEVELS = {
    State.DISABLED: Level.OK,
    State.STARTING: Level.OK,
    State.RUNNING: Level.OK,
    State.RETREATING: Level.WARN,
    State.STOPPED: Level.WARN,
    State.LATCHED: Level.ERROR,
}
NO_FORCE_LIMIT = "force_limit_n is 0: nothing limits the force"
NO_FORCE = (
    "no force has come on the topic wrench: the arm does not move without; for a sensor that "
    "measures none set force_limit_n to 0"
)


def statuses(
    node_name: str,
    hardware_id: str,
    *,
    inputs: PolicyInputs,
    inference: InferenceLoop,
    control: ControlLoop,
    warnings: dict[str, str],
    now_s: float,
) -> list[Status]:
    """Return the states of the loop, of the inference and of the inputs; `warnings` says what else
    is wrong, by part."""
    reports = {
        "control": _control(control, now_s),
        "inference": _inference(inference, control, now_s),
        "input": _input(inputs, now_s),
    }
    return statuses_of(node_name, hardware_id, reports, warnings)


def _milliseconds(*values_s: float) -> str:
    return ", ".join(f"{1e3 * value_s:.1f}" for value_s in values_s)


def _control(control: ControlLoop, now_s: float) -> Report:
    order = control.order
    if order is None:
        return Level.OK, "not begun", {}
    values = {
        "state": order.state.value,
        "reason": order.reason.value,
        "stops": ", ".join(f"{reason} {count}" for reason, count in control.stops.copy().items())
        or "none",
        "command_rate_hz": f"{control.rate.rate_hz(now_s):.2f}",
        "control_rate_hz": f"{control.ticks.rate_hz(now_s):.2f}",
        "deadline_misses": str(control.misses.count),
        "deadline_misses_over_40_ms": str(control.misses.reported),
        "latest_ms": _milliseconds(control.misses.worst_s),
    }
    message = f"{order.state.value}: {order.detail}" if order.detail else order.state.value
    if order.state is State.LATCHED:
        message += "; call set_enabled once it is safe"
    return LEVELS[order.state], message, values


def _inference(inference: InferenceLoop, control: ControlLoop, now_s: float) -> Report:
    arrival_s = control.arrival_age_s.percentiles(50.0, 99.0)
    stamp_s = control.stamp_age_s.percentiles(50.0, 99.0)
    values = {
        "rate_hz": f"{inference.rate.rate_hz(now_s):.2f}",
        "commands": str(inference.taken),
        "cycles_without_image": str(inference.without_image),
        "time_p50_p95_p99_max_ms": _milliseconds(
            *inference.spent_s.percentiles(50.0, 95.0, 99.0, 100.0)
        ),
        "image_age_at_command_p50_p99_ms": _milliseconds(*stamp_s),
        "image_age_since_arrival_p50_p99_ms": _milliseconds(*arrival_s),
        "image_distance": f"{inference.distance:.2f}",
        "largest_distance": f"{inference.largest_distance:.2f}",
        "deadline_misses": str(inference.misses.count),
        "deadline_misses_over_40_ms": str(inference.misses.reported),
        "latest_ms": _milliseconds(inference.misses.worst_s),
    }
    if inference.idle is None:
        return Level.WARN, "no idle image: call calibrate_idle with the sensor untouched", values
    return Level.OK, "ready", values


def _input(inputs: PolicyInputs, now_s: float) -> Report:
    values: dict[str, str] = {}
    for watch in (inputs.image, inputs.pose, inputs.force):
        reading = watch.reading(now_s)
        values |= {
            f"{watch.name}_count": str(watch.count),
            f"{watch.name}_repeated": str(watch.repeated),
            f"{watch.name}_age_ms": _milliseconds(reading.age_s),
            f"{watch.name}_delay_ms": _milliseconds(reading.delay_s),
        }
    values["refused"] = str(inputs.refused)
    if not inputs.hears_force:
        return Level.OK, f"listening; {NO_FORCE_LIMIT}", values
    if not inputs.force.count:
        return Level.WARN, NO_FORCE, values
    return Level.OK, "listening", values
