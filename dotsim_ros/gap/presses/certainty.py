# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How certain an answer is: intervals, whether its name is stable, and what it is close to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dotsim_ros.arrays import IntArray
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Pair
from dotsim_ros.gap.presses.evidence import Segment
from dotsim_ros.gap.presses.inference import Evidence, fit_nuisances
from dotsim_ros.gap.presses.isolability import pairs_of
from dotsim_ros.gap.presses.screening import best_trial
from dotsim_ros.gap.presses.search_state import Ranked, Search

BOOTSTRAPS = 20
INTERVAL_DRAWS = 100
CHI_SQUARE = 3.84
"""95 % of one degree of freedom."""
EXCESS = 2.0
"""Least factor by which true data exceed what their covariance predicts: intervals without it hold
the truth in 85 % of the cases of a half, where 95 are meant."""
FIRST_STEP = 0.02
HALVINGS = 10
SHOWN = 6
"""So many of the best effects are set against each other."""


def estimates_of(search: Search, entry: Ranked, others: Sequence[Ranked]) -> tuple[Estimate, ...]:
    """Return an effect's parameters. The interval of the first is that of the profile likelihood
    and of a bootstrap over trajectories together, those of others the bootstrap's: the bootstrap
    does not see what all trajectories share, the profile takes the covariances for granted."""
    segments = search.segments(entry.variants)
    change = sum((other.trial.change for other in others), np.zeros(len(search.evidence.residual)))
    sizes, shapes = [], []
    for _ in range(INTERVAL_DRAWS):
        drawn, rows = search.resampled()
        evidence = drawn.without(change[rows])
        base = fit_nuisances(evidence).objective
        trial = best_trial(evidence, [rows_of(s, rows) for s in segments], base)
        sizes.append(trial.size)
        shapes.append(list(trial.variant.shape.values()))
    first = entry.effect.parameters[0]
    size = entry.trial.size
    # True data gain more than simulated ones by such a factor.
    excess = max(EXCESS, search.discrepancy.limit_factors.get(entry.effect.name, EXCESS))
    profiled = profile_ends(
        search.evidence.without(change),
        search.segments([entry.trial.variant]),
        size,
        (first.low, first.high),
        CHI_SQUARE * excess,
    )
    low, high = np.percentile(sizes, [2.5, 97.5]).tolist()
    estimates = [
        Estimate(
            first.name, first.unit, size, min(low, profiled[0], size), max(high, profiled[1], size)
        )
    ]
    for place, parameter in enumerate(entry.effect.parameters[1:]):
        value = entry.trial.variant.shape[parameter.name]
        low, high = np.percentile([s[place] for s in shapes], [2.5, 97.5]).tolist()
        estimates.append(
            Estimate(parameter.name, parameter.unit, value, min(low, value), max(high, value))
        )
    return tuple(estimates)


def profile_ends(
    evidence: Evidence,
    segments: Sequence[Segment],
    size: float,
    bounds: tuple[float, float],
    rise: float,
) -> tuple[float, float]:
    """Return the sizes at which the profile objective has risen from that of the best size, or the
    bounds.

    Args:
        evidence: of other effects, freed.
        segments: of the effect's variant.
        size: the best.
        bounds: of the size.
        rise: of the objective, twice the log likelihood.
    """

    def objective(tried: float) -> float:
        # The segment that holds the size, or the outermost one.
        away = [max(s.begin + s.low - tried, tried - s.begin - s.high, 0.0) for s in segments]
        segment = segments[int(np.argmin(away))]
        change = segment.offset + (tried - segment.begin) * segment.column
        return fit_nuisances(evidence.without(change)).objective

    allowed = objective(size) + rise
    found = []
    for end in bounds:
        inside, outside = size, size + FIRST_STEP * (end - size)
        while abs(outside - size) < abs(end - size) and objective(outside) < allowed:
            inside, outside = outside, outside + 2.0 * (outside - inside)
        if abs(outside - size) >= abs(end - size):
            outside = end
            if objective(end) < allowed:
                inside = end
        for _ in range(HALVINGS):
            middle = 0.5 * (inside + outside)
            inside, outside = (middle, outside) if objective(middle) < allowed else (inside, middle)
        found.append(0.5 * (inside + outside))
    return found[0], found[1]


def stability_of(search: Search, ranked: Sequence[Ranked], name: str) -> float:
    """Return the share of bootstrap repetitions over trajectories that find the same effect."""
    groups = {e.effect.name: search.segments(e.variants) for e in ranked[:SHOWN]}
    same = 0
    for _ in range(BOOTSTRAPS):
        evidence, rows = search.resampled()
        base = fit_nuisances(evidence).objective
        gains = {
            other: best_trial(evidence, [rows_of(s, rows) for s in group], base).gain
            for other, group in groups.items()
        }
        same += max(gains, key=lambda other: gains[other]) == name
    return same / BOOTSTRAPS


def close_pairs(search: Search, ranked: Sequence[Ranked]) -> tuple[Pair, ...]:
    """Return the pairs of the best effects that are close to each other."""
    top = [e for e in ranked[:SHOWN] if np.any(e.trial.change)]
    if len(top) < 2:
        return ()
    columns = np.stack([entry.trial.change for entry in top], axis=1)
    recordings = [search.case.trajectories[k].recording for k in search.chosen]
    pairs = pairs_of(search.evidence, [e.effect for e in top], columns, recordings)
    return tuple(
        p for p in pairs if p.separation < decision.APART or abs(p.cosine) > decision.ALIKE
    )


def rows_of(segment: Segment, rows: IntArray) -> Segment:
    return replace(segment, offset=segment.offset[rows], column=segment.column[rows])
