# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Faults of a node's input: their closed set, which input is in force, and when one is logged.

Needs no ROS.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from enum import StrEnum
from threading import Lock

import numpy as np

EARLY_S = 0.5
"""A message that was refused as out of order may be the first of a new time that long."""
EARLY_COUNT = 20


class Fault(StrEnum):
    """Why an input was refused or taken as a new start; the value names its counter."""

    NUMBERS = "invalid_numbers"
    FRAME = "wrong_frame"
    ORDER = "out_of_order"
    BOTH = "both_inputs"
    GEL = "refused_by_gel"
    FAILURE = "gel_failures"
    JUMP = "jumps"
    RESTART = "time_restarts"


class RefusedInputError(ValueError):
    """An input that is not simulated.

    Attributes:
        fault: which of the closed set.
    """

    def __init__(self, fault: Fault, reason: str) -> None:
        super().__init__(reason)
        self.fault = fault


class TimeRestart:
    """Tells, after a clock has gone back, what was sent before from what is of the new time.

    Topics have no common order: a message of the old time may come after the clock's jump, and one
    of the new time before it, where it is refused as out of order. So may one that comes before the
    clock leaps on towards the time before.
    """

    def __init__(self) -> None:
        self._before_ns = self._midway_ns = 0
        self._early: deque[tuple[float, Callable[[], object]]] = deque(maxlen=EARLY_COUNT)

    def hold(self, act: Callable[[], object], now_s: float) -> None:
        """Keep what does again what was refused as out of order at a steady time."""
        self._early.append((now_s, act))

    def begin(self, *, before_ns: int, now_ns: int, now_s: float) -> list[Callable[[], object]]:
        """Note that the clock has gone back; return as `early`."""
        self._before_ns, self._midway_ns = before_ns, (before_ns + now_ns) // 2
        return self.early(now_s)

    def early(self, now_s: float) -> list[Callable[[], object]]:
        """Return what was refused just before the clock jumped, to be done again."""
        acts = [act for held_s, act in self._early if now_s - held_s < EARLY_S]
        self._early.clear()
        return acts

    def check(self, stamp_ns: int, now_ns: int) -> None:
        """Refuse a message of the time before the clock went back.

        Raises:
            RefusedInputError: its stamp is near to the clock before its jump, and farther from the
                clock now.
        """
        near_ns = min(abs(stamp_ns - now_ns), self._before_ns - self._midway_ns)
        if now_ns < self._midway_ns and abs(stamp_ns - self._before_ns) < near_ns:
            raise RefusedInputError(
                Fault.ORDER,
                f"the stamp is {1e-9 * (stamp_ns - now_ns):.3f} s ahead of the clock, which has "
                "gone back: the message is of the time before",
            )


class InputArbiter:
    """Lets one input at a time move the indenter.

    Args:
        timeout_s: an input that is silent for so long gives way to the other.
    """

    def __init__(self, *, timeout_s: float) -> None:
        self.timeout_s = timeout_s
        self._speaker = ""
        self._heard_s = -np.inf

    def is_silent(self, now_s: float) -> bool:
        """Return whether no input is active at the moment."""
        return now_s - self._heard_s > self.timeout_s

    def silence_s(self, now_s: float) -> float | None:
        """Return for how long no input has come; None before the first."""
        return now_s - self._heard_s if self._speaker else None

    def admit(self, name: str, now_s: float) -> bool:
        """Note an input; return whether it takes over from another one.

        Raises:
            RefusedInputError: the other one is active.
        """
        if name != self._speaker and not self.is_silent(now_s):
            raise RefusedInputError(
                Fault.BOTH,
                f"{name} comes while {self._speaker} moves the indenter: stop one of the two, or "
                "set the parameter input",
            )
        takes_over = self._speaker not in ("", name)
        self._speaker, self._heard_s = name, now_s
        return takes_over


class FaultLog:
    """Counts faults and limits how often they are logged; from any thread.

    Args:
        period_s: time between two lines about faults of one kind.

    Attributes:
        last_reason: of the newest fault, in words.
        last_s: when that was.
    """

    def __init__(self, *, period_s: float = 5.0) -> None:
        self._period_s = period_s
        self._lock = Lock()
        self._count: Counter[Fault] = Counter()
        self._logged_s: dict[Fault, float] = {}
        self.last_reason = ""
        self.last_s = -np.inf

    def note(self, fault: Fault, reason: str, now_s: float) -> bool:
        """Count a fault; return whether to log it."""
        with self._lock:
            self._count[fault] += 1
            self.last_reason, self.last_s = reason, now_s
            if now_s - self._logged_s.get(fault, -np.inf) < self._period_s:
                return False
            self._logged_s[fault] = now_s
            return True

    def counts(self) -> dict[Fault, int]:
        """Return how often each fault has happened, all of them."""
        with self._lock:
            return {fault: self._count[fault] for fault in Fault}
