# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The equations that hold at equilibrium, their exact derivative, and a solution to rounding.

    K(u) : nodal forces - S^T f(x) = 0,        x = X + S u + B f(x),  B = S_f dG S_f^T

with friction in f limited by the current pressure. The derivative, H = df/dx not symmetric, is

    A = K - S^T H (1 - B H)^-1 S

It is not factored: GMRES solves it (Saad, "Iterative methods for sparse linear systems", 2003,
section 9.3.2), preconditioned by A with the stiffness of rest in place of K. The inverse of that
follows from the gel's compliance at rest by the Woodbury identity, since contact concerns few
nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from dotsim_ros.gel.adjoint.differentiable_contact import MarkerContact
from dotsim_ros.gel.implicit.refinement import Refinement
from dotsim_ros.gel.implicit.tangent import degrees_of_freedom
from dotsim_ros.io.arrays import Float32Array, FloatArray, IndexArray

SETTLED_M = 1.0e-10
"""Newton's method ends when an iteration moves neither a marker nor a node farther."""
LARGEST_MOVE_M = 50.0e-6
"""An iteration moves nothing farther: the contact's stiffness changes over some micrometres."""
ITERATIONS = 60
DIFFERENCE_M = 1.0e-9
"""The stiffness comes from forces at nodes that are moved this far at most: its error is some 1e-6
of it."""
STEPS = 120
"""Of GMRES at most: 5 to 10 are usual, a ball 2.4 mm in a pad of 4 mm takes 35."""
FORCING = 1.0e-3
"""An iteration of Newton's method leaves this share of its residual."""
EXACT = 1.0e-7
"""The adjoint's solve leaves this share of what it is given."""


class NoEquilibriumError(ArithmeticError):
    """Newton's method did not reach the equilibrium that derivatives need."""


class EquilibriumLinearisation:
    """A = K - C, with the contact's stiffness C on the nodes that it loads; A^T = K - C^T.

    Args:
        forces: nodal forces (N, 3) of elasticity and inertia at displacements (N, 3).
        displacement_m: (N, 3) where K is the derivative of the forces.
        rest: (3 N, 3 N) inverse of K at rest, m/N.
        node: (n,) the loaded nodes.
        contact: (3 n, 3 n) C.
    """

    def __init__(
        self,
        forces: Callable[[FloatArray], FloatArray],
        displacement_m: FloatArray,
        rest: Float32Array,
        node: IndexArray,
        contact: FloatArray,
    ) -> None:
        self._forces, self._displacement_m = forces, displacement_m
        self._force_n = forces(displacement_m)
        self._rest, self._contact = rest, contact
        self._dof = degrees_of_freedom(node)
        self._rows = rest[self._dof]
        self._loads: Callable[[Float32Array], Float32Array] | None = None
        if len(node):
            single = contact.astype(np.float32)
            yielding = np.eye(len(single), dtype=np.float32) - self._rows[:, self._dof] @ single
            factor = linalg.lu_factor(yielding, overwrite_a=True, check_finite=False)
            self._loads = lambda free: single @ linalg.lu_solve(factor, free, check_finite=False)

    def solve(self, right: FloatArray, share: float) -> FloatArray:
        """Return A^-1 right (3 N,), up to a residual of a share of right.

        Raises:
            NoEquilibriumError: GMRES did not converge.
        """
        size = float(np.linalg.norm(right))
        if size == 0.0:
            return np.zeros_like(right)
        basis = np.empty((STEPS + 1, len(right)))
        basis[0] = right / size
        steps = np.empty((STEPS, len(right)))
        projected = np.zeros((STEPS + 1, STEPS))
        target = np.zeros(STEPS + 1)
        target[0] = size
        for count in range(1, STEPS + 1):
            steps[count - 1] = self._solve_at_rest(basis[count - 1])
            image = self._product(steps[count - 1])
            # Twice, since rounding of what is taken away is left of it.
            for _ in range(2):
                along = basis[:count] @ image
                image -= along @ basis[:count]
                projected[:count, count - 1] += along
            length = projected[count, count - 1] = float(np.linalg.norm(image))
            here = projected[: count + 1, :count]
            shares = np.linalg.lstsq(here, target[: count + 1], rcond=None)[0]
            left = float(np.linalg.norm(here @ shares - target[: count + 1]))
            if left <= share * size:
                return np.asarray(shares @ steps[:count])
            basis[count] = image / length
        raise NoEquilibriumError(
            f"{left / size:.1e} of a load is left after {STEPS} steps of GMRES, expected "
            f"{share:.0e}; press less deep"
        )

    def _product(self, step: FloatArray) -> FloatArray:
        """Return A times a step (3 N,)."""
        scale = DIFFERENCE_M / float(np.abs(step).max())
        moved = self._displacement_m + scale * step.reshape(-1, 3)
        image = (self._forces(moved) - self._force_n).ravel() / scale
        image[self._dof] -= self._contact @ step[self._dof]
        return np.asarray(image)

    def _solve_at_rest(self, right: FloatArray) -> Float32Array:
        """Return about (K0 - C)^-1 right, for the stiffness K0 at rest."""
        moved = linalg.blas.ssymv(1.0, self._rest.T, right.astype(np.float32))
        if self._loads is not None:
            moved += self._loads(moved[self._dof]) @ self._rows
        return np.asarray(moved)


