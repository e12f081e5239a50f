# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frictional contact of a few markers on a gel that responds linearly to their forces.

Once elasticity is linearised, the markers' positions are x = b + C (f - f0): b is where they would
be under forces f0, C the compliance between them. The markers lie closer together than the gel's
splines can bend, so C has a fraction of its full rank: C = L L^T with few columns, found by pivoted
Cholesky decomposition (Higham, "Accuracy and Stability of Numerical Algorithms", 2002, chapter 10).
With z = L^T (f - f0), x = b + L z, and the forces of the indenter, f = F(x), minimise

    E(z) = z . z / 2 + f0 . L z + psi(x)

with the contact's energy psi at a lagged friction limit (Wriggers, "Computational Contact
Mechanics", 2006, section 9.3.2). Newton's method on it solves for z, so that markers may begin and
cease to touch, stick and slip at little cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from dotsim_ros.gel.implicit.contact import ContactResponse, Lag
from dotsim_ros.io.arrays import AnyFloatArray, FloatArray

ITERATIONS = 60
NEAR = 700.0
"""Newton's method on Coulomb's law is first tried at so many tolerances..."""
CLOSE = 30.0
"""...and again where the one on the energy ends, at so many tolerances..."""
CLOSER = 0.3
"""...and at this share of them when it is asked again."""
CORRECTIONS = 8
DIVERGING = 20.0
"""It ends without success once the markers are this much farther from balance than at best..."""
RISE, RISES = 2.0, 2
"""...or so many times as far for so many times."""
SMALLEST_SCALE = 1.0e-3
SMALLEST_SHARE = 0.1
"""Of a correction that turns back."""


@dataclass(frozen=True)
class Answers:
    """How the indenter answers markers at positions (A, 3): with friction limited by a lag, and by
    the pressure that there is."""

    lagged: Callable[[FloatArray, Lag], ContactResponse]
    present: Callable[[FloatArray], ContactResponse]


@dataclass(frozen=True)
class Guess:
    """Where the markers may come to lie (A, 3), and the indenter's forces on them (A, 3)."""

    position_m: FloatArray
    force_n: FloatArray


@dataclass(frozen=True)
class ContactSolution:
    """The markers in contact.

    Attributes:
        force_n: (A, 3) f.
        response: at the positions that f causes.
        lag: what limits friction.
        iterations: of Newton's method.
        is_solved: whether the tolerance was met; if not, it is the best that was found.
    """

    force_n: FloatArray
    response: ContactResponse
    lag: Lag
    iterations: int
    is_solved: bool


def by_component(vectors: FloatArray) -> FloatArray:
    """Return vectors (A, 3) as (3 A,) with all x first, the order of a compliance's rows."""
    components: FloatArray = vectors.T.ravel()
    return components


def by_marker(components: AnyFloatArray) -> FloatArray:
    """Return (3 A,) components as vectors (A, 3)."""
    return np.ascontiguousarray(components.reshape(3, -1).T, dtype=np.float64)


def compliance_root(compliance: AnyFloatArray, negligible_m_n: float) -> AnyFloatArray:
    """Return L (A, 3, k) with C = L L^T up to a compliance that does not matter.

    Args:
        compliance: (3 A, 3 A) C, m/N, rows and columns by component; what makes it indefinite by a
            hair is left out.
        negligible_m_n: no marker's own compliance differs by more.

    Raises:
        numpy.linalg.LinAlgError: the compliance is not finite, as that of a gel that has diverged.
    """
    root = pivoted_root(compliance, negligible_m_n)
    if not root.shape[1]:
        raise np.linalg.LinAlgError("the gel has diverged: its compliance is not finite")
    count, columns = len(root) // 3, root.shape[1]
    return np.ascontiguousarray(root.reshape(3, count, columns).transpose(1, 0, 2))


def pivoted_root(matrix: AnyFloatArray, negligible: float) -> AnyFloatArray:
    """Return (n, k) whose product with its transpose is a positive matrix (n, n), up to a diagonal
    that is negligible."""
    (pstrf,) = linalg.get_lapack_funcs(("pstrf",), (matrix,))
    # LAPACK reads the transpose, which is the same matrix.
    factor, pivot, rank, _ = pstrf(matrix.T, tol=negligible, lower=1)
    root: AnyFloatArray = np.empty((len(matrix), rank), dtype=matrix.dtype)
    root[pivot - 1] = np.tril(factor[:, :rank])
    return root


