# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The equations that hold at equilibrium, their exact derivative, and a solution to rounding.

    K(u) : nodal forces - S^T f(x) = 0,        x = X + S u + B f(x),  B = S_f dG S_f^T

with friction in f limited by the current pressure. The derivative, H = df/dx not symmetric, is

    A = K - S^T H (1 - B H)^-1 S

K is factored alone; the contact, which concerns few nodes, enters by the Woodbury identity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from dotsim_ros.gel.adjoint.differentiable_contact import MarkerContact
from dotsim_ros.gel.implicit.block_solver import BlockCholesky
from dotsim_ros.gel.implicit.refinement import Refinement
from dotsim_ros.io.arrays import FloatArray, IndexArray

SETTLED_M = 1.0e-12
"""Newton's method ends when an iteration moves neither a marker nor a node farther."""
LARGEST_MOVE_M = 50.0e-6
"""An iteration moves nothing farther: the contact's stiffness changes over some micrometres."""
ITERATIONS = 60
NEARBY_M = 0.1e-3
"""Markers closer than this to the indenter may come into contact while the gel settles."""


class NoEquilibriumError(ArithmeticError):
    """Newton's method did not reach the equilibrium that derivatives need."""


class ElasticFactor:
    """The stiffness of the gel without contact, factored, and its inverse at some nodes.

    Args:
        stiffness: (3 N, 3 N), symmetric.
        node_cell: (N, 3) grid coordinates of the nodes.
        node: (n,) nodes that contact may load.
    """

    def __init__(
        self, stiffness: sparse.csr_matrix, node_cell: NDArray[np.int64], node: IndexArray
    ) -> None:
        self.node = node
        self.dof = (3 * node[:, None] + np.arange(3)).ravel()
        self.solve: Callable[[Any], Any]
        try:
            self.solve = BlockCholesky(stiffness, node_cell).solve
        except np.linalg.LinAlgError:
            # Held by the indenter alone, a strongly compressed gel may be indefinite without it.
            self.solve = splu(stiffness.tocsc()).solve
        unit = np.zeros((stiffness.shape[0], len(self.dof)))
        unit[self.dof, np.arange(len(self.dof))] = 1.0
        self.compliance: FloatArray = self.solve(unit)[self.dof]


class EquilibriumLinearisation:
    """A = K - C on the factor's nodes, with the contact's stiffness C (3 n, 3 n)."""

    def __init__(self, elastic: ElasticFactor, contact: FloatArray) -> None:
        self.elastic, self.contact = elastic, contact

    def solve(self, right: FloatArray) -> FloatArray:
        """Return A^-1 right (3 N,)."""
        return self._solve(right, self.contact)

    def solve_transposed(self, right: FloatArray) -> FloatArray:
        """Return A^-T right (3 N,)."""
        return self._solve(right, self.contact.T)

    def _solve(self, right: FloatArray, contact: FloatArray) -> FloatArray:
        elastic = self.elastic
        if len(elastic.dof) == 0:
            return np.asarray(elastic.solve(right))
        free = elastic.solve(right)[elastic.dof]
        matrix = np.eye(len(free)) - elastic.compliance @ contact
        loaded = right.copy()
        loaded[elastic.dof] += contact @ linalg.solve(matrix, free)
        return np.asarray(elastic.solve(loaded))


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
    distance: Callable[[FloatArray], FloatArray]


def settle(
    start_m: FloatArray,
    node_cell: NDArray[np.int64],
    forces: Callable[[FloatArray], FloatArray],
    stiffness: Callable[[FloatArray], sparse.csr_matrix],
    candidates: Candidates | None,
) -> Equilibrium:
    """Solve the equations at equilibrium to rounding, from a state close to it.

    Args:
        start_m: (N, 3) displacements of the nodes.
        node_cell: (N, 3) grid coordinates of the nodes.
        forces: nodal forces (N, 3) of elasticity and inertia at displacements (N, 3).
        stiffness: their derivative (3 N, 3 N).
        candidates: None without an indenter.

    Raises:
        NoEquilibriumError: it did not converge.
    """
    if candidates is None:
        return _settle_free(start_m, node_cell, forces, stiffness)
    return _Settling(start_m, node_cell, forces, stiffness, candidates).run()


def _settle_free(
    start_m: FloatArray,
    node_cell: NDArray[np.int64],
    forces: Callable[[FloatArray], FloatArray],
    stiffness: Callable[[FloatArray], sparse.csr_matrix],
) -> Equilibrium:
    displacement, moved = start_m, np.inf
    for _ in range(ITERATIONS):
        factor = ElasticFactor(stiffness(displacement), node_cell, np.zeros(0, dtype=np.int32))
        step = factor.solve(-forces(displacement).ravel()).reshape(-1, 3)
        displacement, moved = displacement + step, float(np.abs(step).max())
        if moved < SETTLED_M:
            return Equilibrium(displacement, np.zeros((0, 3)), np.zeros(0), moved)
    raise NoEquilibriumError(f"the free gel still moves by {moved:.2e} m an iteration")


class _Settling:
    """Newton's method; the stiffness is renewed only while it changes much."""

    def __init__(
        self,
        start_m: FloatArray,
        node_cell: NDArray[np.int64],
        forces: Callable[[FloatArray], FloatArray],
        stiffness: Callable[[FloatArray], sparse.csr_matrix],
        candidates: Candidates,
    ) -> None:
        self.displacement_m, self.node_cell = start_m, node_cell
        self.forces, self.stiffness, self.candidates = forces, stiffness, candidates
        self.position_m = candidates.start_m
        self.factor: ElasticFactor | None = None
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
            if iteration > 8 and self.moved_m > 0.5 * before:
                scale, self.factor = 0.5, None
            else:
                scale = 1.0
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
        factor = self._renew_factor(weight)
        right = c.weight.T @ force - self.forces(self.displacement_m)
        right += weight.T @ (response @ lag[active].ravel()).reshape(-1, 3)
        solver = EquilibriumLinearisation(factor, contact_on_nodes(response, weight, factor.node))
        step = solver.solve(right.ravel()).reshape(-1, 3)
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

    def _renew_factor(self, weight: sparse.csr_matrix) -> ElasticFactor:
        needed = np.unique(weight.indices)
        if self.factor is None or not np.all(np.isin(needed, self.factor.node)):
            near = self.candidates.distance(self.position_m) < NEARBY_M
            node = np.union1d(np.unique(self.candidates.weight[near].indices), needed)
            stiffness = self.stiffness(self.displacement_m)
            self.factor = ElasticFactor(stiffness, self.node_cell, node.astype(np.int32))
        return self.factor
