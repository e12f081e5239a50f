"""The rule that turns evidence into an answer. Frozen: a change of it is a change of its version.

Version 1. Data in which no effect gains more than the null's threshold have no gap, unless the
patterns that any model could remove gain more than theirs: then it is unknown. Otherwise the effect
that gains most, once refitted, is named, with those that gain nearly as much; where it
explains too little of what could be removed, further effects are added, and where that does not
help the effect is unknown.
"""

from __future__ import annotations

import math

RULE_VERSION = 1

SCREENED = 3
"""So many effects are refitted, together with those that gain nearly as much."""
SAME = 9.6
"""Effects whose gains differ by less cannot be told apart: d = 3.1 deviations, squared."""
EXPLAINED = 0.8
"""An effect that explains less of what could be removed is not the whole answer."""
FURTHER = 0.3
"""Another effect must explain so much of what remains."""
MOST_EFFECTS = 2
NULL_DRAWS = 200
HEAVIER = 4.0
"""Gains of true data without any effect exceed those of simulated ones by this factor: 3.3 for
effects and 2.7 for patterns in the commissioning of a unit whose torus press buckled, with margin.
One unit is no distribution: `dotsim_ros evaluate gap` measures it on more."""


def threshold_of(gains: list[float], alpha: float, *, heavier: float) -> float:
    """Return the gain that data without an effect exceed with probability alpha.

    Beyond the draws the tail is taken as exponential, as that of half a chi-square is.

    Args:
        gains: of simulated nulls.
        alpha: the probability.
        heavier: factor by which gains of true nulls exceed those of simulated ones.
    """
    ordered = sorted(gains)
    count = len(ordered)
    if alpha * count >= 1.0:
        place = min(count - 1, round((1.0 - alpha) * count))
        return heavier * ordered[place]
    median, top = ordered[count // 2], ordered[min(count - 1, int(0.95 * count))]
    rate = (top - median) / math.log(10.0)
    return heavier * (top + rate * math.log(0.05 / alpha))
