# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which columns explain whitened residuals: nuisances with priors, effects within their ranges, and
trajectories that may be wrong as a whole.

A trajectory's error has an unknown scale of its own (Student's distribution over trajectories:
Lange, Little and Taylor 1989), so that one press that went wrong, in the measurement or in the
solver, cannot name an effect by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dotsim_ros.io.arrays import FloatArray, IntArray

DOUBT = 0.3
"""Degrees of freedom of a trajectory's scale, as a share of its observables: small trusts no
trajectory to be as good as the others."""
ROUNDS = 25
SETTLED = 1.0e-3


@dataclass(frozen=True)
class Evidence:
    """Whitened data.

    Attributes:
        residual: (n,) measured minus simulated.
        nuisance: (n, q) what a nuisance does when it moves by one deviation of its prior.
        trajectory: (n,) number of the trajectory of each.
    """

    residual: FloatArray
    nuisance: FloatArray
    trajectory: IntArray

    def of(self, trajectories: Sequence[int]) -> Evidence:
        """Return the part of some trajectories, numbered again in the order given."""
        parts = [np.flatnonzero(self.trajectory == t) for t in trajectories]
        rows = np.concatenate(parts)
        numbers = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        return Evidence(self.residual[rows], self.nuisance[rows], numbers)

    def rows_of(self, trajectories: Sequence[int]) -> IntArray:
        """Return the rows that `of` takes."""
        return np.concatenate([np.flatnonzero(self.trajectory == t) for t in trajectories])

    def without(self, change: FloatArray) -> Evidence:
        """Return what is left once a change (n,) is explained."""
        return self.with_residual(self.residual - change)

    def with_nuisances(self, columns: FloatArray) -> Evidence:
        """Return the same with further nuisances (n, K), each of one deviation."""
        return replace(self, nuisance=np.concatenate([self.nuisance, columns], axis=1))

    def with_residual(self, residual: FloatArray) -> Evidence:
        """Return the same with another residual."""
        return replace(self, residual=residual)


@dataclass(frozen=True)
class Fit:
    """The most probable nuisances and sizes.

    Attributes:
        nuisance: (q,) in deviations of their priors.
        size: (k,) of the columns.
        objective: twice the negative log posterior, up to a constant.
        weight: (T,) of the trajectories: how often each counts, for one whose error is as expected.
    """

    nuisance: FloatArray
    size: FloatArray
    objective: float
    weight: FloatArray


def fit(
    evidence: Evidence,
    columns: FloatArray,
    low: FloatArray | None = None,
    high: FloatArray | None = None,
) -> Fit:
    """Return the fit of columns (n, k), each size within its bounds (k,).

    Iteratively reweighted least squares; a size beyond a bound is held at it.
    """
    k = columns.shape[1]
    low = np.full(k, -np.inf) if low is None else low
    high = np.full(k, np.inf) if high is None else high
    design = np.concatenate([evidence.nuisance, columns], axis=1)
    residual, parts = evidence.residual, parts_of(evidence.trajectory)
    known = Products(
        np.stack([design[rows].T @ design[rows] for rows in parts]),
        np.stack([design[rows].T @ residual[rows] for rows in parts]),
        np.array([residual[rows] @ residual[rows] for rows in parts]),
        np.array([float(len(rows)) for rows in parts]),
        np.ones(len(parts)),
    )
    return settle(known, low, high)


@dataclass(frozen=True)
class Products:
    """All that a fit needs of a design D (n, m) and a residual r (n,), by trajectory.

    Attributes:
        gram: (T, m, m) D^T D.
        right: (T, m) D^T r.
        square: (T,) r^T r.
        rows: (T,) of each.
        counts: (T,) how often each counts.
    """

    gram: FloatArray
    right: FloatArray
    square: FloatArray
    rows: FloatArray
    counts: FloatArray


def parts_of(trajectory: IntArray) -> list[IntArray]:
    """Return the rows of each trajectory."""
    return [np.flatnonzero(trajectory == t) for t in range(int(trajectory.max()) + 1)]


