# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gauss-Newton fit of a press, by the whole Jacobian of the model.

The Jacobian's columns are differences of the solver at a tight tolerance, not gradients by its
adjoint: Gauss-Newton steps, Fisher information and intervals need all columns of all residuals,
while an adjoint pass gives one loss's derivatives. Young's modulus has its column without a solve.
A test compares the gradient that the columns give with the adjoint's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dotsim_ros.calibration.loss import (
    CHAMFER,
    FORCE,
    SKIN,
    LossNoise,
    force_deviation_n,
    nearest_partners,
    residuals,
)
from dotsim_ros.calibration.parameters import coordinate_bounds, coordinates, with_coordinates
from dotsim_ros.data.presses import Press
from dotsim_ros.data.reading import Observation
from dotsim_ros.gel.values import GelParameter, GelValues
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.twin.follow import SimulatedPress, SolveError
from dotsim_ros.twin.simulator import GelSimulator

OFFSET_STEPS = np.array([0.02e-3] * 3 + [5.0e-3] * 3)
"""Steps of the finite differences by an indenter's offset: metres, radians."""

SMALLEST_DECREASE = 0.05
"""A fit ends when its step is predicted to lower the loss by less: a step of one posterior standard
deviation lowers it by a half, and the solver's tolerance moves it by some hundredths."""

FIRST_DAMPING, LARGEST_DAMPING = 1.0e-3, 1.0e3


@dataclass(frozen=True)
class FitProblem:
    """What is fitted, and how.

    Attributes:
        parameters: the P that are free.
        start: the gel's parameters before the fit; the prior's centre.
        noise: of the measurement.
        skin_loss: `POINTS` or `CHAMFER`.
        with_offset: whether each press has an offset of the indenter of its own.
    """

    parameters: tuple[GelParameter, ...]
    start: GelValues
    noise: LossNoise
    skin_loss: str
    with_offset: bool = False

    @property
    def size(self) -> int:
        """Number of unknowns of a press: P, and 6 of its offset."""
        return len(self.parameters) + (6 if self.with_offset else 0)

    def precision(self) -> FloatArray:
        """Return the inverse variances (n,) of the priors of a press's unknowns."""
        width = [p.prior_width for p in self.parameters]
        if self.with_offset:
            width += self.noise.offset().tolist()
        return np.array(width) ** -2.0

    def centre(self) -> FloatArray:
        """Return the unknowns (n,) at the priors' centres."""
        offset = np.zeros(6 if self.with_offset else 0)
        return np.concatenate([coordinates(self.parameters, self.start), offset])


