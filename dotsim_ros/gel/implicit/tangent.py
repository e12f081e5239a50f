# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Linear solves of Newton's method on the gel: exact and sparse, or fast and local.

The fast one uses what a press looks like. Far from the indenter the gel barely strains, so its
stiffness there is that of rest, whose inverse G is computed once. Near the indenter (the region R)
the stiffness is assembled again. The step of the region's unknowns solves the small dense system

    (G_RR^-1 + K_RR(u) - K_RR(0)) du_R = G_RR^-1 (G r)_R

and the rest of the gel follows: du = G r + G_R z, z = G_RR^-1 (du_R - (G r)_R). This is a block
elimination (static condensation, Guyan 1965) of the far unknowns with their rest stiffness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from dotsim_ros.gel.elasticity import ElasticBody, region_base
from dotsim_ros.gel.implicit.block_solver import BlockCholesky
from dotsim_ros.io.arrays import BoolArray, Float32Array, FloatArray, IndexArray


@dataclass(frozen=True)
class GridRegion:
    """A part of the grid around the contact.

    Attributes:
        node: (R,) its nodes, in the order of its unknowns.
        number: (N,) the number of each node in it, -1 outside.
        cell: (C,) the cells all of whose nodes are in it.
        base: (C, 27, 27) positions of the cells' blocks in the region's matrix.
        dof: (3 R,) its unknowns.
        compliance_columns: (3 N, 3 R) columns of G.
        condensed: (3 R, 3 R) inverse of G_RR.
        rest: (3 R, 3 R) stiffness of the cells at rest.
    """

    node: IndexArray
    number: IndexArray
    cell: IndexArray
    base: IndexArray
    dof: IndexArray
    compliance_columns: Float32Array
    condensed: Float32Array
    rest: Float32Array


def inverse_of_positive(matrix: Float32Array) -> Float32Array:
    """Return the inverse of a symmetric positive definite matrix.

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """
    factor, info = linalg.lapack.spotrf(matrix, lower=1)
    if info != 0:
        raise np.linalg.LinAlgError(f"matrix of {len(matrix)} rows is not positive definite")
    inverse, _ = linalg.lapack.spotri(factor, lower=1, overwrite_c=1)
    lower = np.tril(inverse)
    result: Float32Array = np.ascontiguousarray(lower + np.tril(inverse, -1).T)
    return result


def without(inverse: Float32Array, is_kept: BoolArray) -> Float32Array:
    """Return the inverse of a matrix between the nodes (R,) that are kept, from that between all
    (3 R, 3 R)."""
    if is_kept.all():
        return inverse
    keep = degrees_of_freedom(np.flatnonzero(is_kept).astype(np.int32))
    drop = degrees_of_freedom(np.flatnonzero(~is_kept).astype(np.int32))
    rows = inverse.take(keep, axis=0)
    across = rows.take(drop, axis=1)
    dropped = inverse_of_positive(np.asfortranarray(inverse.take(drop, axis=0).take(drop, axis=1)))
    result: Float32Array = rows.take(keep, axis=1)
    result -= (across @ dropped) @ across.T
    return result


def bordered(
    inverse: Float32Array, matrix: Float32Array, first: IndexArray, added: IndexArray
) -> Float32Array:
    """Return the inverse between rows (n,) and added rows (m,) of a symmetric positive definite
    matrix, first ones first, from that (n, n) between the first ones (Hager, "Updating the inverse
    of a matrix", 1989)."""
    if len(added) == 0:
        return inverse
    rows = matrix.take(added, axis=0)
    across = inverse @ rows.take(first, axis=1).T
    own = rows.take(added, axis=1) - rows.take(first, axis=1) @ across
    corner = inverse_of_positive(np.asfortranarray(own, dtype=np.float32))
    side = across @ corner
    count = len(first)
    result: Float32Array = np.empty((count + len(added),) * 2, dtype=np.float32)
    result[:count, :count] = inverse + side @ across.T
    result[:count, count:] = -side
    result[count:, :count] = -side.T
    result[count:, count:] = corner
    return result


