# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Equilibrium of the gel with the indenter in one substep.

Elasticity is linearised, the contact of the linear gel is solved whole (`contact_problem`), and so
on until neither moves: sequential quadratic programming with the contact as it is (Nocedal and
Wright, "Numerical Optimization", 2006, chapter 18), with a line search on the whole energy.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dotsim_ros.gel.implicit.contact import NO_RESPONSE, ONSET_M, ContactResponse, Lag
from dotsim_ros.gel.implicit.contact_problem import (
    Answers,
    ContactSolution,
    Guess,
    compliance_root,
    linear_contact,
    solve_contact,
)
from dotsim_ros.gel.implicit.patch import NearMarkers, Patch
from dotsim_ros.gel.implicit.tangent import ExactFactor, LocalFactor
from dotsim_ros.io import tracing
from dotsim_ros.io.arrays import BoolArray, FloatArray
from dotsim_ros.specification import SolverSpecification

NEAR_M = 0.2e-3
"""Markers closer than this to the indenter take part in the contact of an iteration."""
SMALLEST_SCALE = 1.0e-3
CONTRACTION = 0.25
"""Share of an iteration's step that the next one is expected to take, until one is measured."""
SMALLEST_CONTRACTION = 0.15
LEFT_SHARE = 0.2
"""Share of the tolerances that an iteration may leave to the one after it."""
FORCE_TOLERANCE_PER_M = 1.0e3
"""Tolerance of the force on the indenter as a share of it, by the tolerance of the skin: 1 % at
0.01 mm. That of the skin does not bound it: in a gel that hardly gives in volume, 0.01 mm of skin
can be a tenth of the force."""
CONTACT_SHARE = 0.3
"""Share of the tolerance to which the contact of the linear gel is solved."""
LARGEST_CONTACT_TOLERANCE_M = 3.0e-6
"""A loose tolerance saves iterations of the gel, but must not make its contact inaccurate: the
force follows from the contact."""
FAR_SHARE = 0.2
"""Forces out of balance far away below this share of those near the contact move nothing there."""
LARGEST_STEP_M = 0.3e-3
"""A step from where the gel may be unstable goes no farther."""
ROUGH_ITERATIONS = 12
"""Iterations of a substep that had to be cut short, or that went farther than the one before: so
many are not counted. A search that ends among them may end with ten times the force."""
SLOW_CONVERGENCE = 0.5
"""An iteration that moves farther than this share of the one before renews the linearisation."""

NEGLIGIBLE_PER_M = 3.0e3
"""Compliance of the gel that the contact leaves out, as a share of its own, by the tolerance."""

Factor = ExactFactor | LocalFactor


@dataclass(frozen=True)
class Point:
    """Where the search stands.

    Attributes:
        displacement_m: (N, 3) of the grid's nodes.
        force_n: (C, 3) of the indenter on the patch's markers, as the refinement feels it.
        added_m: (C, 3) what the refinement adds to their displacement under these forces.
        position_m: (C, 3) of those markers.
        energy_j, gradient_n: of elasticity and inertia, and its derivative (N, 3).
        response: of the contact.
    """

    displacement_m: FloatArray
    force_n: FloatArray
    added_m: FloatArray
    position_m: FloatArray
    energy_j: float
    gradient_n: FloatArray
    response: ContactResponse


@dataclass(frozen=True)
class EquilibriumProblem:
    """One substep.

    Attributes:
        patch: the markers that may touch, None without an indenter.
        bears: (C,) which of these bear.
        elastic: energy and its gradient (N, 3) at displacements (N, 3).
        respond: the indenter's answer to markers (their numbers (A,), positions (A, 3)), with
            friction limited by a lag.
        respond_now: the same with friction limited by the pressure that there is.
        linearise: the factored stiffness near the listed markers: at the start of the substep, or
            at the displacements (N, 3) given.
        at_rest: the step (3 N,) that answers forces (3 N,) on a gel that nothing touches.
        contact_compliance_m_n: the least of any marker against the indenter.
        seen_weight: (M, N) weights of the nodes in markers all over the skin.
        far_n: forces out of balance far away may wait below this.
    """

    patch: Patch | None
    bears: BoolArray
    elastic: Callable[[FloatArray], tuple[float, FloatArray]]
    respond: Callable[[NDArray[np.int32], FloatArray, Lag], ContactResponse]
    respond_now: Callable[[NDArray[np.int32], FloatArray], ContactResponse]
    linearise: Callable[[NearMarkers, FloatArray | None], Factor]
    at_rest: Callable[[FloatArray], FloatArray]
    contact_compliance_m_n: float
    seen_weight: sparse.csr_matrix
    far_n: float

    def at(self, displacement_m: FloatArray, force_n: FloatArray, lag: Lag) -> Point:
        """Return the point of displacements (N, 3) and forces (C, 3) on the patch's markers."""
        added = force_n if self.patch is None else self.patch.added_displacement(force_n)
        return self.with_added(displacement_m, force_n, added, lag)

    def with_added(
        self, displacement_m: FloatArray, force_n: FloatArray, added_m: FloatArray, lag: Lag
    ) -> Point:
        """Return the same where what the refinement adds (C, 3) is known."""
        energy, gradient = self.elastic(displacement_m)
        if self.patch is None:
            empty = np.zeros((0, 3))
            return Point(displacement_m, empty, empty, empty, energy, gradient, NO_RESPONSE)
        position = self.patch.position(displacement_m, added_m)
        response = self.respond(self.patch.marker, position, lag)
        return Point(displacement_m, force_n, added_m, position, energy, gradient, response)


