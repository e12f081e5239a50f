# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The depth of an indenter that follows a force from frame to frame, with one step of the gel in
each; `force_control` searches at one moment instead.

Contact forces grow as a power of depth: a flat punch's as the first, a sphere's as its 1.5th, a
cone's as its square, faster where the gel is thin. So the next depth is guessed by such a power
through the last depth and force, and the power by the last two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.twin.force_control import TOLERANCE_N

TOLERANCE_SHARE = 0.01
"""A force within this of the one asked for is left as it is: to chase the gel's own tolerance would
only make the indenter tremble."""
CLEAR_M = 0.2e-3
"""How far above the skin the indenter waits where no force is asked for."""
PROBE_M = 0.05e-3
"""How much deeper the indenter goes where there is no force yet that the next depth could be
guessed by."""
FIRST_POWER = 1.5
"""Of a sphere; a power from 0 to 3 is still found from there, as the error of the force changes by
1 minus the ratio of the two."""
LEAST_POWER, LARGEST_POWER = 1.0, 4.0
TELLING_SHARE = 0.05
"""Two depths nearer than this do not tell the power: friction and the solver's tolerance do."""


def is_met(force_n: float, asked_n: float) -> bool:
    """Return whether a normal force is the one that is asked for, within the tolerance."""
    return abs(force_n - asked_n) <= max(TOLERANCE_N, TOLERANCE_SHARE * asked_n)


@dataclass
class _Press:
    depth_m: float
    force_n: float


class ForceFollower:
    """Guesses at which depth the gel gives a force; learns from what it gave at the depths before.

    Depth is the indenter's way along its axis beyond where it touches the skin at rest, negative
    above.

    Args:
        travel_m: how far the indenter may move in the gel between two frames.
    """

    def __init__(self, *, travel_m: float) -> None:
        self._travel_m = travel_m
        self.forget()

    def forget(self) -> None:
        """Begin again, clear of the gel, with nothing known of it."""
        self._depth_m, self._force_n = -CLEAR_M, 0.0
        self._last_pressed: _Press | None = None
        self._power = FIRST_POWER

    @property
    def depth_m(self) -> float:
        """Return the depth of the last frame."""
        return self._depth_m

    def next_m(self, asked_n: float) -> float:
        """Return the depth for the next frame, in which the gel is to give a normal force, 0 or
        more."""
        inside_m = max(self._depth_m, 0.0)
        if asked_n <= TOLERANCE_N:
            wanted_m = -CLEAR_M
        elif self._depth_m > 0.0 and is_met(self._force_n, asked_n):
            return self._depth_m
        elif self._last_pressed is None:
            wanted_m = inside_m + PROBE_M
        else:
            wanted_m = self._guess_m(self._last_pressed, asked_n)
            if self._depth_m > 0.0 and self._force_n <= 0.0:
                # What was learnt elsewhere does not hold here: the contact is lost.
                wanted_m = max(wanted_m, inside_m + PROBE_M)
        lowest_m = inside_m - self._travel_m
        return min(
            max(wanted_m, lowest_m if lowest_m > 0.0 else -CLEAR_M), inside_m + self._travel_m
        )

    def _guess_m(self, press: _Press, asked_n: float) -> float:
        return press.depth_m * float((asked_n / press.force_n) ** (1.0 / self._power))

    def answer(self, depth_m: float, force_n: float) -> None:
        """Take the normal force that the gel gave at the depth that the indenter got to."""
        before = self._last_pressed
        self._depth_m, self._force_n = depth_m, force_n
        if depth_m <= 0.0 or force_n <= 0.0:
            return
        self._last_pressed = _Press(depth_m, force_n)
        if before is None:
            return
        deeper = np.log(depth_m / before.depth_m)
        if abs(deeper) > TELLING_SHARE:
            power = np.log(force_n / before.force_n) / deeper
            self._power = float(np.clip(power, LEAST_POWER, LARGEST_POWER))