SHARED = 0.35
"""A region is made from another one where they share more of their nodes than this."""
SHIFTS = (0.0, 1.0e-3, 1.0e-2, 1.0e-1, 1.0)
"""Shares of the mean diagonal that are added to a stiffness until it is positive definite (Nocedal
and Wright, algorithm 3.3); far from equilibrium a compressed gel's need not be."""

Factor = TypeVar("Factor")


def factor_shifted(factor: Callable[[float], Factor]) -> Factor:
    """Return `factor(share)` for the first of `SHIFTS` with which it succeeds.

    Raises:
        numpy.linalg.LinAlgError: it succeeds with none.
    """
    for share in SHIFTS[:-1]:
        try:
            return factor(share)
        except np.linalg.LinAlgError:
            continue
    return factor(SHIFTS[-1])


class ExactTangent:
    """The whole stiffness, assembled and factored again in every iteration: slow.

    A single precision body halves the time; it limits the step's accuracy, not the solution's.
    """

    def __init__(self, body: ElasticBody, extra: sparse.csr_matrix) -> None:
        self.body, self.extra = body, sparse.kron(extra, sparse.eye(3), format="csr")

    def factor(self, displacement_m: FloatArray, environment: int) -> ExactFactor:
        """Factor the stiffness at displacements (N, 3), made positive definite."""
        matrix = self.body.stiffness(displacement_m, environment) + self.extra
        matrix = matrix.astype(self.body.dtype).tocsr()
        mean = float(matrix.diagonal().mean())
        unit = sparse.eye(matrix.shape[0], dtype=matrix.dtype, format="csr")
        cell = self.body.discretization.node_cell
        return ExactFactor(
            factor_shifted(
                lambda share: BlockCholesky(
                    matrix + (share * mean) * unit if share else matrix, cell
                )
            ).solve,
            matrix.shape[0],
            self.body.dtype,
        )


@dataclass(frozen=True)
class ExactFactor:
    """The factored stiffness of the whole gel: its solution, its size and its precision."""

    inverse: Callable[[Any], Any]
    size: int
    dtype: type[np.floating]

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the step (3 N,) for forces (3 N,) anywhere."""
        return np.asarray(self.inverse(right.astype(self.dtype)), dtype=np.float64)

    def solve_loads(self, right: FloatArray) -> FloatArray:
        """Return the step (3 N,) for forces (3 N,) near the contact."""
        return self.solve(right)

    def between(self, node: IndexArray) -> NDArray[np.floating]:
        """Return (3 n, 3 n) of the inverse between nodes."""
        dof = degrees_of_freedom(node)
        unit = np.zeros((self.size, len(dof)), dtype=self.dtype)
        unit[dof, np.arange(len(dof))] = 1.0
        result: NDArray[np.floating] = np.asarray(self.inverse(unit), dtype=self.dtype)[dof]
        return result


def degrees_of_freedom(node: IndexArray) -> IndexArray:
    """Return (3 n,) unknowns of nodes (n,)."""
    dof: IndexArray = (3 * node[:, None] + np.arange(3)).ravel().astype(np.int32)
    return dof


@dataclass(frozen=True)
class LocalFactor:
    """A factored region; `solve` returns the step of the whole gel."""

    compliance: Float32Array
    region: GridRegion
    factor: tuple[Float32Array, bool]

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the step (3 N,) for residual forces (3 N,) anywhere."""
        free = linalg.blas.ssymv(1.0, self.compliance.T, right.astype(np.float32))
        region = self.region
        free_here = free[region.dof]
        local = region.condensed @ free_here
        step = linalg.cho_solve(self.factor, local, check_finite=False)
        change = region.condensed @ (step - free_here)
        whole: FloatArray = (free + region.compliance_columns @ change).astype(np.float64)
        return whole

    def solve_near(self, right: FloatArray) -> FloatArray:
        """Return the step (3 N,) for residual forces (3 N,): in the region for all of them, outside
        for those in the region."""
        region = self.region
        local = right[region.dof].astype(np.float32)
        free_here = region.compliance_columns.T @ right.astype(np.float32)
        step = linalg.cho_solve(self.factor, region.condensed @ free_here, check_finite=False)
        change = local + region.condensed @ (step - free_here)
        whole: FloatArray = (region.compliance_columns @ change).astype(np.float64)
        whole[region.dof] = step
        return whole

    def solve_loads(self, right: FloatArray) -> FloatArray:
        """Return the step (3 N,) for forces (3 N,) that are all in the region."""
        region = self.region
        local = right[region.dof].astype(np.float32)
        step = linalg.cho_solve(self.factor, local, check_finite=False)
        whole: FloatArray = (region.compliance_columns @ (region.condensed @ step)).astype(
            np.float64
        )
        return whole

    def between(self, node: IndexArray) -> Float32Array:
        """Return (3 n, 3 n) of the inverse between nodes of the region."""
        lower, _ = self.factor
        dof = degrees_of_freedom(self.region.number[node])
        # Those before the first of them do not matter: the forward solution is zero there.
        first = int(dof.min())
        unit = np.zeros((len(lower) - first, len(dof)), dtype=np.float32, order="F")
        unit[dof - first, np.arange(len(dof))] = 1.0
        half = linalg.blas.strsm(1.0, lower[first:, first:], unit, lower=1, overwrite_b=1)
        result: Float32Array = half.T @ half
        return result


