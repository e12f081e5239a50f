# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rule that turns evidence into an answer. Frozen: a change of it is a change of its version.

Version 12. Data in which no effect gains more than its limit have no gap, unless the patterns that
any model could remove gain more than theirs: then it is unknown. Otherwise, of the effects past
their limits, the one that gains most, once refitted, is named, with those that gain nearly as much;
or two, where each gains more than its limit next to the other, both gain much more than the best
one, and two thirds of the bootstrap repetitions over trajectories ask for both. The gap is unknown
where fewer of them ask for what would be named, where they explain too little of it, and where the
one that gains most asks for a size beyond its plausible range, by more than the gains of effects
that are not distinguished differ: it imitates something else, unless its range, opened, holds a
size that explains the gap and leaves nothing of the held-out trajectories in any channel, phase and
region. Before the gap is unknown, two effects are tried that each gain more than their limits, on
the same terms, if held-out trajectories have a clear gap; the smaller of them with those that gain
nearly as much there. It is unknown, too, where they have one of which the effects close too little,
and surely not all, on two of them at least. Counted as gap are what patterns could remove, what the
effects could if their sizes in skin and force were free to differ, and all by which the data differ
more than data without any effect. Naming the effect that predicts left-out trajectories best was
tried on the development half of the study: it names as many right, and makes sets where gains do
not.

Since version 12 the smaller of two effects, and what gains as much, is simulated at the size that
it has next to the larger one, gains are nearly the same within what they differ by on true data,
and of two effects as of one, what asks for more than its range leaves the place to what explains as
much. Data in which a slippery skin comes with a late pose had been seen by then: interpolated
between sizes tried alone, a controller that lags gained 37 more than the latency next to the
friction, and simulated there as much.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping

import numpy as np

from dotsim_ros.io.arrays import FloatArray

RULE_VERSION = 12

SCREENED = 3
"""So many effects are refitted, together with those that gain nearly as much."""
CLOSE = 30.0
"""Effects whose gain is less than the first one's by no more than this are refitted."""
EXPLAINED = 0.8
"""An effect that explains less of what could be removed is not the whole answer."""
LARGEST_IN_CHANNEL = 2.0
"""An effect may be up to so many times as large in the skin alone, or in the force alone, where it
is asked what is gained if they disagree."""
LEAST_CLOSED = 0.6
"""Named effects must close so much of the gap of the held-out trajectories..."""
FAR = 1.2
"""...where that gap's RMS was so many times the floor: below, the share is that of noise."""
TRAJECTORIES_OFF = 2
"""So many held-out trajectories at least must show that gap."""
AT_FLOOR = 1.5
"""RMS, in expected deviations, below which nothing is left of the held-out trajectories in a place:
where nothing is missing, two sets of a second unit come to 1.17; the margin is a guess. Of nulls
drawn from the covariance half come to 2.5 in their worst place, 98 % to 3.6: it is wider than these
units are off by, so that a limit from such draws would let more pass."""
FURTHER = 0.3
"""Another effect must explain so much of what remains."""
OTHER_LAW = 0.1
"""Another effect must gain more than its limit by this share of what the first one gains: no law of
the library is that of the real effect, and what it misses looks like something else."""
APART = 3.1
"""Effects that are fewer deviations apart are not distinguished from each other."""
SAME = APART**2
"""Gains, in squared deviations, that differ by less; those of true data, by `least_factor` more."""
ALIKE = 0.9
"""Cosine from which two effects need a whitened size of 14 to be distinguished."""
LIKELY = 2.0 / 3.0
"""What fewer bootstrap repetitions ask for is not named: one effect, or a set; two together."""
STABLE_SHARE = 0.9
"""A name that fewer bootstrap repetitions give is not stable."""
NULL_DRAWS = 200
HEAVIER = 4.0
"""No effect's limit is below this multiple of the simulated nulls' threshold: units differ in more
than the nuisances. In the commissioning of a second unit, with nothing missing, backlash comes to
3.2 times; the margin is a guess. Effects that the model's own error imitates have larger factors,
which come with the discrepancy."""
MARGIN = 1.5
"""The same where the presses of the discrepancy show how the units differ that are searched. By so
much, too, factors are larger than what presses show: draws from one half differ by less than halves
do."""
MISFIT_OF_UNITS = 0.45
"""Excess of an observable's objective that is allowed over what the discrepancy's presses leave:
the commissioning of a second unit, with nothing missing, is off by 0.34; the margin is a guess."""
MISFIT_SINCE = 0.2
"""The same against the unit's own commissioning."""
PATTERNS_HEAVIER = 3.0
"""What all patterns gain together is past its limit at this multiple of the simulated nulls'
threshold, or at the larger one that comes with the discrepancy."""


def least_factor(*, is_representative: bool) -> float:
    """Return by how much true data gain more than simulated ones, at the least.

    Args:
        is_representative: whether the discrepancy's presses show how the units differ that are
            searched.
    """
    return MARGIN if is_representative else HEAVIER


def limit_factor(name: str, measured: Mapping[str, float], *, is_representative: bool) -> float:
    """Return by how much an effect's limit exceeds the simulated nulls' threshold.

    Args:
        name: of the effect.
        measured: factors of effects by true nulls; one that is not there gets the largest, and
            `HEAVIER` at least.
        is_representative: as in `least_factor`.
    """
    unknown = max(HEAVIER, *measured.values()) if measured else HEAVIER
    return max(least_factor(is_representative=is_representative), measured.get(name, unknown))


def pattern_factor(measured: float, *, is_representative: bool) -> float:
    """Return the same for what all patterns gain together, 0 being not measured."""
    return max(MARGIN if is_representative and measured else PATTERNS_HEAVIER, measured)


def threshold_of(gains: list[float], alpha: float) -> float:
    """Return the gain that data without an effect exceed with probability alpha.

    Beyond the draws the tail is taken as exponential, as that of half a chi-square is.
    """
    ordered = sorted(gains)
    count = len(ordered)
    if alpha * count >= 1.0:
        place = min(count - 1, round((1.0 - alpha) * count))
        return ordered[place]
    median, top = ordered[count // 2], ordered[min(count - 1, int(0.95 * count))]
    rate = (top - median) / math.log(10.0)
    return top + rate * math.log(0.05 / alpha)


BOOTSTRAPS = 100
"""Draws behind an interval or a stability: a share of them is known to 5 %."""

Contest = tuple[Callable[[FloatArray], str | None], Collection[str]]
"""What returns the name that comes first where trajectories count so much (T,), None for none; and
the names that are the same answer."""


def bootstrap_weights(count: int, draws: int, random: np.random.Generator) -> FloatArray:
    """Return (draws, count) how much each of `count` trajectories counts in each draw: uniform on
    all shares, and 1 on average (the Bayesian bootstrap: Rubin 1981).

    Drawing with replacement leaves out a given one of n trajectories in (1 - 1/n)^n of the draws, a
    third: a name that rests on the only slide would be called unstable however clear that slide is,
    and its interval would reach to the end of the range. Here each trajectory counts.
    """
    return np.asarray(count * random.dirichlet(np.ones(count), size=draws))


def stability(contests: Iterable[Contest], repetitions: FloatArray) -> float:
    """Return the share of repetitions (draws, T) that give the same answer in all contests: one of
    each effect that is named, next to the others."""
    same = np.ones(len(repetitions), dtype=bool)
    for winner, accepted in contests:
        same &= [winner(counts) in accepted for counts in repetitions]
    return float(same.mean())