@dataclass(frozen=True)
class _ContactState:
    """z (k,), the forces' change f - f0 (A, 3) that it stands for, what it causes, L z (A, 3), how
    the indenter answers there, and the energy, J."""

    reduced: AnyFloatArray
    change: AnyFloatArray
    caused: AnyFloatArray
    response: ContactResponse
    energy_j: float


@dataclass(frozen=True)
class _Correction:
    """Newton's step of z (k,) on Coulomb's law, and the share of it that was taken."""

    step: AnyFloatArray
    share: float


class _ContactProblem:
    """L, b, f0 and the indenter's answers."""

    def __init__(
        self, root: AnyFloatArray, base_m: FloatArray, force_n: FloatArray, answers: Answers
    ) -> None:
        self.root, self.base_m, self.force_n = root, base_m, force_n
        self.answers = answers
        # (3 A, k), the same memory.
        self._flat = root.reshape(-1, root.shape[-1])
        self.iterations = 0

    def moved(self, reduced: AnyFloatArray) -> AnyFloatArray:
        """Return L z (A, 3)."""
        return (self._flat @ reduced).reshape(-1, 3)

    def reduce(self, change: AnyFloatArray) -> AnyFloatArray:
        """Return L^T f (k,) of forces (A, 3)."""
        result: AnyFloatArray = change.ravel() @ self._flat
        return result

    def begin_with(self, change: FloatArray, lag: Lag) -> _ContactState:
        """Return the state of forces that differ from f0 by (A, 3)."""
        single = change.astype(self.root.dtype)
        reduced = self.reduce(single)
        return self.at(reduced, single, self.moved(reduced), lag)

    def begin_at(self, guess_m: FloatArray) -> tuple[_ContactState, Lag]:
        """Return the state of an indenter that answers linearly, as it does near markers at (A, 3),
        and what limits friction there.

        A contact is so stiff that the positions which guessed forces cause say little of who
        touches: a hundredth of a millimetre opens or closes it. Guessed positions do.
        """
        self.iterations += 1
        response = self.answers.present(guess_m)
        away = np.einsum("aij,aj->ai", response.stiffness, guess_m - self.base_m)
        change = (response.force_n - self.force_n + away).astype(self.root.dtype)
        reduced, moved, force = _coulomb_step(self.root, -self.reduce(change), response)
        lag = Lag(response.pressure_pa, response.normal)
        return self.at(reduced, change + force, moved, None), lag

    def limited(self, state: _ContactState, lag: Lag) -> _ContactState:
        """Return the same state with friction limited by a lag."""
        return self.at(state.reduced, state.change, state.caused, lag)

    def at(
        self,
        reduced: AnyFloatArray,
        change: AnyFloatArray,
        caused: AnyFloatArray,
        lag: Lag | None,
    ) -> _ContactState:
        """Return the state of z; without a lag, with the pressure that there is."""
        position: FloatArray = self.base_m + caused
        if lag is None:
            response = self.answers.present(position)
        else:
            response = self.answers.lagged(position, lag)
        energy = 0.5 * float(reduced @ reduced) + float(np.vdot(self.force_n, caused))
        return _ContactState(reduced, change, caused, response, energy + response.energy_j)

    def answered(self, state: _ContactState) -> AnyFloatArray:
        """Return the change of the forces (A, 3) that the indenter answers with."""
        return (state.response.force_n - self.force_n).astype(self.root.dtype)

    def out_of_balance(self, state: _ContactState) -> AnyFloatArray:
        """Return the energy's derivative by z (k,): z - L^T (F - f0)."""
        return state.reduced - self.reduce(self.answered(state))

    def farthest(self, reduced: AnyFloatArray) -> float:
        """Return how far z (k,) moves any marker at most."""
        return float(np.abs(self._flat @ reduced).max())

    def descend(
        self, state: _ContactState, out_of_balance: AnyFloatArray, lag: Lag
    ) -> tuple[_ContactState, bool]:
        """Return the state after a Newton step that lowers the energy, and whether there is one."""
        self.iterations += 1
        step, moved, force = _newton_step(self.root, out_of_balance, state.response)
        change = self.answered(state) + force - state.change
        slope = float(out_of_balance @ step)
        scale = 1.0
        while scale >= SMALLEST_SCALE:
            share = self.root.dtype.type(scale)
            trial = self.at(
                state.reduced + share * step,
                state.change + share * change,
                state.caused + share * moved,
                lag,
            )
            # Single precision: a decrease below rounding is none.
            allowed = state.energy_j + 1e-4 * scale * slope + 1e-6 * abs(state.energy_j)
            if trial.energy_j <= allowed:
                return trial, True
            scale *= 0.5
        return state, False

    def correct(
        self, state: _ContactState, out_of_balance: AnyFloatArray, before: _Correction | None
    ) -> tuple[_ContactState, _Correction]:
        """Return the state after a Newton step on Coulomb's law as it is, and the step; after one
        before that it would turn back, as much of it as both suggest."""
        self.iterations += 1
        step, moved, force = _coulomb_step(self.root, out_of_balance, state.response)
        scale = 1.0 if before is None else _share(step, before)
        share = self.root.dtype.type(scale)
        change = state.change + share * (self.answered(state) + force - state.change)
        corrected = self.at(
            state.reduced + share * step, change, state.caused + share * moved, None
        )
        return corrected, _Correction(step, scale)

    def solution(self, state: _ContactState, is_solved: bool) -> ContactSolution:
        """Return what a state amounts to."""
        lag = Lag(state.response.pressure_pa, state.response.normal)
        force = self.force_n + state.change
        return ContactSolution(force, state.response, lag, self.iterations, is_solved)


