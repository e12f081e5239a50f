"""How certain an answer is: intervals, whether its name is stable, and what it is close to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gap import decision
from dotsim_ros.gap.evidence import Segment
from dotsim_ros.gap.findings import Estimate, Pair
from dotsim_ros.gap.inference import fit_nuisances
from dotsim_ros.gap.isolability import pairs_of
from dotsim_ros.gap.screening import best_trial
from dotsim_ros.gap.search_state import Ranked, Search

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

BOOTSTRAPS = 20
INTERVAL_DRAWS = 100
SHOWN = 6
"""So many of the best effects are set against each other."""


def estimates_of(search: Search, entry: Ranked, others: Sequence[Ranked]) -> tuple[Estimate, ...]:
    """Return an effect's parameters, intervals by a bootstrap over trajectories."""
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
    low, high = np.percentile(sizes, [2.5, 97.5]).tolist()
    size = entry.trial.size
    estimates = [Estimate(first.name, first.unit, size, min(low, size), max(high, size))]
    for place, parameter in enumerate(entry.effect.parameters[1:]):
        value = entry.trial.variant.shape[parameter.name]
        low, high = np.percentile([s[place] for s in shapes], [2.5, 97.5]).tolist()
        estimates.append(
            Estimate(parameter.name, parameter.unit, value, min(low, value), max(high, value))
        )
    return tuple(estimates)


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
