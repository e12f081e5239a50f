# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What presses identify together: information, the joint step, and intervals by bootstrap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from dotsim_ros.calibration.fitting import FitProblem, PressFit, PressLinearisation
from dotsim_ros.calibration.loss import FORCE, SKIN
from dotsim_ros.calibration.parameters import coordinate_bounds, coordinates
from dotsim_ros.io.arrays import BoolArray, FloatArray

IDENTIFIABLE_SHARE = 0.5
"""A parameter is identifiable if the data leave at most this share of its prior's width."""

CHANNEL_SETS = {"skin alone": (SKIN,), "force alone": (FORCE,), "skin and force": (SKIN, FORCE)}


@dataclass(frozen=True)
class Identifiability:
    """How well one kind of data identifies one parameter.

    Attributes:
        parameter: its name.
        data: a key of `CHANNEL_SETS`.
        information: its Fisher information with all other parameters known, per squared
            coordinate.
        deviation: of its coordinate after the data, with the others unknown, and their priors.
        prior_deviation: before the data.
        is_told: whether the data identify it: shrink the prior to `IDENTIFIABLE_SHARE` or less.
    """

    parameter: str
    data: str
    information: float
    deviation: float
    prior_deviation: float
    is_told: bool


@dataclass(frozen=True)
class Combination:
    """A combined estimate: coordinates (P,), and the ends (P,) of the 95 % intervals."""

    point: FloatArray
    low: FloatArray
    high: FloatArray


def reduced(
    problem: FitProblem, linearisation: PressLinearisation, channels: Sequence[str] = (SKIN, FORCE)
) -> tuple[FloatArray, FloatArray]:
    """Return a press's information (P, P) on the shared parameters, its own offset eliminated, and
    the gradient (P,); priors of the shared ones are left out, that of the offset is in."""
    information, gradient, _ = linearisation.total(channels)
    count = len(problem.parameters)
    if not problem.with_offset:
        return information, gradient
    precision = np.diag(problem.precision()[count:])
    own = information[count:, count:] + precision
    across = information[:count, count:]
    own_gradient = gradient[count:] + precision @ linearisation.point[count:]
    solved = np.linalg.solve(own, np.column_stack([across.T, own_gradient]))
    return (
        information[:count, :count] - across @ solved[:, :-1],
        gradient[:count] - across @ solved[:, -1],
    )


def identifiability(
    problem: FitProblem, linearisations: Sequence[PressLinearisation]
) -> list[Identifiability]:
    """Return how well each kind of data identifies each parameter, all presses together."""
    count = len(problem.parameters)
    prior = problem.precision()[:count]
    result = []
    for data, channels in CHANNEL_SETS.items():
        information = sum(
            (reduced(problem, lin, channels)[0] for lin in linearisations),
            np.zeros((count, count)),
        )
        covariance = np.linalg.inv(information + np.diag(prior))
        for index, parameter in enumerate(problem.parameters):
            deviation = float(np.sqrt(covariance[index, index]))
            width = parameter.prior_width
            result.append(
                Identifiability(
                    parameter=parameter.name,
                    data=data,
                    information=float(information[index, index]),
                    deviation=deviation,
                    prior_deviation=width,
                    is_told=deviation <= IDENTIFIABLE_SHARE * width,
                )
            )
    return result


def joint_step(problem: FitProblem, linearisations: Sequence[PressLinearisation]) -> FloatArray:
    """Return the Gauss-Newton step (P,) of the shared parameters, from the mean of their points
    and within their bounds."""
    here, informations, gradients = _stacked(problem, linearisations)
    return _bounded_step(problem, here, informations.sum(axis=0), gradients.sum(axis=0))[0]


def offset_step(
    problem: FitProblem, linearisation: PressLinearisation, shared_step: FloatArray
) -> FloatArray:
    """Return the step (6,) of a press's offset that goes with a step (P,) of the shared."""
    count = len(problem.parameters)
    if not problem.with_offset:
        return np.zeros(0)
    information, gradient, _ = linearisation.total()
    precision = np.diag(problem.precision()[count:])
    right = gradient[count:] + precision @ linearisation.point[count:]
    right = right + information[count:, :count] @ shared_step
    return np.asarray(-np.linalg.solve(information[count:, count:] + precision, right))