def solve_contact(
    root: AnyFloatArray,
    base_m: FloatArray,
    force_n: FloatArray,
    answers: Answers,
    *,
    guess: Guess,
    passes: int,
    tolerance_m: float,
) -> ContactSolution:
    """Return the contact forces of the linear gel.

    Newton's method on Coulomb's law goes first, from where the markers are guessed to be. Where
    that is far from balance or does not converge, Newton's method on the energy with lagged
    friction, which converges from anywhere, goes closer to the solution, and closer each time; it
    begins with the guess whose energy is lower.

    Args:
        root: (A, 3, k) L, see `compliance_root`.
        base_m: (A, 3) b.
        force_n: (A, 3) f0.
        answers: the indenter's.
        guess: of the solution.
        passes: how often the limit is renewed at most.
        tolerance_m: how far the markers may be from where the indenter's answer would take them.
    """
    problem = _ContactProblem(root, base_m, force_n, answers)
    known, lag = problem.begin_at(guess.position_m)
    best: tuple[float, _ContactState] = (np.inf, known)
    if problem.farthest(problem.out_of_balance(known)) < NEAR * tolerance_m:
        best = _corrected(problem, known, tolerance_m)
    if best[0] < tolerance_m:
        return problem.solution(best[1], is_solved=True)
    close_m = CLOSE * tolerance_m
    states = (problem.limited(known, lag), problem.begin_with(guess.force_n - force_n, lag))
    state = min(states, key=lambda begun: begun.energy_j)
    for _ in range(passes):
        state = _descended(problem, state, lag, close_m)
        known = problem.at(state.reduced, state.change, state.caused, None)
        best = min(best, _corrected(problem, known, tolerance_m), key=lambda found: found[0])
        if best[0] < tolerance_m:
            break
        lag = Lag(known.response.pressure_pa, known.response.normal)
        state, close_m = problem.limited(known, lag), CLOSER * close_m
    left_m, state = best
    return problem.solution(state, left_m < tolerance_m)


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
    count = len(force_n)
    stiffness = response.stiffness.astype(compliance.dtype)
    change = by_component(response.force_n - force_n).astype(compliance.dtype)
    out_of_balance = -by_component(free_m).astype(compliance.dtype) - compliance @ change
    # Each marker answers to its own motion alone.
    matrix = np.einsum("aim,mij->ajm", compliance.reshape(-1, 3, count), stiffness)
    matrix = matrix.reshape(3 * count, 3 * count)
    matrix[np.diag_indices(3 * count)] += 1.0
    moved = by_marker(linalg.solve(matrix, -out_of_balance, overwrite_a=True, check_finite=False))
    return force_n + by_marker(change) - np.einsum("nij,nj->ni", stiffness, moved)


