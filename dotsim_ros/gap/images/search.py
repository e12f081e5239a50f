# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which optical effect explains how measured images differ from the twin's: a score of each.

Observables, signatures and nuisances are whitened by the covariance of tiles (`TileNoise`) and
freed from the nuisances: those without a prior are projected out, those with one weigh as a normal
distribution of their size. Effects are ranked by how much of the squared residual their signature
takes away, each parameter kept within its range; the penalty of a parameter and of a choice between
probes is that of Akaike ("A new look at the statistical model identification", IEEE Transactions on
Automatic Control 19(6), 1974).

Whether the first is more than the model's own error is another question: a small error that all
tiles share looks like a small effect, and many frames make it significant. So each effect is fitted
to trajectories in which nothing is wrong, one by one. The variance of these spurious sizes beyond
their sampling error (by the estimator of Paule and Mandel, "Consensus values and weighting
factors", Journal of Research of the National Bureau of Standards 87(5), 1982) is added to that of
the size found, as if the error were the same in all trajectories. It is estimated from few
trajectories: the statistic's threshold is that of Student's distribution, drawn with the
signatures' products alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from dotsim_ros.effects.effect import Active, Effect, EffectParameter
from dotsim_ros.gap import decision
from dotsim_ros.gap.images.model import Film
from dotsim_ros.gap.images.tile_noise import TileNoise
from dotsim_ros.gap.images.tiles import COLOURS, NAMES, SHARPNESS, TileMeter, TileReference
from dotsim_ros.io.arrays import FloatArray

OFFSET_LEVELS = 0.5
"""Deviation of the camera's black level, grey levels: its prior. Ambient light is more."""

THRESHOLD_DRAWS = 2000
"""Residuals without any effect that are drawn for a threshold."""

Spurious = Mapping[str, Sequence[FloatArray]]
"""Variance of the spurious size along each direction of each signature, by effect."""

LEAST_SPURIOUS = 0.002
"""The model's error of a size deviates by no less than this share of the parameter's range, however
little a few trajectories show: smaller effects are of no interest."""

_TINY = 1e-12

LEAST_NORM = 1.0
"""A signature that is shorter, whitened, at its probe, is not excited by the data."""


@dataclass(frozen=True)
class Direction:
    """One parameter of an effect, over the step that its signature was made with.

    Attributes:
        name: of the parameter.
        none: where the effect is absent.
        step: from there to the probe.
        low, high: range of the parameter.
    """

    name: str
    none: float
    step: float
    low: float
    high: float

    def bounds(self) -> tuple[float, float]:
        """Return the least and the largest multiple of the step."""
        ends = sorted(((self.low - self.none) / self.step, (self.high - self.none) / self.step))
        return ends[0], ends[1]


@dataclass(frozen=True)
class Signature:
    """What an effect does to the observables, to first order about a probe.

    Attributes:
        directions: P of them; the first is the effect's size.
        shape: values of the parameters that have no such direction.
        blocks: of each trajectory (F, T, 6, P).
    """

    directions: tuple[Direction, ...]
    shape: Mapping[str, float]
    blocks: Sequence[FloatArray]


@dataclass(frozen=True)
class CameraNuisance:
    """What may differ without anything missing.

    Attributes:
        name: of it.
        blocks: of each trajectory (F, T, 6), what one unit of it does.
        deviation: of its size; infinite where nothing is known of it.
    """

    name: str
    blocks: tuple[FloatArray, ...]
    deviation: float


@dataclass(frozen=True)
class EffectScore:
    """How well one effect explains the residual.

    Attributes:
        name: of the effect.
        fit: what it takes off the squared, whitened residual, less the penalty of its freedom; 0
            where the data do not excite it.
        statistic: the square of its size over what noise and the model's error leave of it, less
            the penalty; compare it with `OpticalSearch.threshold`.
        norm: its size over what noise and the model's error leave of it, delta.
        explained: share that it takes off the squared residual beyond what noise leaves: 1 where
            no more than noise is left.
        values: of all its parameters, at the best probe.
        is_excited: whether the data show it at all.
    """

    name: str
    fit: float
    statistic: float
    norm: float
    explained: float
    values: Mapping[str, float]
    is_excited: bool


def probes_of(effect: Effect) -> list[tuple[tuple[Direction, ...], dict[str, float]]]:
    """Return the directions and the shape of each probe of an effect.

    The first parameter takes each of its probes, and so does each that shapes the effect; other
    parameters that can be absent take their first probe that is not.
    """
    size, *others = effect.parameters
    shapes = [p for p in others if p.none is None]
    more = tuple(_direction(p, p.probes) for p in others if p.none is not None)
    found = []
    for probe in size.probes:
        for values in product(*(p.probes for p in shapes)):
            shape = {p.name: value for p, value in zip(shapes, values, strict=True)}
            found.append(((_direction(size, (probe,)), *more), shape))
    return found


def _direction(parameter: EffectParameter, probes: Sequence[float]) -> Direction:
    assert parameter.none is not None
    steps = [probe - parameter.none for probe in probes if probe != parameter.none]
    if not steps:
        raise ValueError(
            f"parameter {parameter.name!r} is probed at {list(probes)}, where it is absent; give "
            "it a probe at which it acts"
        )
    return Direction(parameter.name, float(parameter.none), steps[0], parameter.low, parameter.high)


def signatures_of(
    effects: Iterable[Effect], films: Iterable[Film], meter: TileMeter
) -> dict[str, tuple[Signature, ...]]:
    """Return the signatures of effects by name; films are taken one at a time."""
    optical = [effect for effect in effects if effect.image is not None]
    blocks: dict[str, list[list[FloatArray]]] = {effect.name: [] for effect in optical}
    for film in films:
        references = meter.references(film.pixels)
        for effect in optical:
            blocks[effect.name].append(_blocks(effect, film, meter, references))
    return {
        effect.name: tuple(
            Signature(directions, shape, several)
            for (directions, shape), *several in zip(
                probes_of(effect), *blocks[effect.name], strict=True
            )
        )
        for effect in optical
    }


def _blocks(
    effect: Effect, film: Film, meter: TileMeter, references: Sequence[TileReference]
) -> list[FloatArray]:
    """Return what each probe of an effect does to one trajectory, (F, T, 6, P) each."""
    probes = probes_of(effect)
    films = []
    for directions, shape in probes:
        none = {d.name: d.none for d in directions}
        for d in directions:
            values = effect.checked({**none, **shape, d.name: d.none + d.step})
            films.append(film.with_effects([Active(effect, values)]))
    found = iter(meter.differences(films, references))
    return [np.stack([next(found) for _ in directions], axis=-1) for directions, _ in probes]


def camera_nuisances(films: Iterable[Film], meter: TileMeter) -> tuple[CameraNuisance, ...]:
    """Return the gain of the camera, free, and its black level, within `OFFSET_LEVELS`.

    One of each for the whole data set. A free black level would hide ambient light, which is alike
    but for its size.
    """
    gain, offset = [], []
    for film in films:
        block = np.zeros((len(film.pixels), len(meter.grid), len(NAMES)))
        block[..., COLOURS] = meter.colour(film.pixels)
        block[..., SHARPNESS] = meter.sharpness(film.pixels)
        gain.append(block)
        level = np.zeros_like(block)
        level[..., COLOURS] = 1.0
        offset.append(level)
    return (
        CameraNuisance("gain", tuple(gain), np.inf),
        CameraNuisance("black level", tuple(offset), OFFSET_LEVELS),
    )


class _Part(NamedTuple):
    """The columns of a signature of an effect, the variances of its sizes that the model's error
    gives, and what its freedom takes from its gain."""

    name: str
    signature: Signature
    columns: slice
    spurious: FloatArray
    penalty: float


class OpticalSearch:
    """Scores optical effects on the images of one set of trajectories.

    What the residual does not enter is worked out once.

    Args:
        signatures: of the effects by name, in blocks of the trajectories' order.
        noise: covariance of the observables.
        nuisances: that explain nothing.
        changes: (F, T, 6) of each trajectory, `contact_change` of its prediction.
        spurious: variances of the sizes that the model's error gives effects, as
            `spurious_variances` of trajectories without any effect returns them; None for none.
    """

    def __init__(
        self,
        signatures: Mapping[str, Sequence[Signature]],
        noise: TileNoise,
        nuisances: Sequence[CameraNuisance],
        changes: Sequence[FloatArray],
        spurious: Spurious | None = None,
    ) -> None:
        self._noise, self._changes = noise, tuple(changes)
        self._parts: list[_Part] = []
        end = 0
        for name, several in signatures.items():
            for number, one in enumerate(several):
                count = len(one.directions)
                begin, end = end, end + count
                known = np.zeros(count) if spurious is None else spurious[name][number]
                penalty = 2.0 * count + 2.0 * math.log(len(several))
                self._parts.append(_Part(name, one, slice(begin, end), known, penalty))
        self._raw = self._whitened([part.signature.blocks for part in self._parts])
        self._nuisances = self._whitened([tuple(b[..., None] for b in n.blocks) for n in nuisances])
        self._deviations = np.array([n.deviation for n in nuisances])
        self._ends = np.concatenate([[0], np.cumsum([change.size for change in self._changes])])
        self._free = _without(self._nuisances, self._deviations)
        self._columns = self._free(self._raw)
        self._gram = self._columns.T @ self._columns

    def _whitened(self, blocks: Sequence[Sequence[FloatArray]]) -> FloatArray:
        """Return (N, P) of several sets of blocks (F, T, 6, p), side by side."""
        rows = [
            self._noise.whiten(np.concatenate(values, axis=-1), change)
            for change, *values in zip(self._changes, *blocks, strict=True)
        ]
        return np.concatenate(rows)

    def whitened(self, residual: Sequence[FloatArray]) -> FloatArray:
        """Return (N,) a residual, (F, T, 6) of each trajectory, whitened and free of nuisances."""
        return self._free(self._whitened([tuple(r[..., None] for r in residual)]))[:, 0]

    def apart(self, values: Mapping[str, float], others: Mapping[str, float]) -> float:
        """Return how far apart two sizes of the only signature are: the square of it, over what
        noise and the model's error leave of it.
        """
        (part,) = self._parts
        directions = part.signature.directions
        steps = np.array([(values[d.name] - others[d.name]) / d.step for d in directions])
        return float(steps @ _weight(self._gram, part.spurious) @ steps)

    def score(self, residual: Sequence[FloatArray]) -> list[EffectScore]:
        """Return the scores of all effects, best first.

        Args:
            residual: (F, T, 6) of each trajectory, measured against predicted.
        """
        whitened = self.whitened(residual)
        beyond = float(whitened @ whitened) - len(whitened)
        return self._scores(self._gram, self._columns.T @ whitened, beyond)

    def products(self, residual: Sequence[FloatArray]) -> FloatArray:
        """Return (K, M, M) the products of signatures, nuisances and residual of each trajectory:
        what `score_products` takes, summed over any of them."""
        rows = np.concatenate(
            [
                self._raw,
                self._nuisances,
                self._whitened([tuple(r[..., None] for r in residual)]),
            ],
            axis=1,
        )
        parts = [rows[a:b] for a, b in zip(self._ends[:-1], self._ends[1:], strict=True)]
        return np.stack([part.T @ part for part in parts])

    def score_products(self, products: FloatArray) -> list[EffectScore]:
        """Return the scores of all effects, best first, of trajectories that count by shares.

        Args:
            products: (M, M) sum of `products` over trajectories, each times its share.
        """
        count = self._raw.shape[1]
        nuisances = slice(count, count + len(self._deviations))
        kept = [*range(count), len(products) - 1]
        square = products[nuisances, nuisances] + np.diag(self._deviations**-2.0)
        across = products[nuisances][:, kept]
        left = products[np.ix_(kept, kept)] - across.T @ np.linalg.pinv(square) @ across
        # How many numbers there are plays no part in sizes.
        return self._scores(left[:-1, :-1], left[:-1, -1], float(left[-1, -1]))

    def spurious_variances(self, residuals: Sequence[FloatArray]) -> Spurious:
        """Return the variances of the sizes that effects seem to have where there is none.

        Args:
            residuals: (F, T, 6) of each trajectory, in which nothing is wrong.
        """
        alone = [self._alone(number, residuals) for number in range(len(self._changes))]
        whole = (self._columns.T @ self.whitened(residuals), np.diag(self._gram))
        # Each trajectory by itself, and all together: an error that all share shows there.
        right, square = map(np.array, zip(*alone, whole, strict=True))
        variance = _variance_beyond(right, square)
        found: dict[str, list[FloatArray]] = {}
        for part in self._parts:
            directions = part.signature.directions
            least = [LEAST_SPURIOUS * (d.high - d.low) / d.step for d in directions]
            own = np.maximum(variance[part.columns], np.square(least))
            found.setdefault(part.name, []).append(own)
        return found

    def _alone(self, number: int, residuals: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Return the products of the columns with one trajectory's residual, and their squares,
        freed from the nuisances of this trajectory."""
        part = slice(self._ends[number], self._ends[number + 1])
        free = _without(self._nuisances[part], self._deviations)
        columns = free(self._raw[part])
        change = self._changes[number]
        residual = free(self._noise.whiten(residuals[number][..., None], change))[:, 0]
        return columns.T @ residual, np.sum(columns**2, axis=0)

    def null_statistics(self, count: int, seed: int) -> FloatArray:
        """Return (count,) the largest statistic of each of so many residuals without any effect."""
        random = np.random.default_rng(seed)
        value, vector = np.linalg.eigh(self._gram)
        root = vector * np.sqrt(np.maximum(value, 0.0))
        draws = random.standard_normal((count, len(value))) @ root.T
        # Student's: the variances are estimated from so many trajectories.
        freedom = self._noise.trajectory_count
        draws /= np.sqrt(random.chisquare(freedom, (count, 1)) / freedom)
        # Noise over its own deviation has this distribution whatever part of it is the model's.
        gain = {part.name: np.zeros(count) for part in self._parts}
        statistic = {part.name: np.zeros(count) for part in self._parts}
        for name, signature, columns, _, penalty in self._parts:
            gram, right = self._gram[columns, columns], draws[:, columns]
            if not _is_excited(gram):
                continue
            bounds = [d.bounds() for d in signature.directions]
            if len(bounds) == 1:
                size = np.clip(right / gram[0, 0], *bounds[0])
            else:
                size = np.stack([bounded_size(gram, one, bounds) for one in right])
            square = np.einsum("np,pq,nq->n", size, gram, size)
            own = 2.0 * np.sum(size * right, axis=1) - square
            better = own > gain[name]
            gain[name][better] = own[better]
            statistic[name][better] = square[better] - penalty
        return np.maximum(np.max(list(statistic.values()), axis=0), 0.0)

    def threshold(self, alpha: float, *, seed: int = 0) -> float:
        """Return the statistic that a share alpha of data sets without any effect exceeds."""
        return float(np.quantile(self.null_statistics(THRESHOLD_DRAWS, seed), 1.0 - alpha))

    def likeness(self) -> dict[frozenset[str], float]:
        """Return how alike each two effects look in these data: the largest cosine, 0 to 1, between
        their signatures; of excited ones alone."""
        bases: dict[str, list[FloatArray]] = {}
        for part in self._parts:
            left, value, _ = np.linalg.svd(self._columns[:, part.columns], full_matrices=False)
            if np.any(value > LEAST_NORM):
                bases.setdefault(part.name, []).append(left[:, value > LEAST_NORM])
        return {
            frozenset((first, second)): max(
                float(np.linalg.norm(a.T @ b, ord=2)) for a in bases[first] for b in bases[second]
            )
            for first, second in combinations(bases, 2)
        }

    def alike(self, scores: Sequence[EffectScore]) -> list[str]:
        """Return the effects that the data cannot distinguish from the best one, the best first."""
        best, *others = scores
        cosines = self.likeness()

        def separation(score: EffectScore) -> float:
            # Of a pair without a cosine, one does not show.
            cosine = cosines.get(frozenset((best.name, score.name)), -np.inf)
            return best.norm * math.sqrt(max(1.0 - cosine, 0.0) / 2.0)

        return [best.name, *(s.name for s in others if separation(s) < decision.APART)]

    def _scores(self, gram: FloatArray, right: FloatArray, beyond: float) -> list[EffectScore]:
        """Return scores, best fit first.

        Args:
            gram: (P, P) products of the columns.
            right: (P,) products of the columns with a residual.
            beyond: how much the residual's square exceeds that of noise.
        """
        best: dict[str, EffectScore] = {}
        for part in self._parts:
            own = part.columns
            score = _score(part, gram[own, own], right[own], beyond)
            if part.name not in best or score.fit > best[part.name].fit:
                best[part.name] = score
        return sorted(best.values(), key=lambda one: -one.fit)


def _score(part: _Part, gram: FloatArray, right: FloatArray, beyond: float) -> EffectScore:
    directions = part.signature.directions
    values = {**part.signature.shape, **{d.name: d.none for d in directions}}
    if not _is_excited(gram):
        return EffectScore(part.name, 0.0, 0.0, 0.0, 0.0, values, False)
    size = bounded_size(gram, right, [d.bounds() for d in directions])
    gain = float(2.0 * size @ right - size @ gram @ size)
    values |= {
        d.name: min(max(d.none + float(s) * d.step, d.low), d.high)
        for d, s in zip(directions, size, strict=True)
    }
    square = float(size @ _weight(gram, part.spurious) @ size)
    return EffectScore(
        part.name,
        max(gain - part.penalty, 0.0),
        max(square - part.penalty, 0.0),
        math.sqrt(max(square, 0.0)),
        gain / max(beyond, gain, _TINY),
        values,
        True,
    )


def _is_excited(gram: FloatArray) -> bool:
    """Return whether the data show a signature of these products (P, P) at all."""
    return float(np.sqrt(np.diag(gram).max())) >= LEAST_NORM


def _weight(gram: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the inverse (P, P) of a size's covariance: that of its sampling error, the inverse of
    gram, and of the model's error."""
    return np.asarray(np.linalg.solve(np.eye(len(gram)) + gram * variance, gram))


def freed(
    residual: Sequence[FloatArray],
    noise: TileNoise,
    nuisances: Sequence[CameraNuisance],
    changes: Sequence[FloatArray],
) -> FloatArray:
    """Return (N,) a residual, (F, T, 6) of each trajectory, whitened and free of nuisances."""
    rows = [
        noise.whiten(
            np.stack([one, *(nuisance.blocks[number] for nuisance in nuisances)], axis=-1),
            changes[number],
        )
        for number, one in enumerate(residual)
    ]
    whitened = np.concatenate(rows)
    deviations = np.array([n.deviation for n in nuisances])
    return _without(whitened[:, 1:], deviations)(whitened[:, 0])


def _variance_beyond(right: FloatArray, square: FloatArray) -> FloatArray:
    """Return (P,) the variance v of sizes beyond their sampling error.

    Sizes x_j = right_j / square_j have the sampling variance 1 / square_j; v solves
    sum_j x_j^2 / (v + 1 / square_j) = J, and is 0 where they vary less.

    Args:
        right, square: (J, P).
    """
    size = right / np.maximum(square, _TINY)
    sampling = 1.0 / np.maximum(square, _TINY)
    count = len(right)
    low, high = np.zeros(right.shape[1]), np.sum(size**2, axis=0)
    for _ in range(60):
        middle = 0.5 * (low + high)
        too_small = np.sum(size**2 / (middle + sampling), axis=0) > count
        low, high = np.where(too_small, middle, low), np.where(too_small, high, middle)
    return np.asarray(low)


def _without(columns: FloatArray, deviation: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return what turns vectors of unit covariance, next to nuisances (N, Q) of these deviations,
    into vectors of unit covariance in all; nothing is left along those of infinite deviation."""
    free = _directions(columns[:, np.isinf(deviation)])
    known = columns[:, ~np.isinf(deviation)] * deviation[~np.isinf(deviation)]
    known = known - free @ (free.T @ known)
    left, value, _ = np.linalg.svd(known, full_matrices=False)
    shrink = 1.0 - 1.0 / np.sqrt(1.0 + value**2)

    def apply(vectors: FloatArray) -> FloatArray:
        rest = vectors - free @ (free.T @ vectors)
        return np.asarray(rest - left @ (shrink * (left.T @ rest).T).T)

    return apply


def _directions(columns: FloatArray) -> FloatArray:
    """Return orthonormal columns of the same span."""
    left, value, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, value > 1e-9 * max(value.max(initial=0.0), 1e-300)])


def bounded_size(
    gram: FloatArray, right: FloatArray, bounds: Sequence[tuple[float, float]]
) -> FloatArray:
    """Return x of the least x' gram x - 2 x' right within bounds."""
    low, high = np.array(bounds).T
    if len(right) == 1:
        return np.clip(right / gram[0], low, high)
    # Columns of a vanishing direction are kept at bay by a trace of their length.
    solid = gram + 1e-9 * np.trace(gram) * np.eye(len(gram))
    free = np.linalg.solve(solid, right)
    if np.all((free >= low) & (free <= high)):
        return np.asarray(free)
    root = np.linalg.cholesky(solid)
    return np.asarray(lsq_linear(root.T, np.linalg.solve(root, right), (low, high)).x)
