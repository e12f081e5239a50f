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


CONTACT_SET_ITERATIONS = 10


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
        flat = self.added_compliance @ fine_force_n.astype(self.added_compliance.dtype).ravel()
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


class NearContact:
    """Markers in contact or close to it, and how the refinement lets them give way.

    Args:
        patch: the patch.
        rows: (A,) its rows that may be in contact in this step.

    Attributes:
        rows: as given.
        node: (n,) grid nodes beside them.
        weight: (A, n) their weights.
        compliance: (A, 3, A, 3) dC, the refinement's compliance between them, m/N.
    """

    def __init__(self, patch: Patch, rows: NDArray[np.int64]) -> None:
        self.rows = rows
        weight = patch.weight[rows]
        self.node = np.unique(weight.indices).astype(np.int32)
        self.weight: FloatArray = weight[:, self.node].toarray().astype(np.float32)
        count = len(rows)
        self._spread = np.zeros((count, 3, len(self.node), 3), dtype=np.float32)
        for i in range(3):
            self._spread[:, i, :, i] = self.weight
        self.compliance = np.zeros((count, 3, count, 3), dtype=np.float32)
        if len(patch.fine_node):
            fine_rows = patch.fine_weight[rows]
            fine = np.unique(fine_rows.indices)
            fine_weight = fine_rows[:, fine].toarray().astype(np.float32)
            dof = (3 * fine[:, None] + np.arange(3)).ravel()
            added = patch.added_compliance[dof][:, dof].reshape(len(fine), 9 * len(fine))
            half = (fine_weight @ added).reshape(count, 3, len(fine), 3).transpose(0, 1, 3, 2)
            whole = half.reshape(9 * count, len(fine)) @ fine_weight.T
            self.compliance = np.ascontiguousarray(
                whole.reshape(count, 3, 3, count).transpose(0, 1, 3, 2)
            )

    def normal_compliance(self, normal: Array) -> Array:
        """Return (A, A) of dC along the normals (C, 3) of the patch's markers."""
        own = normal[self.rows].astype(np.float32)
        half = np.sum([self.compliance[:, :, :, j] * own[:, j] for j in range(3)], axis=0)
        whole = np.sum([half[:, i] * own[:, i, None] for i in range(3)], axis=0)
        return np.asarray(whole, dtype=np.float64)

    def effective(self, hessian: Array) -> EffectiveContact:
        """Return their effective stiffness for the Hessians (C, 3, 3) of the patch's markers."""
        own = hessian[self.rows]
        size = np.trace(own, axis1=1, axis2=2)
        softened = own + SOFTENING * np.maximum(size, size.max())[:, None, None] * np.eye(3)
        count = len(self.rows)
        each = np.arange(count)
        compliance = self.compliance.copy()
        compliance[each, :, each, :] += np.linalg.inv(softened)
        matrix = compliance.reshape(3 * count, 3 * count)
        root = _positive_root(matrix)
        reduced = linalg.blas.strsm(1.0, root, self._spread.reshape(3 * count, -1), lower=1)
        return EffectiveContact(self.rows, self.node, self.weight, root, reduced.T @ reduced)


@dataclass(frozen=True)
class EffectiveContact:
    """The contact's stiffness against the grid, once the refinement has given way.

    With marker Hessians H and the added compliance dC, the markers' force answers a displacement
    of the grid with (H^-1 + dC)^-1.

    Attributes:
        rows: (A,) rows of the patch that it covers.
        node: (n,) grid nodes beside them.
        weight: (A, n) their weights.
        root: (3 A, 3 A) lower Cholesky factor of H^-1 + dC.
        stiffness: (3 n, 3 n) on the grid's nodes.
    """

    rows: NDArray[np.int64]
    node: IntArray
    weight: FloatArray
    root: FloatArray
    stiffness: FloatArray

    def force(self, displacement_m: Array) -> Array:
        """Return the change of force (A, 3) for displacements (A, 3) of its markers."""
        right = -displacement_m.astype(np.float32).ravel()
        solved, _ = linalg.lapack.spotrs(self.root, right, lower=1)
        return solved.astype(np.float64).reshape(-1, 3)


def _positive_root(matrix: FloatArray) -> FloatArray:
    """Return the lower Cholesky factor; fading dG out may have left it indefinite by a hair."""
    mean = float(np.trace(matrix)) / len(matrix)
    for share in (0.0, 1.0e-4, 1.0e-3, 1.0e-2, 1.0e-1):
        shifted = matrix + np.diag(np.full(len(matrix), share * mean, dtype=np.float32))
        root, info = linalg.lapack.spotrf(shifted.T, lower=1, overwrite_a=1, clean=0)
        if info == 0:
            result: FloatArray = root
            return result
    raise np.linalg.LinAlgError("the compliance of the contact is not positive definite")


def contact_set(
    compliance: Array, stiffness: Array, penetration_m: Array, start: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which markers (A,) touch in the linearised problem p = k (q - D p), p >= 0.

    Primal-dual active set method (Hintermueller, Ito and Kunisch, 2002).

    Args:
        compliance: (A, A) D, normal displacements under normal forces, m/N.
        stiffness: (A,) k of the contact, N/m.
        penetration_m: (A,) q, the penetration if no marker were pushed.
        start: (A,) the first guess.
    """
    active = start
    for _ in range(CONTACT_SET_ITERATIONS):
        rows = np.flatnonzero(active)
        matrix = compliance[np.ix_(rows, rows)] + np.diag(1.0 / stiffness[rows])
        force = np.zeros(len(active))
        force[rows] = linalg.solve(matrix, penetration_m[rows], assume_a="pos", check_finite=False)
        touching = penetration_m - compliance @ force > 0.0
        if np.array_equal(touching, active):
            break
        active = touching
    return active
