# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How fast simulated time may go. Needs no ROS and no clock: times are handed in."""

from __future__ import annotations

LARGEST_LAG_S = 0.1
"""What is behind by more is not made up for: time would run too fast afterwards."""


class SpeedLimit:
    """Keeps simulated time from running ahead of real time.

    Args:
        speed: simulated seconds for each real one; 0: no limit.
        now_s: real time at which the simulated one begins to run.
    """

    def __init__(self, speed: float, *, now_s: float) -> None:
        self._speed = speed
        self._due_s = now_s

    def delay_s(self, simulated_s: float, now_s: float) -> float:
        """Return how long to wait before time may go on.

        Args:
            simulated_s: what has passed since the last call.
            now_s: real time.
        """
        if self._speed == 0.0:
            return 0.0
        self._due_s = max(self._due_s + simulated_s / self._speed, now_s - LARGEST_LAG_S)
        return max(0.0, self._due_s - now_s)
