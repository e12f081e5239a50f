"""Frictional contact of a few markers on a gel that responds linearly to their forces.

Once elasticity is linearised, the markers' positions are x = b + C (f - f0): b is where they would
be under forces f0, C the compliance between them. The forces of the indenter, f = F(x), minimise

    E(f) = (f - f0) . C (f - f0) / 2 + f0 . C (f - f0) + psi(x)

with the contact's energy psi at a lagged friction limit (Wriggers, "Computational Contact
Mechanics", 2006, section 9.3.2). Newton's method on it involves the touching markers alone, so that
markers may begin and cease to touch, stick and slip at little cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from dotsim_ros.arrays import AnyFloatArray, FloatArray
from dotsim_ros.gel.implicit.contact import ContactResponse, Lag

ITERATIONS = 60
CLOSE = 10.0
"""Newton's method on Coulomb's law begins at so many tolerances."""
CORRECTIONS = 8
DIVERGING = 20.0
"""It ends without success once the markers are this much farther from balance than at its start."""
SMALLEST_SCALE = 1.0e-3
SOFTENING = 1.0e-6
"""Share of a marker's stiffness that is added in all directions, so that it has a Cholesky root."""


@dataclass(frozen=True)
class Answers:
    """How the indenter answers markers at positions (A, 3): with friction limited by a lag, and by
    the pressure that there is."""

    lagged: Callable[[FloatArray, Lag], ContactResponse]
    present: Callable[[FloatArray], ContactResponse]


@dataclass(frozen=True)
class ContactSolution:
    """The markers in contact.

    Attributes:
        force_n: (A, 3) f.
        response: at the positions that f causes.
        lag: what limits friction.
        iterations: of Newton's method.
    """

    force_n: FloatArray
    response: ContactResponse
    lag: Lag
    iterations: int


def by_component(vectors: FloatArray) -> FloatArray:
    """Return vectors (A, 3) as (3 A,) with all x first, the order of a compliance's rows."""
    components: FloatArray = vectors.T.ravel()
    return components


def by_marker(components: AnyFloatArray) -> FloatArray:
    """Return (3 A,) components as vectors (A, 3)."""
    return np.ascontiguousarray(components.reshape(3, -1).T, dtype=np.float64)


@dataclass(frozen=True)
class _ContactState:
    """Change of the forces f - f0 (3 A,), what it causes, C (f - f0) (3 A,), how the indenter
    answers there, and the energy, J."""

    change: AnyFloatArray
    caused: AnyFloatArray
    response: ContactResponse
    energy_j: float


class _ContactProblem:
    """C, b, f0 and the indenter's answers."""

    def __init__(
        self, compliance: AnyFloatArray, base_m: FloatArray, force_n: FloatArray, answers: Answers
    ) -> None:
        self.compliance, self.base_m, self.force_n = compliance, base_m, force_n
        self.answers = answers
        self._force = force_n.T.ravel()
        self.iterations = 0

    def at(self, change: AnyFloatArray, caused: AnyFloatArray, lag: Lag | None) -> _ContactState:
        """Return the state of changed forces; without a lag, with the pressure that there is."""
        position: FloatArray = self.base_m + by_marker(caused)
        if lag is None:
            response = self.answers.present(position)
        else:
            response = self.answers.lagged(position, lag)
        energy = float((0.5 * change + self._force) @ caused) + response.energy_j
        return _ContactState(change, caused, response, energy)

    def answered(self, state: _ContactState) -> AnyFloatArray:
        """Return the change of the forces (3 A,) that the indenter answers with."""
        change = by_component(state.response.force_n - self.force_n)
        return change.astype(self.compliance.dtype)

    def out_of_balance(self, state: _ContactState) -> AnyFloatArray:
        """Return how far (3 A,) the markers would move if the indenter's answer acted on them."""
        result: AnyFloatArray = state.caused - self.compliance @ self.answered(state)
        return result

    def descend(
        self, state: _ContactState, out_of_balance: AnyFloatArray, lag: Lag
    ) -> tuple[_ContactState, bool]:
        """Return the state after a Newton step that lowers the energy, and whether there is one."""
        self.iterations += 1
        step = self.answered(state) - state.change
        step += _newton_force(self.compliance, out_of_balance, state.response)
        moved = self.compliance @ step
        slope = float(out_of_balance @ step)
        scale = 1.0
        while scale >= SMALLEST_SCALE:
            share = self.compliance.dtype.type(scale)
            trial = self.at(state.change + share * step, state.caused + share * moved, lag)
            # Single precision: a decrease below rounding is none.
            allowed = state.energy_j + 1e-4 * scale * slope + 1e-6 * abs(state.energy_j)
            if trial.energy_j <= allowed:
                return trial, True
            scale *= 0.5
        return state, False

    def correct(self, state: _ContactState, out_of_balance: AnyFloatArray) -> _ContactState:
        """Return the state after a Newton step on Coulomb's law as it is."""
        self.iterations += 1
        change = self.answered(state)
        change += _coulomb_force(self.compliance, out_of_balance, state.response)
        return self.at(change, self.compliance @ change, None)

    def solution(self, state: _ContactState) -> ContactSolution:
        """Return what a state amounts to."""
        lag = Lag(state.response.pressure_pa, state.response.normal)
        force = self.force_n + by_marker(state.change)
        return ContactSolution(force, state.response, lag, self.iterations)