@dataclass
class Trace:
    """How a search went.

    Attributes:
        moves: how far each iteration moved a marker (m) and its share of the whole step.
        contact_iterations: of the contact problems, all together.
        timings_s: seconds spent, by part.
    """

    moves: list[tuple[float, float]] = field(default_factory=list)
    contact_iterations: int = 0
    timings_s: dict[str, float] = field(default_factory=dict)

    def add(self, part: str, since: float) -> None:
        """Add the time since a reading of the clock to a part."""
        self.timings_s[part] = self.timings_s.get(part, 0.0) + time.perf_counter() - since
        tracing.add(part, since)


@dataclass(frozen=True)
class _NewtonStep:
    """A step of the nodes (N, 3), of the forces on the patch's markers (C, 3), and of what the
    refinement adds under them (C, 3); where it takes the markers (C, 3), how the indenter answers
    there under which lag; how far it moves any marker of the skin; the energy's slope along
    it; whether the contact was solved."""

    displacement_m: FloatArray
    force_n: FloatArray
    added_m: FloatArray
    position_m: FloatArray
    response: ContactResponse
    lag: Lag
    largest_m: float
    slope_j: float
    is_solved: bool = True


def _after(point: Point, step: _NewtonStep) -> Guess:
    return Guess(step.position_m, point.force_n + step.force_n)


def no_lag(count: int) -> Lag:
    """Return the lag of markers whose friction has no limit yet: none rubs."""
    return Lag(np.zeros(count), np.zeros((count, 3)))


