# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The inverse of the gel's stiffness at rest, applied to many gels at once.

A body that is its own mirror image in x and in y splits the inverse exactly into four blocks, one
for each way of being even or odd in the two mirrors: a quarter of the memory and of the operations.
"""

from __future__ import annotations

import numpy as np
import torch

from dotsim_ros.gel.discretization import Discretization
from dotsim_ros.io.arrays import Float32Array

MIRRORS = np.array([[1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1]])
"""(4, 3) signs of a vector's components under the identity, the mirror in x, in y, and in both."""
PARITIES = 0.5 * np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]])
"""(4, 4) normalised characters of the group of these mirrors."""


class RestCompliance:
    """G, the (3 N, 3 N) inverse of the stiffness at rest, m/N.

    Args:
        discretization: the grid, whose nodes are mirror images of each other.
        compliance: G of a gel that is its own mirror image; one that is loose on one side is not.
        device: torch's name of the device.

    Attributes:
        matrix: G on the device.
    """

    def __init__(
        self, discretization: Discretization, compliance: Float32Array, device: str
    ) -> None:
        self.matrix = torch.as_tensor(compliance, device=device)
        node_count = discretization.node_count
        self._orbits = torch.as_tensor(mirror_orbits(discretization.node_cell), device=device)
        # [component, parity, image]
        signs = PARITIES[None] * MIRRORS.T[:, None]
        self._signs = torch.as_tensor(signs, dtype=torch.float32, device=device)
        half = self._split(self.matrix.view(node_count, 3, -1))
        self._blocks = torch.stack(
            [self._split(half[k].T.reshape(node_count, 3, -1))[k].T for k in range(4)]
        ).contiguous()

    def _split(self, vectors: torch.Tensor) -> torch.Tensor:
        """Return the parts (4, 3 N / 4, B) of nodal vectors (N, 3, B), a parity each."""
        parts = torch.einsum("cke,oecb->kocb", self._signs, vectors[self._orbits])
        return parts.reshape(4, -1, vectors.shape[2])

    def apply(self, force: torch.Tensor) -> torch.Tensor:
        """Return the displacements (N, 3, B) at rest under nodal forces (N, 3, B)."""
        moved = torch.bmm(self._blocks, self._split(force)).view(4, -1, 3, force.shape[2])
        result = torch.empty_like(force)
        images = torch.einsum("cke,kocb->oecb", self._signs, moved)
        result[self._orbits.reshape(-1)] = images.reshape(-1, 3, force.shape[2])
        return result


def mirror_orbits(node_cell: np.ndarray) -> np.ndarray:
    """Return (N / 4, 4) the nodes of each set of mirror images, in the order of `MIRRORS`.

    Nodes lie at (i + 1/2) h: no node is its own image.
    """
    number = {tuple(cell): i for i, cell in enumerate(node_cell.tolist())}
    leaders = node_cell[(node_cell[:, 0] >= 0) & (node_cell[:, 1] >= 0)]
    return np.array(
        [
            [
                number[(i if sx > 0 else -1 - i, j if sy > 0 else -1 - j, k)]
                for sx, sy, _ in MIRRORS.tolist()
            ]
            for i, j, k in leaders.tolist()
        ]
    )
