# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What simpler methods make of the cases of the gap finder's study.

Recalibration alone and a black-box correction name nothing: what they leave of trajectories that
they were not fitted to is compared. The lasso (Tibshirani 1996) names the effect of its largest
coefficient, on the same whitened columns that the finder screens; the Bayesian information
criterion (Schwarz 1978) the single effect that it prefers, if it prefers one to none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from dotsim_ros.gap import decision
from dotsim_ros.gap.presses.evidence import Case, Segment
from dotsim_ros.gap.presses.inference import Evidence, draw_null, fit_nuisances
from dotsim_ros.gap.presses.locate import change_by_trajectory
from dotsim_ros.gap.presses.search_state import PATTERN_DEVIATION, Ranked, Search
from dotsim_ros.io.arrays import FloatArray

LASSO_NULLS = 100


@dataclass(frozen=True)
class Left:
    """Mean square of the whitened residuals of trajectories that nothing was fitted to: 1 where
    only what is expected is left.

    Attributes:
        recalibrated: with the twin's constants fitted.
        black_box: with a smooth correction by phase and region fitted next to them.
        with_effects: with the named effects next to them; as recalibrated where none was named.
        nothing_hidden: recalibrated, before the effect was hidden.
    """

    recalibrated: float
    black_box: float
    with_effects: float
    nothing_hidden: float


def left_on_others(
    search: Search, named: Sequence[Ranked], others: Sequence[int], nothing_hidden: Case
) -> Left:
    """Return what each method leaves.

    Args:
        search: the case.
        named: effects that the finder named.
        others: numbers of trajectories that were not searched.
        nothing_hidden: the case without the hidden effect.
    """
    case, evidence = search.case, search.evidence
    tested = case.evidence(others)
    count = evidence.nuisance.shape[1]
    widened = fit_nuisances(evidence.with_nuisances(search.pattern_columns)).nuisance
    patterns = PATTERN_DEVIATION * case.pattern_columns(others) @ widened[count:]
    change = change_by_trajectory(search, named)
    refitted = fit_nuisances(evidence.without(case.whitened(change, search.chosen)))
    before = fit_nuisances(nothing_hidden.evidence(search.chosen))
    return Left(
        _square(tested, search.base.nuisance),
        _square(tested.without(patterns), widened[:count]),
        _square(tested.without(case.whitened(change, others)), refitted.nuisance),
        _square(nothing_hidden.evidence(others), before.nuisance),
    )


def _square(evidence: Evidence, nuisance: FloatArray) -> float:
    return float(np.mean((evidence.residual - evidence.nuisance @ nuisance) ** 2))


def bic_name(search: Search, ranked: Sequence[Ranked]) -> str | None:
    """Return the single effect that the Bayesian information criterion prefers to all others and to
    none; None where it prefers none."""
    price = float(np.log(len(search.evidence.residual)))
    lead = {e.effect.name: e.trial.gain - price * len(e.effect.parameters) for e in ranked}
    best = max(lead, key=lambda name: lead[name])
    return best if lead[best] > 0.0 else None


def lasso_name(search: Search, ranked: Sequence[Ranked]) -> str | None:
    """Return the effect that the lasso finds, None where no coefficient survives.

    Every segment that begins at an absent effect is a column of unit length, nuisances projected
    out as far as their priors let them move; coefficients are positive, since a segment has a side.
    The penalty is the largest that alpha of simulated nulls pass, times the root of the largest
    factor that the finder allows true nulls: scores are squares.
    """
    segments = [
        (entry.effect.name, segment)
        for entry in ranked
        for segment in search.segments(entry.variants)
        if not np.any(segment.offset)
    ]
    evidence = search.evidence
    columns = np.stack([_towards(segment) for _, segment in segments], axis=1)
    middle = np.eye(evidence.nuisance.shape[1]) + evidence.nuisance.T @ evidence.nuisance
    inverse = np.linalg.solve(middle, evidence.nuisance.T @ columns)
    freed = columns - evidence.nuisance @ inverse
    # Of the metric that the nuisances' priors leave: columns^T (1 + N N^T)^-1 columns.
    gram = columns.T @ freed
    length = np.sqrt(np.maximum(np.diag(gram), 1e-12))
    nulls = [
        np.max(freed.T @ draw_null(evidence, search.random) / length) for _ in range(LASSO_NULLS)
    ]
    names = {entry.effect.name for entry in ranked} | set(search.discrepancy.limit_factors)
    factor = max(
        decision.limit_factor(
            name,
            search.discrepancy.limit_factors,
            is_representative=search.discrepancy.is_representative,
        )
        for name in names
    )
    penalty = np.sqrt(factor) * float(np.quantile(nulls, 1.0 - search.request.alpha))
    size = _positive_lasso(
        gram / np.outer(length, length), freed.T @ evidence.residual / length, penalty
    )
    return segments[int(np.argmax(size))][0] if size.max() > 0.0 else None


def _towards(segment: Segment) -> FloatArray:
    """Return the segment's column in the direction that it may go."""
    return segment.column if segment.high > -segment.low else -segment.column


def _positive_lasso(gram: FloatArray, right: FloatArray, penalty: float) -> FloatArray:
    """Return x >= 0 with the least x^T gram x / 2 - right^T x + penalty sum(x)."""
    found = minimize(
        lambda x: (0.5 * x @ gram @ x - (right - penalty) @ x, gram @ x - (right - penalty)),
        np.zeros(len(right)),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, None)] * len(right),
    )
    return np.asarray(found.x)