@dataclass(frozen=True)
class PressLinearisation:
    """Half the sum of squares of a press around a point, without priors, by channel.

    Attributes:
        point: (n,) unknowns: coordinates of the parameters, then the offset.
        information, gradient: J^T J (n, n) and J^T r (n,) of each channel.
        loss, count: r^T r / 2, and number of residuals, of each channel.
        converged: whether all of its solves met the solver's tolerance.
    """

    point: FloatArray
    information: dict[str, FloatArray]
    gradient: dict[str, FloatArray]
    loss: dict[str, float]
    count: dict[str, int]
    solve_count: int
    converged: bool

    def total(
        self, channels: Sequence[str] = (SKIN, FORCE)
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return information, gradient and loss of some channels together."""
        n = len(self.point)
        present = [c for c in channels if c in self.loss]
        information = sum((self.information[c] for c in present), np.zeros((n, n)))
        gradient = sum((self.gradient[c] for c in present), np.zeros(n))
        return information, gradient, float(sum(self.loss[c] for c in present))


@dataclass(frozen=True)
class PressFit:
    """The fit of one press.

    Attributes:
        best: the linearisation at the best point.
        losses: with priors, of each accepted point.
        has_settled: whether the last step was small, not the budget spent.
    """

    best: PressLinearisation
    losses: list[float] = field(default_factory=list)
    solve_count: int = 0
    has_settled: bool = False


def within_bounds(problem: FitProblem, point: FloatArray) -> FloatArray:
    """Return unknowns (n,) with their parameters kept within their bounds."""
    kept = point.copy()
    count = len(problem.parameters)
    kept[:count] = np.clip(kept[:count], *coordinate_bounds(problem.parameters))
    return kept


def simulate(
    simulator: GelSimulator, observation: Observation, problem: FitProblem, point: FloatArray
) -> SimulatedPress:
    """Return the model at unknowns (n,).

    Raises:
        SolveError: it could not be solved there.
    """
    count = len(problem.parameters)
    values = with_coordinates(problem.start, problem.parameters, point[:count])
    press = observation.press
    offset = point[count:] if problem.with_offset else None
    return simulator.press(values, observation.indenter, press.poses, press.stamp_s, offset)


def linearise(
    simulator: GelSimulator,
    observation: Observation,
    problem: FitProblem,
    point: FloatArray,
    simulated: SimulatedPress | None = None,
) -> PressLinearisation:
    """Return the squares and their derivatives at unknowns (n,).

    Parameters beyond their bounds are taken at them, as the model is. `simulated` is the model at
    the point, if it is known.

    Raises:
        SolveError: the model could not be solved at the point or next to it.
    """
    solve_count = 0
    point = within_bounds(problem, point)
    if simulated is None:
        simulated = simulate(simulator, observation, problem, point)
        solve_count += 1
    press, noise, skin = observation.press, problem.noise, simulator.skin
    # Held while differences are taken: to first order the nearest stay the nearest.
    partners = nearest_partners(press, simulated) if problem.skin_loss == CHAMFER else None
    here = residuals(press, simulated, noise, skin, partners)
    columns: list[dict[str, FloatArray]] = []
    converged = simulated.converged
    for index in range(problem.size):
        if index < len(problem.parameters):
            parameter = problem.parameters[index]
            if parameter.field == "youngs_modulus_pa":
                columns.append(_modulus_column(press, simulated, noise, skin, here))
                continue
            step = _difference(problem, point, index)
        else:
            step = OFFSET_STEPS[index - len(problem.parameters)]
        beside_point = point.copy()
        beside_point[index] += step
        beside = simulate(simulator, observation, problem, beside_point)
        solve_count += 1
        converged = converged and beside.converged
        there = residuals(press, beside, noise, skin, partners)
        columns.append({c: (there[c] - here[c]) / step for c in here})
    jacobian = {c: np.stack([column[c] for column in columns], axis=1) for c in here}
    return PressLinearisation(
        point=point,
        information={c: jacobian[c].T @ jacobian[c] for c in here},
        gradient={c: jacobian[c].T @ here[c] for c in here},
        loss={c: 0.5 * float(here[c] @ here[c]) for c in here},
        count={c: len(here[c]) for c in here},
        solve_count=solve_count,
        converged=converged,
    )


def _difference(problem: FitProblem, point: FloatArray, index: int) -> float:
    """Return the step of a parameter's difference, which stays within its bounds: beyond them the
    model is that at the bound, and the difference would tell nothing."""
    low, high = (ends[index] for ends in coordinate_bounds(problem.parameters))
    here, size = point[index], problem.parameters[index].step
    towards_centre = float(np.copysign(size, problem.centre()[index] - here))
    for step in (towards_centre, -towards_centre):
        if low <= here + step <= high:
            return step
    return max(low - here, high - here, key=abs)


def _modulus_column(
    press: Press,
    simulated: SimulatedPress,
    noise: LossNoise,
    skin: SkinMesh,
    here: dict[str, FloatArray],
) -> dict[str, FloatArray]:
    """Return the derivatives by log E: none of the skin's, the force itself of the force's."""
    column = {c: np.zeros(len(here[c])) for c in here}
    if press.force_n is not None:
        sigma_n = force_deviation_n(press, noise, skin)
        column[FORCE] = (simulated.force_n / sigma_n).ravel()
    return column


def penalised(
    problem: FitProblem, linearisation: PressLinearisation
) -> tuple[FloatArray, FloatArray, float]:
    """Return information, gradient and loss of all channels with the priors."""
    information, gradient, loss = linearisation.total()
    away = linearisation.point - problem.centre()
    precision = problem.precision()
    return (
        information + np.diag(precision),
        gradient + precision * away,
        loss + 0.5 * float(precision @ away**2),
    )


def damped_step(information: FloatArray, gradient: FloatArray, damping: float) -> FloatArray:
    """Return the step (n,) of Levenberg and Marquardt."""
    scaled = information + damping * np.diag(np.diag(information))
    return np.asarray(-np.linalg.solve(scaled, gradient))


def fit_press(
    simulator: GelSimulator,
    observation: Observation,
    problem: FitProblem,
    start: PressLinearisation,
    *,
    budget: int,
) -> PressFit:
    """Fit one press alone, with at most `budget` solves after those of the start."""
    best, spent, damping = start, 0, FIRST_DAMPING
    cost = 1 + sum(1 for index in range(problem.size) if not _is_modulus(problem, index))
    losses = [penalised(problem, best)[2]]
    has_settled = False
    while spent + cost <= budget and damping < LARGEST_DAMPING and not has_settled:
        information, gradient, loss = penalised(problem, best)
        step = damped_step(information, gradient, damping)
        step = within_bounds(problem, best.point + step) - best.point
        promised = -float(gradient @ step + 0.5 * step @ information @ step)
        if promised < SMALLEST_DECREASE:
            has_settled = True
            break
        spent += 1
        try:
            simulated = simulate(simulator, observation, problem, best.point + step)
            trial = _loss_at(observation, problem, simulator, best.point + step, simulated)
            if trial >= loss:
                damping *= 10.0
                continue
            best = linearise(simulator, observation, problem, best.point + step, simulated)
        except SolveError:
            damping *= 10.0
            continue
        spent += best.solve_count
        damping = max(damping / 10.0, 1e-6)
        losses.append(trial)
    return PressFit(best, losses, spent, has_settled)


def _is_modulus(problem: FitProblem, index: int) -> bool:
    parameters = problem.parameters
    return index < len(parameters) and parameters[index].field == "youngs_modulus_pa"


def _loss_at(
    observation: Observation,
    problem: FitProblem,
    simulator: GelSimulator,
    point: FloatArray,
    simulated: SimulatedPress,
) -> float:
    """Return half the sum of squares with the priors at unknowns (n,)."""
    partners = None
    if problem.skin_loss == CHAMFER:
        partners = nearest_partners(observation.press, simulated)
    missed = residuals(observation.press, simulated, problem.noise, simulator.skin, partners)
    away = point - problem.centre()
    squares = sum(float(r @ r) for r in missed.values())
    return 0.5 * (squares + float(problem.precision() @ away**2))
