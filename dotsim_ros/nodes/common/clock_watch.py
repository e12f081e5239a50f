# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a node reports of the clock that it follows: jumps and silence. Needs no ROS, and no clock:
times are handed in."""

from __future__ import annotations

from dataclasses import dataclass

from dotsim_ros.nodes.common.health import FAULT_MEMORY_S, Report
from msg_adapters import Level

SILENT_S = 2.0
"""A clock that has not moved on for so long is warned of."""


@dataclass(frozen=True)
class ClockJump:
    """A simulated time that does not go on from the one before.

    Attributes:
        before_ns, now_ns: the times.
        shift_ns: how far the times of messages move against what has passed in the node.
    """

    before_ns: int
    now_ns: int
    shift_ns: int

    @property
    def is_restart(self) -> bool:
        """Return whether time begins again, rather than leaves something out."""
        return self.now_ns < self.before_ns

    def text(self) -> str:
        """Return in words what has happened."""
        step_s = 1e-9 * abs(self.now_ns - self.before_ns)
        if self.is_restart:
            return f"/clock went back by {step_s:.3f} s: a new start"
        return f"/clock leapt forward by {step_s:.3f} s: what it leaves out does not pass here"


class ClockWatch:
    """Remembers what the simulated time did, by the steady clock.

    Args:
        now_s: steady time.
    """

    def __init__(self, now_s: float) -> None:
        self._begun_s, self._moved_s = now_s, -1.0
        self._jump: ClockJump | None = None
        self._jumped_s = -1.0
        self._restarts = self._leaps = 0

    def move(self, now_s: float) -> None:
        """Note that the simulated time has moved on."""
        self._moved_s = now_s

    def jump(self, jump: ClockJump, now_s: float) -> None:
        """Note that it has jumped."""
        # Counted first: a report of another thread that shows the jump counts it, too.
        if jump.is_restart:
            self._restarts += 1
        else:
            self._leaps += 1
        self._jumped_s = now_s
        self._jump = jump

    def silence(self, now_s: float) -> str:
        """Return in words that time does not move on; empty where it does."""
        if self._moved_s < 0.0:
            return "use_sim_time is set and /clock is silent, or beyond what a stamp holds"
        silence_s = now_s - self._moved_s
        if silence_s < SILENT_S:
            return ""
        return (
            f"/clock has not moved on for {silence_s:.1f} s: is the simulator paused, or has it "
            "ended?"
        )

    def report(self, now_s: float) -> Report:
        """Return level, message and values for the diagnostics."""
        jump = self._jump
        since_s = now_s - (self._begun_s if self._moved_s < 0.0 else self._moved_s)
        values = {
            "silence_s": f"{since_s:.2f}",
            "restarts": str(self._restarts),
            "leaps": str(self._leaps),
            "last_jump": "" if jump is None else jump.text(),
        }
        silence = self.silence(now_s)
        if silence:
            return Level.WARN, silence, values
        if jump is not None and now_s - self._jumped_s < FAULT_MEMORY_S:
            level = Level.OK if jump.is_restart else Level.WARN
            return level, jump.text(), values
        return Level.OK, "running", values
