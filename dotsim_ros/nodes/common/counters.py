# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What nodes count: events a second, the spread of a figure, missed deadlines. Needs no ROS."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from threading import Lock

import numpy as np

KEPT = 15000
"""Ten minutes at 25 Hz."""
TOLD_MISS_S = 0.04


def milliseconds(*values_s: float) -> str:
    """Return times for the diagnostics."""
    return ", ".join(f"{1e3 * value_s:.1f}" for value_s in values_s)


class RateMeter:
    """Events a second over the last seconds; one thread may note while another reads.

    Args:
        window_s: how many seconds.

    Attributes:
        count: of all events.
    """

    def __init__(self, window_s: float = 5.0) -> None:
        self._window_s = window_s
        self.count = 0
        self._lock = Lock()
        self._times_s: deque[float] = deque()

    def note(self, now_s: float) -> None:
        """Count an event."""
        with self._lock:
            self.count += 1
            self._times_s.append(now_s)
            while now_s - self._times_s[0] > self._window_s:
                self._times_s.popleft()

    def rate_hz(self, now_s: float) -> float:
        """Return events per second, 0 for fewer than two."""
        with self._lock:
            times_s = [time_s for time_s in self._times_s if now_s - time_s <= self._window_s]
        if len(times_s) < 2:
            return 0.0
        return (len(times_s) - 1) / max(times_s[-1] - times_s[0], 1e-9)


class Spread:
    """The last values of a figure."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._values: deque[float] = deque(maxlen=KEPT)

    def note(self, value: float) -> None:
        """Keep a value."""
        with self._lock:
            self._values.append(value)

    def percentiles(self, *shares: float) -> list[float]:
        """Return percentiles, NaN where nothing is known."""
        with self._lock:
            values = list(self._values)
        return [float(np.percentile(values, share)) if values else np.nan for share in shares]


@dataclass(frozen=True)
class Miss:
    """A deadline that was missed by more than the limit for reporting.

    Attributes:
        loop: which of the two.
        late_s: by how much.
        unlogged: how many before it have no line of their own in the log.
    """

    loop: str
    late_s: float
    unlogged: int


class MissCounter:
    """Counts missed deadlines of one loop and limits how often they are logged.

    Args:
        loop: its name.
        period_s: time between two lines.

    Attributes:
        count: all of them.
        reported: those by more than 40 ms.
        worst_s: the largest.
    """

    def __init__(self, loop: str, *, period_s: float = 1.0) -> None:
        self._loop = loop
        self._period_s = period_s
        self._logged_s = -np.inf
        self._unlogged = 0
        self.count = 0
        self.reported = 0
        self.worst_s = 0.0

    def note(self, late_s: float, now_s: float) -> Miss | None:
        """Count a miss; return what to log, if anything."""
        self.count += 1
        self.worst_s = max(self.worst_s, late_s)
        if late_s <= TOLD_MISS_S:
            return None
        self.reported += 1
        if now_s - self._logged_s < self._period_s:
            self._unlogged += 1
            return None
        miss = Miss(self._loop, late_s, self._unlogged)
        self._logged_s, self._unlogged = now_s, 0
        return miss