def solve_contact(
    compliance: AnyFloatArray,
    base_m: FloatArray,
    force_n: FloatArray,
    answers: Answers,
    lag: Lag,
    *,
    guess_n: FloatArray,
    passes: int,
    tolerance_m: float,
) -> ContactSolution:
    """Return the contact forces of the linear gel.

    Newton's method on the energy with lagged friction goes first: it converges from anywhere. Close
    to the solution Newton's method on Coulomb's law itself takes over; where that does not converge
    the lag is renewed.

    Args:
        compliance: (3 A, 3 A) C, m/N, rows and columns by component.
        base_m: (A, 3) b.
        force_n: (A, 3) f0.
        answers: the indenter's.
        lag: the first limit of friction.
        guess_n: (A, 3) the first guess of the forces.
        passes: how often the limit is renewed at most.
        tolerance_m: how far the markers may be from where the indenter's answer would take them.
    """
    problem = _ContactProblem(compliance, base_m, force_n, answers)
    change = by_component(guess_n - force_n).astype(compliance.dtype)
    state = problem.at(change, compliance @ change, lag)
    for _ in range(passes):
        state = _descended(problem, state, lag, CLOSE * tolerance_m)
        known = problem.at(state.change, state.caused, None)
        state, is_solved = _corrected(problem, known, tolerance_m)
        if is_solved:
            return problem.solution(state)
        lag = Lag(known.response.pressure_pa, known.response.normal)
        state = problem.at(known.change, known.caused, lag)
    return problem.solution(state)


def linear_contact(
    compliance: AnyFloatArray, free_m: FloatArray, force_n: FloatArray, response: ContactResponse
) -> FloatArray:
    """Return the forces (A, 3) of a contact that is linearised too: one step of Newton's method.

    For a gel that is stable only while the indenter holds it: its own energy need not have a
    minimum that a line search could descend to.

    Args:
        compliance: (3 A, 3 A) C, m/N, rows and columns by component.
        free_m: (A, 3) how far the markers would move under forces f0.
        force_n: (A, 3) f0.
        response: the indenter's answer to the markers where they are.
    """
    change = by_component(response.force_n - force_n).astype(compliance.dtype)
    out_of_balance = -by_component(free_m).astype(compliance.dtype) - compliance @ change
    return force_n + by_marker(change + _newton_force(compliance, out_of_balance, response))


def _corrected(
    problem: _ContactProblem, state: _ContactState, tolerance_m: float
) -> tuple[_ContactState, bool]:
    """Return the state after Newton's method on Coulomb's law, and whether it converged."""
    first = np.inf
    for correction in range(CORRECTIONS):
        out_of_balance = problem.out_of_balance(state)
        left = _largest(out_of_balance)
        if left < tolerance_m:
            return state, True
        if correction == 0:
            first = left
        if left > DIVERGING * first:
            break
        state = problem.correct(state, out_of_balance)
    return state, False


def _descended(
    problem: _ContactProblem, state: _ContactState, lag: Lag, close_m: float
) -> _ContactState:
    """Return the state once the descent on the energy is within a given distance of its end."""
    has_descended = True
    while has_descended and problem.iterations < ITERATIONS:
        out_of_balance = problem.out_of_balance(state)
        if _largest(out_of_balance) < close_m:
            break
        state, has_descended = problem.descend(state, out_of_balance, lag)
    return state


def _largest(components: AnyFloatArray) -> float:
    return float(np.abs(components).max())


