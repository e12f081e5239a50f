"""The part of the skin that the indenter can touch in a step, as contact sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from dotsim_ros.gel.refinement import Refinement

Array = NDArray[np.float64]
FloatArray = NDArray[np.float32]
IntArray = NDArray[np.int32]

SOFTENING = 1.0e-3
"""Share of the normal contact stiffness that is added in all directions of the linear solve, so
that free directions can be inverted; the solution does not depend on it."""


@dataclass(frozen=True)
class Patch:
    """Markers that may come into contact, with their weights on the grid and on the refinement.

    Attributes:
        marker: (C,) numbers of the markers.
        rest_position_m: (C, 3).
        weight: (C, N) weights of the grid's nodes.
        fine_node: (F,) nodes of the refinement beside the markers.
        fine_weight: (C, F) weights of those.
        added_compliance: (3 F, 3 F) of the refinement, m/N; empty without one.
    """

    marker: IntArray
    rest_position_m: Array
    weight: sparse.csr_matrix
    fine_node: IntArray
    fine_weight: sparse.csr_matrix
    added_compliance: FloatArray

    def added_displacement(self, fine_force_n: Array) -> Array:
        """Return the refinement's displacement (F, 3) under forces (F, 3) on its nodes."""
        flat = self.added_compliance @ fine_force_n.astype(np.float32).ravel()
        return flat.astype(np.float64).reshape(-1, 3)

    def position(self, displacement_m: Array, added_m: Array) -> Array:
        """Return the markers' positions (C, 3)."""
        return self.rest_position_m + self.weight @ displacement_m + self.fine_weight @ added_m


def make_patch(
    marker: IntArray,
    skin_position_m: Array,
    skin_weight: sparse.csr_matrix,
    refinement: Refinement | None,
) -> Patch:
    """Return the patch of the given markers."""
    if refinement is None:
        fine_weight = sparse.csr_matrix((len(marker), 0))
        nodes, compliance = np.zeros(0, dtype=np.int32), np.zeros((0, 0), dtype=np.float32)
    else:
        rows = refinement.skin_weight[marker]
        nodes = np.unique(rows.indices).astype(np.int32)
        fine_weight = sparse.csr_matrix(
            (rows.data, np.searchsorted(nodes, rows.indices), rows.indptr),
            shape=(len(marker), len(nodes)),
        )
        compliance = refinement.dense(nodes)
    return Patch(
        marker, skin_position_m[marker], skin_weight[marker], nodes, fine_weight, compliance
    )


@dataclass(frozen=True)
class EffectiveContact:
    """The contact's stiffness against the grid, once the refinement has given way.

    With marker Hessians H and the added compliance dC of the markers in contact, their force
    answers a displacement of the grid with (H^-1 + dC)^-1.

    Attributes:
        active: (A,) rows of the patch in contact.
        node: (n,) grid nodes beside them.
        weight: (A, n) their weights.
        root: (3 A, 3 A) lower Cholesky factor of H^-1 + dC.
        stiffness: (3 n, 3 n) on the grid's nodes.
    """

    active: NDArray[np.int64]
    node: IntArray
    weight: FloatArray
    root: FloatArray
    stiffness: FloatArray

    def force(self, displacement_m: Array) -> Array:
        """Return the change of force (A, 3) for displacements (A, 3) of the markers in contact."""
        right = -displacement_m.astype(np.float32).ravel()
        solved = linalg.cho_solve((self.root, True), right, check_finite=False)
        return solved.astype(np.float64).reshape(-1, 3)


def effective_contact(patch: Patch, active: NDArray[np.int64], hessian: Array) -> EffectiveContact:
    """Return the effective stiffness of the active markers with Hessians (A, 3, 3)."""
    count = len(active)
    rows = patch.weight[active]
    node = np.unique(rows.indices).astype(np.int32)
    weight = rows[:, node].toarray().astype(np.float32)
    softened = hessian + SOFTENING * np.trace(hessian, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    compliance = np.zeros((count, 3, count, 3), dtype=np.float32)
    if len(patch.fine_node):
        fine_rows = patch.fine_weight[active]
        fine = np.unique(fine_rows.indices)
        fine_weight = fine_rows[:, fine].toarray().astype(np.float32)
        dof = (3 * fine[:, None] + np.arange(3)).ravel()
        added = patch.added_compliance[np.ix_(dof, dof)].reshape(len(fine), 9 * len(fine))
        half = (fine_weight @ added).reshape(count, 3, len(fine), 3).transpose(0, 1, 3, 2)
        whole = half.reshape(9 * count, len(fine)) @ fine_weight.T
        compliance += whole.reshape(count, 3, 3, count).transpose(0, 1, 3, 2)
    compliance[np.arange(count), :, np.arange(count), :] += np.linalg.inv(softened)
    matrix = compliance.reshape(3 * count, 3 * count)
    root = linalg.cholesky(matrix, lower=True, check_finite=False, overwrite_a=True)
    spread = np.zeros((count, 3, len(node), 3), dtype=np.float32)
    for i in range(3):
        spread[:, i, :, i] = weight
    reduced = linalg.solve_triangular(
        root, spread.reshape(3 * count, -1), lower=True, check_finite=False
    )
    return EffectiveContact(active, node, weight, root, reduced.T @ reduced)
