# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which profile a node can afford, from the times of its frames. Needs no ROS and no clock: times
are handed in.

Down at once, up with care. A few frames that miss their deadline are enough for the next coarser
profile; the next finer one must have been affordable for long, and after it was not, for twice as
long.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

WINDOW = 10
MISSES = 3
"""So many of the last `WINDOW` frames over their period are too many."""
HEADROOM = 0.8
"""A finer profile shall leave this share of the period unused in 95 % of its frames..."""
SEEN_FRAMES = 100
"""...by so many frames of the present one, the newest..."""
HOLD_S = 10.0
"""...and not sooner than this after the last change."""
PROBATION_S = 60.0
"""A finer profile that has to be left within this was too fine: its hold doubles..."""
LONGEST_HOLD_S = 640.0
"""...up to this; one that lasted longer halves it."""
REFUSED_S = 2.0
"""Before this nothing is tried again that was refused: a try costs about two frames."""


class ProfileKeeper:
    """Proposes the next profile; what becomes of a proposal is told by `moved` or `refused`.

    Args:
        frame_time_s: of each profile on this machine, from the finest profile to the coarsest. Only
            their ratios count once frames are heard of.
        period_s: time between two frames.

    Attributes:
        name: the present profile.
        changes: how many there were.
        reason: of the last one.
    """

    def __init__(self, frame_time_s: Mapping[str, float], *, period_s: float) -> None:
        self._frame_time_s = dict(frame_time_s)
        self._names = tuple(frame_time_s)
        fitting = [n for n, t in frame_time_s.items() if t <= HEADROOM * period_s]
        self.name = fitting[0] if fitting else self._names[-1]
        self.changes = 0
        self.reason = (
            f"a frame took {1e3 * self._frame_time_s[self.name]:.0f} of {1e3 * period_s:.0f} ms "
            "when warming up"
        )
        self._proposed_reason = ""
        self._hold_s = dict.fromkeys(self._names, HOLD_S)
        self._changed_s: float | None = None
        self._went_up = False
        self._not_before_s = -np.inf
        self._recent: deque[bool] = deque(maxlen=WINDOW)
        self._share: deque[float] = deque(maxlen=SEEN_FRAMES)

    def note(self, spent_s: float, now_s: float, *, period_s: float) -> str | None:
        """Hear of a frame for which the gel had to be solved; return the profile to change to.

        Args:
            spent_s: from the frame's beginning to its publication.
            now_s: steady time.
            period_s: time between two frames.
        """
        if self._changed_s is None:
            self._changed_s = now_s
        self._recent.append(spent_s > period_s)
        self._share.append(spent_s / period_s)
        if now_s < self._not_before_s:
            return None
        place = self._names.index(self.name)
        misses = sum(self._recent)
        if misses >= MISSES:
            if place + 1 == len(self._names):
                return None
            self._proposed_reason = (
                f"{misses} of {len(self._recent)} frames took more than {1e3 * period_s:.0f} ms"
            )
            return self._names[place + 1]
        if place == 0 or len(self._share) < SEEN_FRAMES:
            return None
        finer = self._names[place - 1]
        if now_s - self._changed_s >= self._hold_s[finer]:
            ratio = self._frame_time_s[finer] / self._frame_time_s[self.name]
            expected = max(1.0, ratio) * float(np.percentile(self._share, 95))
            if expected <= HEADROOM:
                self._proposed_reason = (
                    f"95 % of its frames are expected within {1e3 * expected * period_s:.0f} of "
                    f"{1e3 * period_s:.0f} ms"
                )
                return finer
        return None

    def moved(self, name: str, now_s: float) -> None:
        """Take note that the proposed profile is in force."""
        goes_up = self._names.index(name) < self._names.index(self.name)
        if self._went_up and not goes_up and self._changed_s is not None:
            factor = 2.0 if now_s - self._changed_s < PROBATION_S else 0.5
            hold_s = factor * self._hold_s[self.name]
            self._hold_s[self.name] = min(max(hold_s, HOLD_S), LONGEST_HOLD_S)
        self.name, self.reason = name, self._proposed_reason
        self.changes += 1
        self._changed_s, self._went_up = now_s, goes_up
        self._recent.clear()
        self._share.clear()

    def refused(self, now_s: float) -> None:
        """Take note that the proposed profile could not be taken up now."""
        self._not_before_s = now_s + REFUSED_S
        self._recent.clear()
