# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How the time of a closed loop passes: by itself, or in steps that the program takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from dotsim_ros.nodes.common.processes import NodeProcess
from dotsim_ros.nodes.loop.observer import PATIENCE_S, LoopObserver
from dotsim_ros.nodes.simulated_time.participants import Participant
from dotsim_ros.nodes.simulated_time.protocol import NANOSECONDS_PER_SECOND
from dotsim_ros.nodes.simulated_time.stepper import Stepper, StepperSettings

REALTIME, SIMULATED = "realtime", "simulated"
POLL_S = 0.02
STEPPED_POLL_S = 0.04


class RealTime:
    """Time passes by itself."""

    parameters: Mapping[str, Any] = {}

    def __init__(self, observer: LoopObserver) -> None:
        self._observer = observer

    def expect(self, nodes: Mapping[str, Participant]) -> None:
        """Nothing waits for nodes."""

    def now_ns(self) -> int:
        """Return the system's time."""
        return time.time_ns()

    def go(self, seconds: float) -> None:
        """Wait."""
        time.sleep(seconds)

    def wait(self, is_reached: Callable[[], Any], what: str) -> None:
        """Let time pass until something holds.

        Raises:
            OSError: it does not for too long.
        """
        self._observer.wait(is_reached, what)

    def wait_for_line(self, process: NodeProcess, text: str, timeout_s: float) -> None:
        """Wait until a node that has just begun to listen says that it hears.

        Raises:
            OSError: it does not.
        """
        process.wait_for_line(text, timeout_s=timeout_s)

    def watch(self, part: str, seconds: float, is_over: Callable[[], bool]) -> None:
        """Let time pass, less where it is over, which the diagnostics of a part of a node say."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and not is_over():
            time.sleep(POLL_S)

    def resubscribe(self, part: str) -> None:
        """Wait for diagnostics of a part of a node that are newer than now."""
        before = self._observer.diagnostics.get(part)
        self._observer.wait(
            lambda: self._observer.diagnostics.get(part) is not before, f"diagnostics of {part}"
        )


class SteppedTime:
    """Time passes in steps that all nodes and the observer take together, and stands between two
    calls; the methods are those of `RealTime`."""

    parameters: Mapping[str, Any] = {"use_sim_time": True, "stepped": True}

    def __init__(
        self, observer: LoopObserver, settings: StepperSettings, diagnostics_period_s: float
    ) -> None:
        self._observer = observer
        self._diagnostics_period_s = diagnostics_period_s
        self.stepper = Stepper(observer.beside, {}, settings)

    def expect(self, nodes: Mapping[str, Participant]) -> None:
        """Let these nodes take part from now on."""
        self.stepper.expect({**nodes, self._observer.node.get_name(): Participant()})

    def now_ns(self) -> int:
        """Return where the nodes are."""
        return self.stepper.time_ns

    def go(self, seconds: float) -> None:
        """Take the nodes on."""
        self.stepper.advance(seconds)

    def wait(self, is_reached: Callable[[], Any], what: str) -> None:
        """Let time pass until something holds; the longest wait is of simulated time."""
        end_ns = self.stepper.time_ns + PATIENCE_S * NANOSECONDS_PER_SECOND
        while not is_reached():
            if self.stepper.time_ns > end_ns:
                raise OSError(f"waited {PATIENCE_S:g} s of simulated time for {what}")
            self.go(STEPPED_POLL_S)

    def wait_for_line(self, process: NodeProcess, text: str, timeout_s: float) -> None:
        """Nothing to wait for: no step begins before all are connected, and how many steps went by
        until a line was read would depend on the machine."""

    def watch(self, part: str, seconds: float, is_over: Callable[[], bool]) -> None:
        """Let time pass, rounded to whole steps, less where it is over."""
        steps = round(seconds * NANOSECONDS_PER_SECOND / self.stepper.period_ns)
        end_ns = self.stepper.time_ns + steps * self.stepper.period_ns
        while (left_ns := end_ns - self.stepper.time_ns) > 0 and not is_over():
            since_ns, period_s = self.stepper.time_ns, self._diagnostics_period_s
            self.go(min(period_s, left_ns / NANOSECONDS_PER_SECOND))
            # In less than a period there may be none.
            if self.stepper.time_ns - since_ns >= round(period_s * NANOSECONDS_PER_SECOND):
                self._hear_after(part, since_ns)

    def resubscribe(self, part: str) -> None:
        """Wait for diagnostics of a part of a node that are newer than now."""
        since_ns = self.stepper.time_ns
        self.go(self._diagnostics_period_s)
        self._hear_after(part, since_ns)

    def _hear_after(self, part: str, since_ns: int) -> None:
        self._observer.wait(
            lambda: self._observer.diagnostics_ns.get(part, 0) > since_ns, f"diagnostics of {part}"
        )