def joint_estimate(
    problem: FitProblem,
    linearisations: Sequence[PressLinearisation],
    *,
    replicates: int = 4000,
    seed: int = 0,
) -> Combination:
    """Return the joint fit's estimate and intervals by bootstrap over presses.

    Presses may be linearised at different points: each enters with the quadratic that it has about
    its own, so that fits of single presses are weighed by their information. Each replicate draws
    presses with replacement and takes one Gauss-Newton step from their information and gradients:
    no new solve. A parameter that ends at a bound stays there in all of them. Deviations are
    widened by sqrt(n / (n - 1)) and Student's quantile over the normal one, since n presses are
    few. One press alone cannot be drawn otherwise: its interval is that of its information and the
    priors.
    """
    here, informations, gradients = _stacked(problem, linearisations)
    n = len(linearisations)
    step, held = _bounded_step(problem, here, informations.sum(axis=0), gradients.sum(axis=0))
    best = here + step
    if n == 1:
        return _from_information(problem, best, informations[0])
    alone = _from_information(problem, best, informations.sum(axis=0))
    drawn = np.random.default_rng(seed).integers(n, size=(replicates, n))
    points = np.array(
        [
            here
            + _step(
                problem, here, informations[d].sum(axis=0), gradients[d].sum(axis=0), held, step
            )
            for d in drawn
        ]
    )
    return _interval(best, points, n, alone)


def median_estimate(
    problem: FitProblem, fits: Sequence[PressFit], *, replicates: int = 4000, seed: int = 0
) -> Combination:
    """Return the paper's estimate, the median of the fits of single presses, and intervals by
    bootstrap over them, widened as `joint_estimate`'s, or of a single press as there."""
    count = len(problem.parameters)
    points = np.array([fit.best.point[:count] for fit in fits])
    n = len(points)
    if n == 1:
        return _from_information(problem, points[0], reduced(problem, fits[0].best)[0])
    drawn = np.random.default_rng(seed).integers(n, size=(replicates, n))
    best = np.median(points, axis=0)
    information = sum((reduced(problem, fit.best)[0] for fit in fits), np.zeros((count, count)))
    alone = _from_information(problem, best, information)
    return _interval(best, np.median(points[drawn], axis=1), n, alone)


def small_sample_widening(count: int) -> float:
    """Return by how much the deviations of a bootstrap over few items are widened."""
    if count < 2:
        return 1.0
    student = stats.t.ppf(0.975, count - 1) / stats.norm.ppf(0.975)
    return float(student * np.sqrt(count / (count - 1)))


def _from_information(
    problem: FitProblem, best: FloatArray, information: FloatArray
) -> Combination:
    precision = problem.precision()[: len(best)]
    covariance = np.linalg.inv(information + np.diag(precision))
    half = stats.norm.ppf(0.975) * np.sqrt(np.diag(covariance))
    return Combination(best, best - half, best + half)


def _interval(best: FloatArray, points: FloatArray, count: int, alone: Combination) -> Combination:
    """Return the interval of replicates (R, P) of so many presses.

    Presses that agree to the bit give replicates without any width, which is no interval: that of
    their information, `alone`, takes its place.
    """
    low, high = np.quantile(points, [0.025, 0.975], axis=0)
    wide = small_sample_widening(count)
    has_width = high - low > 1e-9 * (alone.high - alone.low)
    return Combination(
        best,
        np.where(has_width, best + wide * (low - best), alone.low),
        np.where(has_width, best + wide * (high - best), alone.high),
    )


def _stacked(
    problem: FitProblem, linearisations: Sequence[PressLinearisation]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean of the points (P,), and there the informations (n, P, P) and gradients
    (n, P) of the presses' quadratics."""
    count = len(problem.parameters)
    points = np.stack([lin.point[:count] for lin in linearisations])
    here = points.mean(axis=0)
    pairs = [reduced(problem, lin) for lin in linearisations]
    informations = np.stack([pair[0] for pair in pairs])
    gradients = np.stack([pair[1] for pair in pairs])
    return here, informations, gradients + np.einsum("kij,kj->ki", informations, here - points)


def _bounded_step(
    problem: FitProblem, here: FloatArray, information: FloatArray, gradient: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return the step (P,) within the bounds, and which (P,) parameters it leaves at one.

    What leads beyond a bound ends there, and the others go where that leaves them: the quadratic
    says nothing of a model beyond its bounds.
    """
    low, high = coordinate_bounds(problem.parameters)
    held = np.zeros(len(here), dtype=np.bool_)
    step = _step(problem, here, information, gradient, held, np.zeros(len(here)))
    while np.any(beyond := ~held & ((here + step < low) | (here + step > high))):
        held |= beyond
        ends = np.clip(here + step, low, high) - here
        step = _step(problem, here, information, gradient, held, ends)
    return step, held


def _step(
    problem: FitProblem,
    here: FloatArray,
    information: FloatArray,
    gradient: FloatArray,
    held: BoolArray,
    ends: FloatArray,
) -> FloatArray:
    """Return the step (P,) to the optimum, with the parameters that are held (P,) where the step
    `ends` (P,) takes them."""
    precision = problem.precision()[: len(here)]
    away = here - coordinates(problem.parameters, problem.start)
    curvature, slope = information + np.diag(precision), gradient + precision * away
    step = np.where(held, ends, 0.0)
    free = ~held
    step[free] = -np.linalg.solve(curvature[np.ix_(free, free)], (slope + curvature @ step)[free])
    return step