def _corrected(
    problem: _ContactProblem, state: _ContactState, tolerance_m: float
) -> tuple[float, _ContactState]:
    """Return the best state of Newton's method on Coulomb's law, and how far from balance it is."""
    before = None
    best = (np.inf, state)
    rises = 0
    for _ in range(CORRECTIONS + 1):
        out_of_balance = problem.out_of_balance(state)
        left = problem.farthest(out_of_balance)
        rises += left > RISE * best[0]
        if left < best[0]:
            best = (left, state)
        if left < tolerance_m or left > DIVERGING * best[0] or rises == RISES:
            break
        state, before = problem.correct(state, out_of_balance, before)
    return best


def _share(step: AnyFloatArray, before: _Correction) -> float:
    """Return the share of a step to take after another one: where markers that slip and stick by
    turns throw it to and fro, where both would meet (Irons and Tuck, "A version of the Aitken
    accelerator for computer iteration", 1969)."""
    change = step - before.step
    size = float(change @ change)
    if size == 0.0:
        return 1.0
    share = -before.share * float(before.step @ change) / size
    return min(share, 1.0) if share > SMALLEST_SHARE else 1.0


def _descended(
    problem: _ContactProblem, state: _ContactState, lag: Lag, close_m: float
) -> _ContactState:
    """Return the state once the descent on the energy is within a given distance of its end."""
    has_descended = True
    while has_descended and problem.iterations < ITERATIONS:
        out_of_balance = problem.out_of_balance(state)
        if problem.farthest(out_of_balance) < close_m:
            break
        state, has_descended = problem.descend(state, out_of_balance, lag)
    return state


def _newton_step(
    root: AnyFloatArray, out_of_balance: AnyFloatArray, response: ContactResponse
) -> tuple[AnyFloatArray, AnyFloatArray, AnyFloatArray]:
    """Return Newton's step of z (k,), how it moves the markers (A, 3), and by how much (A, 3) the
    linearised contact answers otherwise: with the touching markers' stiffness H,
    (1 + L^T H L) dz = -r, and -H L dz."""
    active = np.flatnonzero(np.einsum("aii->a", response.stiffness) > 0.0)
    own = response.stiffness[active].astype(root.dtype)
    touching = np.ascontiguousarray(root[active])
    size, columns = 3 * len(active), root.shape[-1]
    loaded = np.matmul(own, touching).reshape(size, columns)
    matrix = touching.reshape(size, columns).T @ loaded
    matrix[np.diag_indices(columns)] += 1.0
    potrf, potrs = linalg.get_lapack_funcs(("potrf", "potrs"), (matrix,))
    # LAPACK reads the transpose, which is the same matrix, without a copy.
    factor, info = potrf(matrix.T, lower=1, clean=0)
    if info == 0:
        step, _ = potrs(factor, -out_of_balance, lower=1)
    else:
        step = linalg.solve(matrix, -out_of_balance, assume_a="sym", check_finite=False)
    return _answered_step(root, step, active, loaded)


def _coulomb_step(
    root: AnyFloatArray, out_of_balance: AnyFloatArray, response: ContactResponse
) -> tuple[AnyFloatArray, AnyFloatArray, AnyFloatArray]:
    """Return the same for a stiffness H that is not symmetric."""
    active = np.flatnonzero(response.pressure_pa > 0.0)
    own = response.stiffness[active].astype(root.dtype)
    touching = np.ascontiguousarray(root[active])
    size, columns = 3 * len(active), root.shape[-1]
    loaded = np.matmul(own, touching).reshape(size, columns)
    matrix = touching.reshape(size, columns).T @ loaded
    matrix[np.diag_indices(columns)] += 1.0
    getrf, getrs = linalg.get_lapack_funcs(("getrf", "getrs"), (matrix,))
    # LAPACK reads the transpose.
    factor, pivots, info = getrf(matrix.T, overwrite_a=1)
    step = -out_of_balance
    if info == 0:
        step, _ = getrs(factor, pivots, step, trans=1)
    return _answered_step(root, step, active, loaded)


def _answered_step(
    root: AnyFloatArray,
    step: AnyFloatArray,
    active: NDArray[np.int64],
    loaded: AnyFloatArray,
) -> tuple[AnyFloatArray, AnyFloatArray, AnyFloatArray]:
    """Return a step of z (k,), how it moves the markers (A, 3), and what those that touch answer,
    for H L (3 a, k) of these."""
    moved = (root.reshape(-1, root.shape[-1]) @ step).reshape(-1, 3)
    force = np.zeros_like(moved)
    force[active] = -(loaded @ step).reshape(-1, 3)
    return step, moved, force