def inverse_at_rest(
    body: ElasticBody, extra: sparse.csr_matrix | None = None, environment: int = 0
) -> Float32Array:
    """Return the (3 N, 3 N) inverse of a body's stiffness at rest, m/N.

    Args:
        body: the elastic body in single precision.
        extra: (N, N) further stiffness of every direction, such as mass over the squared step.
        environment: the one whose material it is.
    """
    rest = np.zeros((body.discretization.node_count, 3), dtype=np.float32)
    stiffness = body.stiffness(rest, environment)
    if extra is not None:
        stiffness = stiffness + sparse.kron(extra, sparse.eye(3))
    return inverse_of_positive(np.asfortranarray(stiffness.toarray().astype(np.float32)))


class LocalTangent:
    """The fast solve, in single precision (its error is one of the step, not of the solution).

    Args:
        body: the elastic body in single precision.
        compliance: (3 N, 3 N) its inverse at rest, as `inverse_at_rest` returns it.
    """

    def __init__(self, body: ElasticBody, compliance: Float32Array) -> None:
        self.body, self.compliance = body, compliance
        discretization = body.discretization
        self.rest = np.zeros((discretization.node_count, 3), dtype=np.float32)
        self.cell_centre_m = discretization.node_position_m[body.cells.node].mean(axis=1)
        self._mean_gradient = _mean_gradient(body)

    def cell_gradient(self, displacement_m: FloatArray) -> FloatArray:
        """Return the norm (C,) of each cell's mean displacement gradient at displacements (N, 3):
        how far from that of rest its stiffness is."""
        gradient = (self._mean_gradient @ displacement_m).reshape(-1, 9)
        size: FloatArray = np.sqrt(np.einsum("ci,ci->c", gradient, gradient))
        return size

    def solve_at_rest(self, right: FloatArray) -> FloatArray:
        """Return the step (3 N,) with the stiffness of rest and no contact."""
        step = linalg.blas.ssymv(1.0, self.compliance.T, right.astype(np.float32))
        whole: FloatArray = step.astype(np.float64)
        return whole

    def region(
        self,
        cell: IndexArray,
        needed_node: IndexArray,
        environment: int,
        before: GridRegion | None = None,
    ) -> GridRegion:
        """Return the region of the given cells, with further nodes that contact needs, and with the
        rest stiffness of an environment's material: what relaxation remembers is part of it.
        Another region before it that is much like it saves time.

        Its nodes go from the farthest to those in the middle of the needed ones, which
        `LocalFactor.between` profits from.
        """
        node_of_cell = self.body.cells.node
        node = np.union1d(node_of_cell[cell], needed_node).astype(np.int32)
        position = self.body.discretization.node_position_m
        middle = position[needed_node].mean(axis=0)
        node = node[np.argsort(-np.linalg.norm(position[node] - middle, axis=1), kind="stable")]
        number = np.full(self.body.discretization.node_count, -1, dtype=np.int32)
        number[node] = np.arange(len(node), dtype=np.int32)
        inside = np.flatnonzero(np.all(number[node_of_cell] >= 0, axis=1)).astype(np.int32)
        dof = degrees_of_freedom(node)
        base = region_base(node_of_cell[inside], number, len(dof))
        rows = self.compliance[dof]
        condensed = self._condensed(node, before)
        rest = self.body.region_stiffness(self.rest, inside, base, len(dof), environment)
        return GridRegion(node, number, inside, base, dof, rows.T, condensed, rest)

    def _condensed(self, node: IndexArray, before: GridRegion | None) -> Float32Array:
        """Return the inverse of G between nodes (R,), from that of a region that shares most of
        them: it loses what is eliminated, and is bordered by what is new."""
        kept = node[:0] if before is None else before.node[np.isin(before.node, node)]
        if before is None or len(kept) < SHARED * max(len(node), len(before.node)):
            dof = degrees_of_freedom(node)
            return inverse_of_positive(np.asfortranarray(self.compliance[dof][:, dof]))
        inverse = without(before.condensed, np.isin(before.node, kept))
        new = node[~np.isin(node, kept)]
        inverse = bordered(
            inverse, self.compliance, degrees_of_freedom(kept), degrees_of_freedom(new)
        )
        number = np.empty(self.body.discretization.node_count, dtype=np.int32)
        number[kept] = np.arange(len(kept))
        number[new] = len(kept) + np.arange(len(new))
        order = degrees_of_freedom(number[node])
        return inverse.take(order, axis=0).take(order, axis=1)

    def assemble(
        self, region: GridRegion, displacement_m: FloatArray, environment: int
    ) -> Float32Array:
        """Return the condensed stiffness (3 R, 3 R) of a region at displacements (N, 3)."""
        now = self.body.region_stiffness(
            displacement_m, region.cell, region.base, len(region.dof), environment
        )
        now += region.condensed
        now -= region.rest
        return now

    def factor(self, region: GridRegion, stiffness: Float32Array) -> LocalFactor:
        """Factor an assembled stiffness."""
        mean = float(np.trace(stiffness)) / len(stiffness)

        def factor(share: float) -> tuple[Float32Array, bool]:
            # The transpose is the same matrix in LAPACK's order.
            matrix = stiffness.T.copy(order="F")
            matrix[np.diag_indices(len(matrix))] += share * mean
            result: tuple[Float32Array, bool] = linalg.cho_factor(
                matrix, lower=True, overwrite_a=True, check_finite=False
            )
            return result

        return LocalFactor(self.compliance, region, factor_shifted(factor))


def _mean_gradient(body: ElasticBody) -> sparse.csr_matrix:
    """Return (3 C, N): row 3 c + j gives the mean derivative by x_j over cell c's particles."""
    cells = body.cells
    count = len(cells.node)
    gradient = cells.gradient.reshape(count, 8, 3, 27).sum(axis=1)
    gradient /= (cells.particle >= 0).sum(axis=1)[:, None, None]
    row = np.repeat(np.arange(3 * count), 27)
    column = np.repeat(cells.node[:, None], 3, axis=1).ravel()
    shape = (3 * count, body.discretization.node_count)
    return sparse.csr_matrix((gradient.ravel(), (row, column)), shape=shape)
