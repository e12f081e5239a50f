# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames at a fixed rate by absolute deadlines. Needs no ROS and no clock: times are handed in."""

from __future__ import annotations


class FramePace:
    """When the next frame is due, and which frames came late or had to be left out.

    A frame that ends after the next deadline, but before the one after it, makes the next frame
    start late; deadlines that have passed completely are left out, never made up for. So the rate
    drops under load and the delay does not grow.

    Args:
        rate_hz: frames per second.
        start_s: the first deadline.

    Attributes:
        late: frames that started more than a tenth of a period after their deadline.
        dropped: deadlines without a frame.
    """

    def __init__(self, *, rate_hz: float, start_s: float) -> None:
        self._period_s = 1.0 / rate_hz
        self._start_s = start_s
        self._index = 0
        self.late = 0
        self.dropped = 0
        self._dropped_before = 0

    def resumed(self, *, rate_hz: float, start_s: float) -> FramePace:
        """Return a pace of another rate or start that goes on counting."""
        pace = FramePace(rate_hz=rate_hz, start_s=start_s)
        pace.late = self.late
        pace.dropped = pace._dropped_before = self.dropped
        return pace

    @property
    def dropped_share(self) -> float:
        """Share of the deadlines of this rate that had no frame."""
        return (self.dropped - self._dropped_before) / max(self._index, 1)

    def deadline_s(self) -> float:
        """Return when the next frame is due."""
        return self._start_s + self._index * self._period_s

    def begin(self, now_s: float) -> None:
        """Note that the next frame starts now, leaving out the deadlines that have passed."""
        overdue = int((now_s - self.deadline_s()) / self._period_s)
        if overdue > 0:
            self.dropped += overdue
            self._index += overdue
        if now_s - self.deadline_s() > 0.1 * self._period_s:
            self.late += 1
        self._index += 1
