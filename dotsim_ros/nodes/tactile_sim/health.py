# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `tactile_sim` reports on /diagnostics. Needs no ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from dotsim_ros.nodes.common.health import (
    FAULT_MEMORY_S,
    Report,
    fault_values,
    is_recent,
    statuses_of,
)
from dotsim_ros.nodes.common.ingest import FaultLog
from msg_adapters import Level, Status

if TYPE_CHECKING:
    from dotsim_ros.gel.make import GelFrame

RATE_WINDOW_S = 5.0
SPENT_FRAME_COUNT = 1500
GROUPS = {"gel": ("contact", "solve"), "optics": ("depth", "image")}


class FrameCounter:
    """Counts frames, their rate over the last seconds, and where their time went.

    One thread may count while another one reads.

    Attributes:
        count: frames since the start.
        unconverged: those of them whose gel had not converged.
        last_unconverged_s: when the last of these was.
    """

    def __init__(self) -> None:
        self.count = 0
        self.unconverged = 0
        self.last_unconverged_s = -np.inf
        self._lock = Lock()
        self._times_s: deque[float] = deque()
        self._spent_s: deque[Mapping[str, float]] = deque(maxlen=SPENT_FRAME_COUNT)

    def note(self, now_s: float, spent_s: Mapping[str, float], *, converged: bool) -> None:
        """Count a frame that took `spent_s` by part."""
        with self._lock:
            self.count += 1
            if not converged:
                self.unconverged += 1
                self.last_unconverged_s = now_s
            self._times_s.append(now_s)
            self._spent_s.append(spent_s)

    def rate_hz(self, now_s: float) -> float:
        """Return frames per second over the last seconds."""
        with self._lock:
            while self._times_s and now_s - self._times_s[0] > RATE_WINDOW_S:
                self._times_s.popleft()
            if len(self._times_s) < 2:
                return 0.0
            return (len(self._times_s) - 1) / max(now_s - self._times_s[0], 1e-9)

    def p95_ms(self) -> dict[str, float]:
        """Return the 95th percentile of each part and group over the last minute at 25 Hz."""
        with self._lock:
            frames = list(self._spent_s)
        parts = sorted({part for spent in frames for part in spent})
        table_ms = np.array(
            [[1e3 * spent.get(part, 0.0) for part in parts] for spent in frames]
        ).reshape(len(frames), len(parts))
        columns = dict(zip(parts, table_ms.T, strict=True))
        for name, members in GROUPS.items():
            if set(members) <= set(columns):
                columns[name] = np.sum([columns[member] for member in members], axis=0)
        return {name: float(np.percentile(column, 95)) for name, column in columns.items()}


@dataclass(frozen=True)
class Condition:
    """What the node knows at one moment, next to its counters.

    Attributes:
        is_active: the node's state lets it make frames.
        is_enabled: its service `set_enabled` does.
        silence_s: seconds since the last input, or None before the first.
        missing_input: why there can be no input, in words; empty where nothing is known.
        timeout_s: how long a silence is normal.
        is_realtime: the clock.
        late: frames that started late, or show the indenter on its way to the newest pose.
        dropped: frames that were left out.
        lag_m: how far from its newest pose the indenter was at most in a frame since the last
            report.
        maximum_lag_m: how far is normal.
        profile: what is told of it.
        clock_silence: that the time of the frames does not move on, in words; empty where it does.
        rivals: who else publishes what this sensor does, in words; empty for nobody.
    """

    is_active: bool
    is_enabled: bool
    silence_s: float | None
    missing_input: str
    timeout_s: float
    is_realtime: bool
    late: int
    dropped: int
    lag_m: float
    maximum_lag_m: float
    profile: Mapping[str, str]
    clock_silence: str = ""
    rivals: str = ""


def statuses(
    node_name: str,
    hardware_id: str,
    *,
    condition: Condition,
    counter: FrameCounter,
    faults: FaultLog,
    gel: GelFrame,
    effects: Sequence[str],
    force: Report | None = None,
    now_s: float,
) -> list[Status]:
    """Return the states of the frames, the input, the gel and, where it is followed, the force."""
    reports = {
        "frames": _frames(condition, counter, now_s),
        "input": _input(condition, faults, now_s),
        "gel": _gel(gel, effects, counter, now_s),
    }
    if force is not None:
        reports["force"] = force
    return statuses_of(node_name, hardware_id, reports)


def _frames(condition: Condition, counter: FrameCounter, now_s: float) -> Report:
    values = {
        "frames": str(counter.count),
        "rate_hz": f"{counter.rate_hz(now_s):.2f}",
        "dropped": str(condition.dropped),
        "late": str(condition.late),
        "lag_m": f"{condition.lag_m:.6f}",
        **condition.profile,
        **{f"{part}_p95_ms": f"{value:.2f}" for part, value in counter.p95_ms().items()},
    }
    if not condition.is_active:
        return Level.WARN, "inactive: activate the node to continue", values
    if not condition.is_enabled:
        return Level.WARN, "disabled: call set_enabled to continue", values
    if condition.clock_silence:
        return Level.WARN, condition.clock_silence, values
    if condition.rivals:
        return Level.WARN, condition.rivals, values
    if condition.is_realtime and counter.count and condition.dropped > 0.01 * counter.count:
        return Level.WARN, "frames are dropped: the machine is too slow for this rate", values
    if condition.lag_m > condition.maximum_lag_m:
        return Level.WARN, lag_text(condition.lag_m, condition.maximum_lag_m), values
    return Level.OK, "running", values


def lag_text(lag_m: float, maximum_lag_m: float) -> str:
    """Return in words that the indenter lags behind."""
    return (
        f"the indenter is {1e3 * lag_m:.2f} mm behind its newest pose, more than maximum_lag_m, "
        f"{maximum_lag_m:g} m: it moves faster than the frames can follow in contact; move it more "
        "slowly, raise rate_hz where the machine allows, or use simulated time"
    )


def _input(condition: Condition, faults: FaultLog, now_s: float) -> Report:
    values = {
        "silence_s": "none received"
        if condition.silence_s is None
        else f"{condition.silence_s:.2f}",
        **fault_values(faults),
    }
    if is_recent(faults, now_s):
        return Level.WARN, faults.last_reason, values
    if condition.missing_input:
        return Level.WARN, condition.missing_input, values
    if condition.silence_s is None:
        return Level.OK, "no input so far", values
    if condition.silence_s > condition.timeout_s:
        return Level.WARN, f"no input for {condition.silence_s:.1f} s: the last frame holds", values
    return Level.OK, "input is valid", values


def _gel(gel: GelFrame, effects: Sequence[str], counter: FrameCounter, now_s: float) -> Report:
    values = {
        "max_penetration_um": f"{1e6 * gel.max_penetration_m:.2f}",
        "converged": str(gel.converged).lower(),
        "unconverged": str(counter.unconverged),
        "force_n": f"{float(np.linalg.norm(gel.wrench.force_n)):.4f}",
        "effects": ", ".join(effects) or "none",
    }
    # One frame among the many between two reports must not pass unseen.
    if not gel.converged or now_s - counter.last_unconverged_s < FAULT_MEMORY_S:
        return Level.WARN, "the equilibrium of a frame has not converged", values
    return Level.OK, "in equilibrium", values
