# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A direct solver for the grid's stiffness: block-tridiagonal Cholesky over slabs of the grid.

Quadratic splines couple nodes two grid lines apart, the ghost penalty's third differences three; so
slabs of three planes couple only with their neighbours. All the work is dense matrix products, in
which a processor is fastest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from dotsim_ros.io.arrays import AnyFloatArray, IndexArray

PLANES_PER_SLAB = 3


class BlockCholesky:
    """The factored stiffness.

    Args:
        matrix: (3 N, 3 N) symmetric positive definite stiffness.
        node_cell: (N, 3) integer grid coordinates of the nodes; slabs follow one another along
            the `axis` on which they lie farthest apart.

    Raises:
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """

    def __init__(self, matrix: sparse.csr_matrix, node_cell: NDArray[np.int64]) -> None:
        self.axis = int(np.argmax(np.ptp(node_cell, axis=0)))
        along = node_cell[:, self.axis]
        slab = (along - along.min()) // PLANES_PER_SLAB
        order = np.argsort(slab, kind="stable")
        self.dofs = [
            (3 * nodes[:, None] + np.arange(3)).ravel()
            for nodes in np.split(order, np.cumsum(np.bincount(slab))[:-1])
        ]
        self.diagonal: list[AnyFloatArray] = []
        self.below: list[AnyFloatArray] = []
        rows = [matrix[dof] for dof in self.dofs]
        for i, dof in enumerate(self.dofs):
            block = rows[i][:, dof].toarray()
            if i > 0:
                coupling = rows[i][:, self.dofs[i - 1]].toarray()
                lower = linalg.solve_triangular(
                    self.diagonal[-1], coupling.T, lower=True, check_finite=False
                ).T
                block -= lower @ lower.T
                self.below.append(lower)
            self.diagonal.append(linalg.cholesky(block, lower=True, check_finite=False))

    def solve(self, right: AnyFloatArray, wanted: IndexArray | None = None) -> AnyFloatArray:
        """Return the solution for right-hand sides (3 N,) or (3 N, m).

        Args:
            right: those; slabs of zeros before the first other cost nothing.
            wanted: rows that are needed, None for all; those of slabs before the first of them
                may be left zero.
        """
        parts: list[AnyFloatArray] = []
        for i, dof in enumerate(self.dofs):
            part = right[dof]
            if parts:
                part = part - self.below[i - 1] @ parts[-1]
            if parts or part.any() or i + 1 == len(self.dofs):
                parts.append(
                    linalg.solve_triangular(self.diagonal[i], part, lower=True, check_finite=False)
                )
        zeros = len(self.dofs) - len(parts)
        result = np.zeros_like(right)
        for i in reversed(range(self._slab_of(wanted), len(self.dofs))):
            part = parts[i - zeros] if i >= zeros else np.zeros_like(right[self.dofs[i]])
            if i + 1 < len(self.dofs):
                part = part - self.below[i].T @ result[self.dofs[i + 1]]
            result[self.dofs[i]] = linalg.solve_triangular(
                self.diagonal[i], part, lower=True, trans="T", check_finite=False
            )
        return result

    def _slab_of(self, wanted: IndexArray | None) -> int:
        """Return the first slab that holds a wanted row."""
        if wanted is None:
            return 0
        return next(i for i, dof in enumerate(self.dofs) if np.isin(dof, wanted).any())
