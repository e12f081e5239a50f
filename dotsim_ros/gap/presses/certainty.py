# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How certain an answer is: intervals, whether its name is stable, which effects the protocols
distinguish, and which trajectory does so best (step 7 of the method)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.effect import Effect
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Pair
from dotsim_ros.gap.presses.evidence import Segment
from dotsim_ros.gap.presses.inference import Evidence, cosines, fit_nuisances, lengths
from dotsim_ros.gap.presses.screening import Screen
from dotsim_ros.gap.presses.search_state import Ranked, Search
from dotsim_ros.io.arrays import FloatArray

CHI_SQUARE = 3.84
"""95 % of one degree of freedom."""
EXCESS = 2.0
"""Least factor by which true data exceed what their covariance predicts: intervals without it hold
the truth in 85 % of the cases of a half, where 95 are meant."""
FIRST_STEP = 0.02
"""Of the way from the best size to the end of its range."""
HALVINGS = 10
SHOWN = 6
"""So many of the best effects are set against each other."""


def estimates_of(search: Search, entry: Ranked, others: Sequence[Ranked]) -> tuple[Estimate, ...]:
    """Return an effect's parameters. The interval of the first is that of the profile likelihood
    and of a bootstrap over trajectories together, those of others the bootstrap's: the bootstrap
    does not see what all trajectories share, the profile takes the covariances for granted."""
    segments = search.segments(entry.variants)
    change = sum((other.trial.change for other in others), np.zeros(len(search.evidence.residual)))
    evidence = search.evidence.without(change)
    screen = Screen(evidence, segments)
    sizes, shapes = [], []
    for counts in search.bootstraps:
        _, gains, tried = screen.tries(evidence.residual, counts)
        best = int(np.argmax(gains))
        sizes.append(tried[best])
        shapes.append(list(segments[best].variant.shape.values()))
    first = entry.effect.parameters[0]
    size = entry.trial.size
    # True data gain more than simulated ones by such a factor.
    excess = max(EXCESS, search.discrepancy.limit_factors.get(entry.effect.name, EXCESS))
    profiled = profile_ends(
        evidence,
        search.segments([entry.trial.variant]),
        size,
        (first.low, first.high),
        CHI_SQUARE * excess,
    )
    low, high = np.percentile(sizes, [2.5, 97.5]).tolist()
    found = (size, min(low, profiled[0], size), max(high, profiled[1], size))
    # A sum of a node and a step may miss the end of the range, where the sensor refuses it, by one
    # rounding.
    estimates = [Estimate(first.name, first.unit, *np.clip(found, first.low, first.high).tolist())]
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
        reach = end - size
        # As shares of the way to the end, which may be too short to be divided.
        inside, outside = 0.0, FIRST_STEP
        while outside < 1.0 and objective(size + outside * reach) < allowed:
            inside, outside = outside, outside + 2.0 * (outside - inside)
        if outside >= 1.0:
            outside = 1.0
            if objective(end) < allowed:
                inside = 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (inside + outside)
            is_inside = objective(size + middle * reach) < allowed
            inside, outside = (middle, outside) if is_inside else (inside, middle)
        found.append(size + 0.5 * (inside + outside) * reach)
    return found[0], found[1]


def stability_of(
    search: Search,
    ranked: Sequence[Ranked],
    named: Sequence[Ranked],
    alternatives: Sequence[Ranked] = (),
) -> float:
    """Return the share of bootstrap repetitions over trajectories that give the same answer.

    Of the effects past their limits the one that gains most is the one that is named, or one of
    the set; of two named, each is that next to the other.
    """
    shown = _names(ranked[:SHOWN])
    answers = [entry for entry in (*named, *alternatives) if entry.effect.name not in shown]
    contest = [*ranked[:SHOWN], *answers]
    segments: list[Segment] = []
    owners: list[Ranked] = []
    for entry in contest:
        for segment in search.segments(entry.variants):
            segments.append(segment)
            owners.append(entry)

    def contested(entry: Ranked) -> decision.Contest:
        others = [other for other in named if other is not entry]
        taken = _names(others)
        evidence = search.evidence
        for other in others:
            evidence = evidence.without(other.trial.change)
        free = [k for k, owner in enumerate(owners) if owner.effect.name not in taken]
        screen = Screen(evidence, [segments[k] for k in free])
        limits = np.array([owners[k].limit for k in free])

        def winner(counts: FloatArray) -> str | None:
            _, gains, _ = screen.tries(evidence.residual, counts)
            gains[gains <= limits] = 0.0
            best = int(np.argmax(gains))
            return owners[free[best]].effect.name if gains[best] > 0.0 else None

        return winner, {entry.effect.name, *_names(alternatives)}

    return decision.stability([contested(entry) for entry in named], search.bootstraps)


def _names(entries: Sequence[Ranked]) -> set[str]:
    return {entry.effect.name for entry in entries}


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


def pairs_of(
    evidence: Evidence,
    effects: Sequence[Effect],
    columns: FloatArray,
    recordings: Sequence[Recording],
) -> tuple[Pair, ...]:
    """Return every pair of effects.

    Args:
        evidence: whose nuisances are projected out.
        effects: k of them.
        columns: (n, k) whitened change by each.
        recordings: of the evidence's trajectories, in order.
    """
    apart = _separations(evidence, columns)
    rho = cosines(evidence, columns)
    duration_s = np.array([float(np.ptp(r.press.stamp_s)) for r in recordings])
    by_trajectory = np.stack(
        [
            _separations(evidence.of([t]), columns[evidence.rows_of([t])])
            for t in range(len(recordings))
        ]
    )
    per_second = by_trajectory / duration_s[:, None, None]
    pairs = []
    for i, first in enumerate(effects):
        for j, second in enumerate(effects[i + 1 :], start=i + 1):
            best = int(np.argmax(per_second[:, i, j]))
            pairs.append(
                Pair(
                    first.name,
                    second.name,
                    float(rho[i, j]),
                    float(apart[i, j]),
                    "; or ".join(dict.fromkeys((first.protocol, second.protocol))),
                    recordings[best].name,
                    float(per_second[best, i, j]),
                )
            )
    return tuple(pairs)


def _separations(evidence: Evidence, columns: FloatArray) -> FloatArray:
    """Return (k, k) d = delta sqrt((1 - |rho|) / 2), delta being the larger of the two sizes."""
    size, rho = lengths(evidence, columns), cosines(evidence, columns)
    delta = np.maximum(size[:, None], size[None, :])
    return np.asarray(delta * np.sqrt(np.maximum(1.0 - np.abs(rho), 0.0) / 2.0))