def settle(known: Products, low: FloatArray, high: FloatArray) -> Fit:
    """Return the fit of a design whose last columns, as many as there are bounds, are sizes, and
    whose others are nuisances."""
    m = known.right.shape[1]
    q = m - len(low)
    prior = np.concatenate([np.ones(q), np.zeros(len(low))])
    rows, doubt = known.rows, DOUBT * known.rows
    unknown = np.zeros(m)
    weight = known.counts
    last = np.inf
    for _ in range(ROUNDS):
        gram = np.tensordot(weight, known.gram, axes=1) + np.diag(prior)
        unknown = _bounded(gram, weight @ known.right, q, low, high)
        left = known.square - 2.0 * known.right @ unknown + (known.gram @ unknown) @ unknown
        square = np.maximum(left, 0.0)
        scale = (doubt + square) / (doubt + rows)
        weight = known.counts / scale
        by_trajectory = (doubt + rows) * np.log(scale)
        objective = float(known.counts @ by_trajectory + unknown[:q] @ unknown[:q])
        if last - objective < SETTLED:
            break
        last = objective
    return Fit(unknown[:q], unknown[q:], objective, weight)


def fit_nuisances(evidence: Evidence) -> Fit:
    """Return the fit without any column."""
    return fit(evidence, np.zeros((len(evidence.residual), 0)))


def _bounded(
    gram: FloatArray, right: FloatArray, q: int, low: FloatArray, high: FloatArray
) -> FloatArray:
    """Return the solution of gram x = right with the sizes, x[q:], held within bounds."""
    m = len(right)
    ridged = gram.copy()
    # Of each column by itself: a size in small units would hold the nuisances fast.
    diagonal = np.diag(gram)
    ridged.flat[:: m + 1] += 1e-9 * np.where(diagonal > 0.0, diagonal, 1.0)
    held: dict[int, float] = {}
    unknown = np.asarray(np.linalg.solve(ridged, right), dtype=np.float64)
    free = list(range(m))
    for _ in range(m - q + 1):
        if held:
            free = [i for i in range(m) if i not in held]
            unknown = np.zeros(m)
            for i, value in held.items():
                unknown[i] = value
            pushed = right - gram @ unknown
            unknown[free] = np.linalg.solve(ridged[np.ix_(free, free)], pushed[free])
        beyond = [i for i in free if i >= q and not low[i - q] <= unknown[i] <= high[i - q]]
        if not beyond:
            break
        for i in beyond:
            held[i] = float(np.clip(unknown[i], low[i - q], high[i - q]))
    return unknown


def log_evidence(
    evidence: Evidence, found: Fit, columns: FloatArray, precision: FloatArray
) -> float:
    """Return the log of the probability of the data, up to a constant of the data alone, by
    Laplace's approximation about a fit (Kass and Raftery 1995, section 4.1).

    Args:
        evidence: the data.
        found: its fit.
        columns: (n, k) of the fit's sizes.
        precision: (k,) of the sizes' priors, one over their variance.
    """
    design = np.concatenate([evidence.nuisance, columns], axis=1)
    weight = found.weight[evidence.trajectory]
    prior = np.concatenate([np.ones(evidence.nuisance.shape[1]), precision])
    hessian = (design * weight[:, None]).T @ design + np.diag(prior)
    log_prior = float(np.sum(np.log(prior)))
    return -0.5 * (found.objective + float(np.linalg.slogdet(hessian)[1]) - log_prior)


def cosines(evidence: Evidence, columns: FloatArray) -> FloatArray:
    """Return (k, k) the isolability matrix: cosines of columns (n, k) with the nuisances, as far as
    their priors let them move, projected out."""
    nuisance = evidence.nuisance
    middle = np.eye(nuisance.shape[1]) + nuisance.T @ nuisance
    along = nuisance.T @ columns
    inner = columns.T @ columns - along.T @ np.linalg.solve(middle, along)
    length = np.sqrt(np.maximum(np.diag(inner), 1e-30))
    return np.asarray(inner / np.outer(length, length))


def lengths(evidence: Evidence, columns: FloatArray) -> FloatArray:
    """Return (k,) the whitened size of columns (n, k), nuisances projected out as in `cosines`."""
    nuisance = evidence.nuisance
    middle = np.eye(nuisance.shape[1]) + nuisance.T @ nuisance
    along = nuisance.T @ columns
    inner = np.sum(columns**2, axis=0) - np.sum(along * np.linalg.solve(middle, along), axis=0)
    return np.asarray(np.sqrt(np.maximum(inner, 0.0)))


def draw_null(evidence: Evidence, random: np.random.Generator) -> FloatArray:
    """Return a residual (n,) of data without any effect."""
    noise = random.standard_normal(len(evidence.residual))
    moved = random.standard_normal(evidence.nuisance.shape[1])
    return np.asarray(noise + evidence.nuisance @ moved)