@dataclass(frozen=True)
class FinePart:
    """B between some markers: their weights (C, F) on the refinement's nodes next to them, and the
    compliance (3 F, 3 F) of those, m/N."""

    node: IndexArray
    weight: sparse.csr_matrix
    compliance: FloatArray

    def displacement(self, force_n: FloatArray) -> FloatArray:
        """Return B f (C, 3) for forces (C, 3)."""
        nodal = (self.compliance @ (self.weight.T @ force_n).ravel()).reshape(-1, 3)
        moved: FloatArray = self.weight @ nodal
        return moved

    def dense(self, rows: NDArray[np.int64]) -> FloatArray:
        """Return B (3 A, 3 A) between the given markers."""
        spread = sparse.kron(self.weight[rows], sparse.eye(3), format="csr")
        result: FloatArray = spread @ (spread @ self.compliance).T
        return result


def fine_part(refinement: Refinement, marker: IndexArray) -> FinePart:
    """Return the refinement as the given markers see it."""
    weight = refinement.skin_weight[marker]
    node = np.unique(weight.indices).astype(np.int32)
    return FinePart(node, weight[:, node], refinement.dense(node).astype(np.float64))


def contact_response_matrix(
    stiffness: FloatArray, fine: FinePart | None, rows: NDArray[np.int64]
) -> FloatArray:
    """Return (3 A, 3 A) H (1 - B H)^-1 of markers with df/dx (A, 3, 3), `rows` of the fine part:
    how their forces answer a displacement of the grid."""
    count = len(stiffness)
    blocks = np.zeros((count, 3, count, 3))
    blocks[np.arange(count), :, np.arange(count), :] = stiffness
    own = blocks.reshape(3 * count, 3 * count)
    if fine is None:
        return own
    yielding = np.eye(len(own)) - own @ fine.dense(rows)
    # H (1 - B H)^-1 = (1 - H B)^-1 H
    return np.asarray(linalg.solve(yielding, own))


def contact_on_nodes(
    response: FloatArray, weight: sparse.csr_matrix, node: IndexArray
) -> FloatArray:
    """Return S^T R S (3 n, 3 n) on the given nodes, for R (3 A, 3 A) and weights (A, N)."""
    spread = sparse.kron(weight[:, node], sparse.eye(3), format="csr")
    result: FloatArray = spread.T @ (spread.T @ response.T).T
    return result


@dataclass(frozen=True)
class Equilibrium:
    """A settled gel.

    Attributes:
        displacement_m: (N, 3) of the nodes.
        force_n, pressure_pa: (C, 3) and (C,) of the candidate markers.
        residual_m: how far the last iteration moved anything.
    """

    displacement_m: FloatArray
    force_n: FloatArray
    pressure_pa: FloatArray
    residual_m: float


@dataclass(frozen=True)
class Candidates:
    """The markers that may be in contact.

    Attributes:
        marker: (C,) their numbers.
        rest_position_m, start_m: (C, 3) their positions at rest and in the state to begin with.
        weight: (C, N) their weights.
        fine: what the refinement adds, if there is one.
        respond: the contact of some of them (their rows) at positions (A, 3).
    """

    marker: IndexArray
    rest_position_m: FloatArray
    start_m: FloatArray
    weight: sparse.csr_matrix
    fine: FinePart | None
    respond: Callable[[NDArray[np.int64], FloatArray], MarkerContact]


