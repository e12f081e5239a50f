# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a node does at which simulated time. Needs no ROS.

Everything runs on the thread that moves the time on, in the order of the times, whatever the
machine does meanwhile. What takes long is computed next to it and taken at a time known beforehand.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol, TypeVar

ROUNDING_S = 1e-9
"""Times that lie closer together are the same one, computed another way."""
LONGEST_STEP_S = 1.0
"""A clock that moves further at once has leapt: what it leaves out passes nowhere."""

Result = TypeVar("Result")


class PacedWork(Protocol):
    """Work that says when it wants to be done next."""

    def deadline_s(self) -> float:
        """Return when it is due."""
        ...

    def run(self, now_s: float) -> None:
        """Do it, and know a later deadline afterwards."""
        ...


class SimulatedSchedule:
    """A node's work in simulated time, counted in seconds from the first time of its clock.

    Attributes:
        now_s: the time in force: while something runs, the time that it was due at.
    """

    def __init__(self) -> None:
        self.now_s = 0.0
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._number = 0
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="simulated")
        self._computing: set[Future[Any]] = set()
        self._taken_s = 0.0

    def at(self, due_s: float, act: Callable[[], None]) -> None:
        """Do something once, at a time or, where that has passed, as soon as time moves on."""
        heapq.heappush(self._due, (due_s, self._number, act))
        self._number += 1

    def pace(
        self, deadline_s: Callable[[], float], run: Callable[[float], None]
    ) -> Callable[[], None]:
        """Run at each deadline, the first of which comes next; return what ends that."""
        is_over = False

        def act() -> None:
            if not is_over:
                run(self.now_s)
                self.at(deadline_s(), act)

        def end() -> None:
            nonlocal is_over
            is_over = True

        self.at(deadline_s(), act)
        return end

    def every(self, period_s: float, act: Callable[[], None]) -> None:
        """Do something again and again, first after one period."""
        due_s = self.now_s

        def again() -> None:
            nonlocal due_s
            act()
            due_s += period_s
            if due_s <= self.now_s:
                due_s = self.now_s + period_s
            self.at(due_s, again)

        due_s += period_s
        self.at(due_s, again)

    def compute(
        self, delay_s: float, work: Callable[[], Result], take: Callable[[Result], None]
    ) -> None:
        """Compute something from now on, and take what comes out after a delay.

        What was asked for first is taken first, as from a camera or a network that has a queue.

        Args:
            delay_s: simulated; the machine may need any time.
            work: runs in a thread of its own, one after the other; changes nothing that other work
                looks at meanwhile.
            take: runs on the thread that moves the time on; what `work` raised is raised there.
        """
        future = self._worker.submit(work)
        self._computing.add(future)

        def finish() -> None:
            if future in self._computing:
                self._computing.discard(future)
                take(future.result())

        self._taken_s = max(self._taken_s, self.now_s + delay_s)
        self.at(self._taken_s, finish)

    def settle(self) -> None:
        """Wait until nothing is being computed."""
        for future in list(self._computing):
            future.exception()

    def until_next_s(self) -> float:
        """Return how long it is until something is due, at most `LONGEST_STEP_S`."""
        next_s = self._due[0][0] - self.now_s if self._due else LONGEST_STEP_S
        return min(max(next_s, 0.0), LONGEST_STEP_S)

    def advance(self, to_s: float) -> None:
        """Move the time on, and do what is due on the way."""
        while self._due and self._due[0][0] <= to_s + ROUNDING_S:
            due_s, _, act = heapq.heappop(self._due)
            self.now_s = max(self.now_s, due_s)
            act()
        self.now_s = max(self.now_s, to_s)

    def drop_computed(self) -> None:
        """Let what is being computed end, and take nothing of it."""
        self.settle()
        self._computing.clear()

    def clear(self) -> None:
        """Let what is being computed end, and do nothing of what has been asked for so far."""
        self.drop_computed()
        self._due.clear()

    def close(self) -> None:
        """Let what is being computed end; nothing more is done."""
        self._due.clear()
        self._worker.shutdown(wait=True, cancel_futures=True)
