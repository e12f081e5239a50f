# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The common beat of inference and control: absolute deadlines that lean towards the images.

Needs no ROS and no clock: times are handed in.
"""

from __future__ import annotations

import math
from threading import Lock

GAIN = 0.05
LARGEST_LEAN = 0.004
"""Share of a period by which a deadline moves in a cycle: the rate is within 0.4 % of nominal."""


class Beat:
    """Cycles of a fixed period, each of a number of ticks, without drift.

    A camera keeps its own time. Deadlines anywhere between two images would let an image wait up to
    a whole period; so they move, by less than the rate may be off, to where an image has just come.

    Args:
        period_s: of a cycle.
        ticks: in a cycle.
        start_s: deadline of the first.
        margin_s: how long an image should have been there.
    """

    def __init__(self, period_s: float, *, ticks: int, start_s: float, margin_s: float) -> None:
        self.period_s = period_s
        self.ticks = ticks
        self._start_s = start_s
        self._margin_s = margin_s
        self._lock = Lock()

    def cycle_s(self, cycle: int) -> float:
        """Return the deadline of a cycle."""
        with self._lock:
            return self._start_s + cycle * self.period_s

    def tick_s(self, tick: int) -> float:
        """Return the deadline of a tick; the first tick of a cycle is the cycle's."""
        with self._lock:
            return self._start_s + tick * self.period_s / self.ticks

    def next_cycle(self, now_s: float) -> int:
        """Return the first cycle whose deadline is not before a time."""
        with self._lock:
            return max(0, math.ceil((now_s - self._start_s) / self.period_s))

    def lean(self, waited_s: float) -> None:
        """Move the deadlines a little.

        Args:
            waited_s: how long the image of a cycle had waited for its deadline; negative where it
                came after it.
        """
        error_s = waited_s - self._margin_s
        # An image that waited for most of a period came just after the deadline before.
        error_s -= self.period_s * round(error_s / self.period_s)
        largest_s = LARGEST_LEAN * self.period_s
        with self._lock:
            self._start_s -= min(largest_s, max(-largest_s, GAIN * error_s))