def settle(
    start_m: FloatArray,
    rest: Float32Array,
    forces: Callable[[FloatArray], FloatArray],
    candidates: Candidates | None,
) -> Equilibrium:
    """Solve the equations at equilibrium to rounding, from a state close to it.

    Args:
        start_m: (N, 3) displacements of the nodes.
        rest: (3 N, 3 N) inverse of the stiffness at rest, m/N.
        forces: nodal forces (N, 3) of elasticity and inertia at displacements (N, 3).
        candidates: None without an indenter.

    Raises:
        NoEquilibriumError: it did not converge.
    """
    if candidates is None:
        return _settle_free(start_m, rest, forces)
    return _Settling(start_m, rest, forces, candidates).run()


def _settle_free(
    start_m: FloatArray,
    rest: Float32Array,
    forces: Callable[[FloatArray], FloatArray],
) -> Equilibrium:
    displacement, moved = start_m, np.inf
    nowhere = np.zeros(0, dtype=np.int32), np.zeros((0, 0))
    for _ in range(ITERATIONS):
        linear = EquilibriumLinearisation(forces, displacement, rest, *nowhere)
        step = linear.solve(-forces(displacement).ravel(), FORCING).reshape(-1, 3)
        displacement, moved = displacement + step, float(np.abs(step).max())
        if moved < SETTLED_M:
            return Equilibrium(displacement, np.zeros((0, 3)), np.zeros(0), moved)
    raise NoEquilibriumError(f"the free gel still moves by {moved:.2e} m an iteration")


class _Settling:
    """Newton's method."""

    def __init__(
        self,
        start_m: FloatArray,
        rest: Float32Array,
        forces: Callable[[FloatArray], FloatArray],
        candidates: Candidates,
    ) -> None:
        self.displacement_m, self.rest = start_m, rest
        self.forces, self.candidates = forces, candidates
        self.position_m = candidates.start_m
        self.moved_m = np.inf

    def run(self) -> Equilibrium:
        scale = 1.0
        for iteration in range(ITERATIONS):
            before = self.moved_m
            self.moved_m = self._iterate(scale)
            if self.moved_m < SETTLED_M and scale == 1.0:
                contact = self._contact(np.arange(len(self.position_m)))
                return Equilibrium(
                    self.displacement_m, contact.force_n, contact.pressure_pa, self.moved_m
                )
            # A marker that goes to and fro between stick and slip is caught by shorter steps.
            scale = 0.5 if iteration > 8 and self.moved_m > 0.5 * before else 1.0
        raise NoEquilibriumError(
            f"the gel still moves by {self.moved_m:.2e} m an iteration, expected less than "
            f"{SETTLED_M:.0e} m; move the indenter in smaller steps"
        )

    def _contact(self, rows: NDArray[np.int64]) -> MarkerContact:
        return self.candidates.respond(rows, self.position_m[rows])

    def _iterate(self, scale: float) -> float:
        c = self.candidates
        every = np.arange(len(c.marker))
        force = self._contact(every).force_n
        active = np.flatnonzero(np.any(force != 0.0, axis=1))
        lag = c.rest_position_m + c.weight @ self.displacement_m - self.position_m
        if c.fine is not None:
            lag += c.fine.displacement(force)
        contact = self._contact(active)
        own = contact.stiffness()
        response = contact_response_matrix(own, c.fine, active)
        weight = c.weight[active]
        right = c.weight.T @ force - self.forces(self.displacement_m)
        right += weight.T @ (response @ lag[active].ravel()).reshape(-1, 3)
        node = np.unique(weight.indices).astype(np.int32)
        loaded = contact_on_nodes(response, weight, node)
        linear = EquilibriumLinearisation(self.forces, self.displacement_m, self.rest, node, loaded)
        step = linear.solve(right.ravel(), FORCING).reshape(-1, 3)
        move = c.weight @ step + lag
        if c.fine is not None and len(active):
            change = np.zeros_like(force)
            change[active] = (response @ move[active].ravel()).reshape(-1, 3)
            move += c.fine.displacement(change)
        moved = max(float(np.abs(move).max(initial=0.0)), float(np.abs(step).max()))
        scale = min(scale, LARGEST_MOVE_M / max(moved, LARGEST_MOVE_M))
        self.displacement_m = self.displacement_m + scale * step
        self.position_m = self.position_m + scale * move
        return moved