def _newton_force(
    compliance: AnyFloatArray, out_of_balance: AnyFloatArray, response: ContactResponse
) -> AnyFloatArray:
    """Return by how much (3 A,) the linearised contact answers otherwise after a Newton step.

    With the touching markers' stiffness H = S S^T and r = C (f - F), they move by
    -(1 + C H)^-1 r = -r + C S y where (1 + S^T C S) y = S^T r, and their force becomes F + S y.
    """
    hessian = response.stiffness
    size = np.trace(hessian, axis1=1, axis2=2)
    active = np.flatnonzero(size > 0.0)
    count = len(hessian)
    result = np.zeros_like(out_of_balance)
    if len(active) == 0:
        return result
    softened = hessian[active] + SOFTENING * size[active, None, None] * np.eye(3)
    root = np.linalg.cholesky(softened).astype(compliance.dtype)
    dof = (np.arange(3)[:, None] * count + active).ravel()
    own = compliance if len(active) == count else compliance[dof].take(dof, axis=1)
    right = np.einsum("aik,ia->ka", root, out_of_balance[dof].reshape(3, -1)).ravel()
    solved = _solve_positive(_congruent(own, root), right).reshape(3, -1)
    result[dof] += np.einsum("aik,ka->ia", root, solved).ravel()
    return result


def _coulomb_force(
    compliance: AnyFloatArray, out_of_balance: AnyFloatArray, response: ContactResponse
) -> AnyFloatArray:
    """Return by how much (3 A,) the contact answers otherwise after a Newton step, where its
    stiffness H is not symmetric: the markers move by d, (1 + C H) d = -r, the change is -H d."""
    active = np.flatnonzero(response.pressure_pa > 0.0)
    count, touching = len(response.pressure_pa), len(active)
    result = np.zeros_like(out_of_balance)
    if touching == 0:
        return result
    own = response.stiffness[active].astype(compliance.dtype)
    dof = (np.arange(3)[:, None] * count + active).ravel()
    between = compliance if touching == count else compliance[dof].take(dof, axis=1)
    matrix = np.empty_like(between)
    for j in range(3):
        columns = matrix[:, j * touching : (j + 1) * touching]
        np.multiply(between[:, :touching], own[:, 0, j], out=columns)
        for k in (1, 2):
            columns += between[:, k * touching : (k + 1) * touching] * own[:, k, j]
    matrix[np.diag_indices(3 * touching)] += 1.0
    getrf, getrs = linalg.get_lapack_funcs(("getrf", "getrs"), (matrix,))
    # LAPACK reads the transpose.
    factor, pivots, info = getrf(matrix.T, overwrite_a=1)
    if info != 0:
        return result
    moved, _ = getrs(factor, pivots, -out_of_balance[dof], trans=1)
    result[dof] -= np.einsum("akj,ja->ka", own, moved.reshape(3, -1)).ravel()
    return result


def _congruent(compliance: AnyFloatArray, root: AnyFloatArray) -> AnyFloatArray:
    """Return 1 + S^T C S for C (3 A, 3 A) by component and lower triangular blocks S (A, 3, 3)."""
    count = len(root)
    whole = compliance.reshape(3 * count, 3, count)
    half = np.empty_like(whole)
    for k in range(3):
        half[:, k] = whole[:, k] * root[:, k, k]
        for j in range(k + 1, 3):
            half[:, k] += whole[:, j] * root[:, j, k]
    rows = half.reshape(3, count, 3 * count)
    matrix = np.empty_like(rows)
    for k in range(3):
        matrix[k] = rows[k] * root[:, k, k, None]
        for j in range(k + 1, 3):
            matrix[k] += rows[j] * root[:, j, k, None]
    result = matrix.reshape(3 * count, 3 * count)
    result[np.diag_indices(3 * count)] += 1.0
    return result


def _solve_positive(matrix: AnyFloatArray, right: AnyFloatArray) -> AnyFloatArray:
    """Solve with a symmetric matrix (n, n).

    It is positive definite, unless a gel is that is unstable where the indenter does not hold it,
    or fading the refinement out has left the compliance indefinite by a hair.
    """
    potrf, potrs = linalg.get_lapack_funcs(("potrf", "potrs"), (matrix,))
    # LAPACK reads the transpose, which is the same matrix, without a copy.
    factor, info = potrf(matrix.T, lower=1, clean=0)
    if info != 0:
        return np.asarray(linalg.solve(matrix, right, assume_a="sym", check_finite=False))
    solved, _ = potrs(factor, right, lower=1)
    result: AnyFloatArray = solved.ravel()
    return result