class EquilibriumSearch:
    """The search of one substep.

    Args:
        problem: the substep.
        solver: tolerance and effort.
        trace: to write to.
        contraction: the share of an iteration's step that the next one is expected to take.

    Attributes:
        contraction: as measured, where there was more than one iteration.
    """

    def __init__(
        self,
        problem: EquilibriumProblem,
        solver: SolverSpecification,
        trace: Trace,
        *,
        contraction: float = CONTRACTION,
    ) -> None:
        self.problem, self.solver, self.trace = problem, solver, trace
        self.contraction = contraction
        self.near: NearMarkers | None = None
        self.factor: Factor | None = None
        self.root: NDArray[np.floating] | None = None
        self.is_careful = self.is_slow = False

    def run(self, displacement_m: FloatArray, lag: Lag, guess: Guess) -> tuple[Point, int, bool]:
        """Return the equilibrium, the iterations used, and whether the tolerance was met.

        Args:
            displacement_m: (N, 3) to begin with.
            lag: the first limit of friction on the patch's markers.
            guess: of the patch's markers.
        """
        clock = time.perf_counter()
        point = self.problem.at(displacement_m, guess.force_n, lag)
        self.trace.add("force", clock)
        last_m = last = np.inf
        iteration, allowed = 0, self.solver.iterations
        while iteration < allowed:
            iteration += 1
            step = self._step(point, lag, guess)
            if step.slope_j >= 0.0 and not self.is_careful:
                self._be_careful()
                step = self._step(point, lag, guess)
            guess, lag = _after(point, step), step.lag
            size = self._in_tolerances(point, step)
            if last < np.inf:
                self.contraction = float(np.clip(size / last, SMALLEST_CONTRACTION, 1.0))
            if step.is_solved and size * self.contraction < LEFT_SHARE:
                self.trace.moves.append((step.largest_m, 1.0))
                return self._ended(self._after(point, step)), iteration, True
            trial, scale = self._search_line(point, step)
            self.trace.moves.append((step.largest_m, scale))
            if scale < SMALLEST_SCALE:
                if self.is_careful:
                    return self._ended(point), iteration, False
                self._be_careful()
                continue
            if scale < 1.0 or step.largest_m > last_m:
                allowed = min(allowed + 1, self.solver.iterations + ROUGH_ITERATIONS)
            is_slow = self.is_careful or step.largest_m > SLOW_CONVERGENCE * last_m
            if is_slow and iteration < allowed:
                self._relinearise(trial)
            last_m, last = (step.largest_m, size) if scale == 1.0 else (np.inf, np.inf)
            point = trial
        return self._ended(point), iteration, False

    def _in_tolerances(self, point: Point, step: _NewtonStep) -> float:
        """Return how large a step is, of the skin or of the force, as a multiple of its
        tolerance."""
        change_n = step.force_n.sum(axis=0)
        before_n = point.force_n.sum(axis=0)
        force_n = max(np.linalg.norm(before_n), np.linalg.norm(before_n + change_n))
        share = 0.0 if force_n == 0.0 else float(np.linalg.norm(change_n) / force_n)
        return max(step.largest_m, share / FORCE_TOLERANCE_PER_M) / self.solver.tolerance_m

    def _energy_j(self, point: Point, response: ContactResponse) -> float:
        added_j = 0.5 * float(np.vdot(point.force_n, point.added_m))
        return point.energy_j + response.energy_j + added_j

    def _step(self, point: Point, lag: Lag, guess: Guess) -> _NewtonStep:
        """Return the step to the equilibrium of the linearised gel with the true contact, with a
        guess of its end, for the patch's markers."""
        patch = self.problem.patch
        if patch is None:
            return self._free_step(point, lag)
        close = np.any(point.force_n != 0.0, axis=1) | (point.response.pressure_pa > 0.0)
        if self.near is None:
            close |= point.response.distance_m < ONSET_M + NEAR_M
        else:
            close[self.near.rows] = True
        close &= self.problem.bears
        while True:
            if not close.any():
                step = self._free_step(point, lag)
            else:
                step = self._loaded_step(point, patch, np.flatnonzero(close), guess)
            missed = (step.response.pressure_pa > 0.0) & self.problem.bears & ~close
            if not missed.any():
                return step
            close |= (step.response.distance_m < ONSET_M + NEAR_M) & self.problem.bears
            guess, lag = _after(point, step), step.lag

    def _free_step(self, point: Point, lag: Lag) -> _NewtonStep:
        residual = -point.gradient_n
        patch = self.problem.patch
        if patch is not None:
            residual = residual + patch.weight.T @ point.response.force_n
        displacement = self.problem.at_rest(residual.ravel()).reshape(-1, 3)
        largest, slope = float(np.abs(displacement).max()), -float(np.vdot(residual, displacement))
        position, response = point.position_m, NO_RESPONSE
        if patch is not None:
            position = patch.position(
                point.displacement_m + displacement, np.zeros_like(point.added_m)
            )
            response = self.problem.respond(patch.marker, position, lag)
        return _NewtonStep(
            displacement, -point.force_n, -point.added_m, position, response, lag, largest, slope
        )

    def _loaded_step(
        self, point: Point, patch: Patch, rows: NDArray[np.int64], guess: Guess
    ) -> _NewtonStep:
        """Return the step if the listed rows of the patch may touch, with a guess of its end."""
        clock = time.perf_counter()
        near, factor = self._linear(point, patch, rows)
        balance = patch.weight.T @ point.force_n - point.gradient_n
        free = self._free(factor, balance.ravel())
        self.trace.add("solve", clock)
        clock = time.perf_counter()
        solution = self._contact(near, factor, point, free, guess)
        self.trace.contact_iterations += solution.iterations
        self.trace.add("touch", clock)
        clock = time.perf_counter()
        change = solution.force_n - point.force_n[rows]
        load = near.load(change, len(point.gradient_n)).ravel()
        displacement = (free + factor.solve_loads(load)).reshape(-1, 3)
        force = np.zeros_like(point.force_n)
        force[rows] = change
        renewed = no_lag(len(patch.marker))
        renewed.pressure_pa[rows] = solution.lag.pressure_pa
        renewed.normal[rows] = solution.lag.normal
        added = patch.added_displacement(force)
        moved = patch.weight @ displacement + added
        residual = patch.weight.T @ point.response.force_n - point.gradient_n
        slope = -float(np.vdot(residual, displacement))
        slope -= float(np.vdot(point.response.force_n - point.force_n, added))
        position = point.position_m + moved
        response = self.problem.respond(patch.marker, position, renewed)
        self.trace.add("solve", clock)
        seen = np.abs(self.problem.seen_weight @ displacement)
        largest = float(max(np.abs(moved[rows]).max(), seen.max()))
        return _NewtonStep(
            displacement,
            force,
            added,
            position,
            response,
            renewed,
            largest,
            slope,
            solution.is_solved,
        )

    def _linear(
        self, point: Point, patch: Patch, rows: NDArray[np.int64]
    ) -> tuple[NearMarkers, Factor]:
        if self.near is None or len(rows) != len(self.near.rows):
            self.near, self.root = NearMarkers(patch, rows), None
            if isinstance(self.factor, LocalFactor) and np.any(
                self.factor.region.number[self.near.node] < 0
            ):
                self.factor = None
        if self.factor is None:
            self.factor, self.root = self._linearise(self.near, point), None
        return self.near, self.factor

    def _contact(
        self,
        near: NearMarkers,
        factor: Factor,
        point: Point,
        free_m: FloatArray,
        guess: Guess,
    ) -> ContactSolution:
        """Return the contact of the linear gel that would move freely by (3 N,)."""
        rows, respond, respond_now = near.rows, self.problem.respond, self.problem.respond_now
        free = near.displacement(free_m.reshape(-1, 3))
        force = point.force_n[rows]
        if self.is_careful:
            now = Lag(point.response.pressure_pa[rows], point.response.normal[rows])
            response = respond(near.marker, point.position_m[rows], now)
            compliance = near.compliance(factor.between(near.node))
            linear = linear_contact(compliance, free, force, response)
            return ContactSolution(linear, response, now, 1, True)
        answers = Answers(
            lambda position, limit: respond(near.marker, position, limit),
            lambda position: respond_now(near.marker, position),
        )
        if self.root is None:
            self.root = compliance_root(
                near.compliance(factor.between(near.node)),
                NEGLIGIBLE_PER_M * self.solver.tolerance_m * self.problem.contact_compliance_m_n,
            )
        tolerance = min(CONTACT_SHARE * self.solver.tolerance_m, LARGEST_CONTACT_TOLERANCE_M)
        return solve_contact(
            self.root,
            point.position_m[rows] + free,
            force,
            answers,
            guess=Guess(guess.position_m[rows], guess.force_n[rows]),
            passes=self.solver.friction_passes,
            tolerance_m=tolerance,
        )

    def _free(self, factor: Factor, right: FloatArray) -> FloatArray:
        """Return the step (3 N,) at constant contact forces; small residuals far away wait."""
        if isinstance(factor, LocalFactor) and not self.is_slow:
            inside = float(np.linalg.norm(right[factor.region.dof]))
            outside = np.sqrt(max(0.0, float(right @ right) - inside * inside))
            if outside < min(FAR_SHARE * inside, self.problem.far_n):
                return factor.solve_near(right)
        return factor.solve(right)

    def _after(self, point: Point, step: _NewtonStep) -> Point:
        """Return the point after a whole step; energy and gradient are not renewed."""
        return Point(
            point.displacement_m + step.displacement_m,
            point.force_n + step.force_n,
            point.added_m + step.added_m,
            step.position_m,
            point.energy_j,
            point.gradient_n,
            step.response,
        )

    def _search_line(self, point: Point, step: _NewtonStep) -> tuple[Point, float]:
        """Return the point after as much of a step as lowers the energy, and its share."""
        patch = self.problem.patch
        response = NO_RESPONSE
        if patch is not None:
            response = self.problem.respond(patch.marker, point.position_m, step.lag)
        energy = self._energy_j(point, response)
        scale = 1.0
        if self.is_careful:
            scale = min(1.0, LARGEST_STEP_M / step.largest_m)
        while True:
            clock = time.perf_counter()
            trial = self.problem.with_added(
                point.displacement_m + scale * step.displacement_m,
                point.force_n + scale * step.force_n,
                point.added_m + scale * step.added_m,
                step.lag,
            )
            self.trace.add("force", clock)
            allowed = energy + 1e-4 * scale * min(step.slope_j, 0.0) + 1e-9 * abs(energy)
            if self._energy_j(trial, trial.response) <= allowed or scale < SMALLEST_SCALE:
                return trial, scale
            scale *= 0.5

    def _ended(self, point: Point) -> Point:
        """Return the point with friction that obeys Coulomb's law with the pressure that it ends
        with: what is reported and remembered."""
        patch = self.problem.patch
        if patch is None:
            return point
        response = self.problem.respond_now(patch.marker, point.position_m)
        return replace(point, response=response)

    def _linearise(self, near: NearMarkers, point: Point) -> Factor:
        return self.problem.linearise(near, point.displacement_m if self.is_slow else None)

    def _relinearise(self, point: Point) -> None:
        self.is_slow = True
        if self.near is not None:
            self.factor, self.root = self._linearise(self.near, point), None

    def _be_careful(self) -> None:
        """From now on linearise the contact too, at the present state: a deep press can leave the
        gel unstable but for the indenter that holds it."""
        self.is_careful = self.is_slow = True
        self.near = self.factor = self.root = None
