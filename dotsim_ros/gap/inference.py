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
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

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

    residual: Array
    nuisance: Array
    trajectory: IntArray

    def of(self, trajectories: Sequence[int]) -> Evidence:
        """Return the part of some trajectories, numbered anew in the order given."""
        parts = [np.flatnonzero(self.trajectory == t) for t in trajectories]
        rows = np.concatenate(parts)
        numbers = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        return Evidence(self.residual[rows], self.nuisance[rows], numbers)

    def rows_of(self, trajectories: Sequence[int]) -> IntArray:
        """Return the rows that `of` takes."""
        return np.concatenate([np.flatnonzero(self.trajectory == t) for t in trajectories])

    def with_residual(self, residual: Array) -> Evidence:
        """Return the same with another residual."""
        return replace(self, residual=residual)


@dataclass(frozen=True)
class Fit:
    """The most probable nuisances and sizes.

    Attributes:
        nuisance: (q,) in deviations of their priors.
        size: (k,) of the columns.
        objective: twice the negative log posterior, up to a constant.
        weight: (T,) of the trajectories, 1 for one whose error is as expected.
    """

    nuisance: Array
    size: Array
    objective: float
    weight: Array


def fit(
    evidence: Evidence,
    columns: Array,
    low: Array | None = None,
    high: Array | None = None,
) -> Fit:
    """Return the fit of columns (n, k), each size within its bounds (k,).

    Iteratively reweighted least squares; a size beyond a bound is held at it.
    """
    q = evidence.nuisance.shape[1]
    k = columns.shape[1]
    low = np.full(k, -np.inf) if low is None else low
    high = np.full(k, np.inf) if high is None else high
    design = np.concatenate([evidence.nuisance, columns], axis=1)
    prior = np.concatenate([np.ones(q), np.zeros(k)])
    trajectories = int(evidence.trajectory.max()) + 1
    count = np.bincount(evidence.trajectory, minlength=trajectories).astype(float)
    doubt = DOUBT * count
    starts = _grams(design, evidence, trajectories)
    unknown = np.zeros(q + k)
    weight = np.ones(trajectories)
    last = np.inf
    for _ in range(ROUNDS):
        gram = np.tensordot(weight, starts[0], axes=1) + np.diag(prior)
        right = weight @ starts[1]
        unknown = _bounded(gram, right, q, low, high)
        square = _squares(starts, unknown)
        weight = (doubt + count) / (doubt + square)
        objective = _objective(square, count, doubt, unknown[:q])
        if last - objective < SETTLED:
            break
        last = objective
    return Fit(unknown[:q], unknown[q:], objective, weight)


Grams = tuple[Array, Array, Array]


def _grams(design: Array, evidence: Evidence, trajectories: int) -> Grams:
    """Return, by trajectory, D^T D (T, m, m), D^T r (T, m) and r^T r (T,)."""
    m = design.shape[1]
    gram, right = np.zeros((trajectories, m, m)), np.zeros((trajectories, m))
    square = np.zeros(trajectories)
    for t in range(trajectories):
        rows = evidence.trajectory == t
        part, residual = design[rows], evidence.residual[rows]
        gram[t], right[t], square[t] = part.T @ part, part.T @ residual, residual @ residual
    return gram, right, square


def _squares(grams: Grams, unknown: Array) -> Array:
    """Return (T,) the squares that are left."""
    gram, right, square = grams
    left = square - 2.0 * right @ unknown + np.einsum("tij,i,j->t", gram, unknown, unknown)
    return np.asarray(np.maximum(left, 0.0))


def _objective(square: Array, count: Array, doubt: Array, nuisance: Array) -> float:
    scale = (doubt + count) * np.log((doubt + square) / (doubt + count))
    return float(scale.sum() + nuisance @ nuisance)


def _bounded(gram: Array, right: Array, q: int, low: Array, high: Array) -> Array:
    """Return the solution of gram x = right with the sizes, x[q:], held within bounds."""
    m = len(right)
    ridge = 1e-9 * np.trace(gram) / m * np.eye(m)
    held: dict[int, float] = {}
    unknown = np.zeros(m)
    for _ in range(m - q + 1):
        free = [i for i in range(m) if i not in held]
        unknown = np.zeros(m)
        for i, value in held.items():
            unknown[i] = value
        pushed = right - gram @ unknown
        unknown[free] = np.linalg.solve((gram + ridge)[np.ix_(free, free)], pushed[free])
        beyond = [i for i in free if i >= q and not low[i - q] <= unknown[i] <= high[i - q]]
        if not beyond:
            break
        for i in beyond:
            held[i] = float(np.clip(unknown[i], low[i - q], high[i - q]))
    return unknown


def objective_at(evidence: Evidence, columns: Array, size: Array, nuisance: Array) -> Array:
    """Return (T,) the objective of each trajectory at given sizes and nuisances, without prior."""
    left = evidence.residual - evidence.nuisance @ nuisance - columns @ size
    count = np.bincount(evidence.trajectory).astype(float)
    square = np.bincount(evidence.trajectory, weights=left**2)
    doubt = DOUBT * count
    return np.asarray((doubt + count) * np.log((doubt + square) / (doubt + count)))


def cosines(evidence: Evidence, columns: Array) -> Array:
    """Return (k, k) the isolability matrix: cosines of columns (n, k) with the nuisances, as far as
    their priors let them move, projected out."""
    nuisance = evidence.nuisance
    middle = np.eye(nuisance.shape[1]) + nuisance.T @ nuisance
    along = nuisance.T @ columns
    inner = columns.T @ columns - along.T @ np.linalg.solve(middle, along)
    length = np.sqrt(np.maximum(np.diag(inner), 1e-30))
    return np.asarray(inner / np.outer(length, length))


def lengths(evidence: Evidence, columns: Array) -> Array:
    """Return (k,) the whitened size of columns (n, k), nuisances projected out as in `cosines`."""
    nuisance = evidence.nuisance
    middle = np.eye(nuisance.shape[1]) + nuisance.T @ nuisance
    along = nuisance.T @ columns
    inner = np.sum(columns**2, axis=0) - np.sum(along * np.linalg.solve(middle, along), axis=0)
    return np.asarray(np.sqrt(np.maximum(inner, 0.0)))


def draw_null(evidence: Evidence, random: np.random.Generator) -> Array:
    """Return a residual (n,) of data without any effect."""
    noise = random.standard_normal(len(evidence.residual))
    moved = random.standard_normal(evidence.nuisance.shape[1])
    return np.asarray(noise + evidence.nuisance @ moved)
