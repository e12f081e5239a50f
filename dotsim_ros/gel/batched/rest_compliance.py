# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The inverse of the gel's stiffness at rest, applied to many gels at once.

A body that is its own mirror image in x and in y splits the inverse exactly into four blocks, one
for each way of being even or odd in the two mirrors: a quarter of the memory and of the operations.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy import sparse

from dotsim_ros.gel.batched import compliance_kernels
from dotsim_ros.gel.body import Body
from dotsim_ros.gel.discretization import Discretization
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit.rest_compliance import kept_inverse
from dotsim_ros.gel.implicit.tangent import inverse_of_positive
from dotsim_ros.gel.material import ElasticLaw
from dotsim_ros.io.arrays import Float32Array, FloatArray
from dotsim_ros.io.documents import ArrayForm
from dotsim_ros.io.warp_runtime import wp

MIRRORS = np.array([[1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1]])
"""(4, 3) signs of a vector's components under the identity, the mirror in x, in y, and in both."""
PARITIES = 0.5 * np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]])
"""(4, 4) normalised characters of the group of these mirrors."""


def kept_blocks(
    shape: Body, skin_position_m: FloatArray, grid: Discretization, law: ElasticLaw
) -> Float32Array:
    """Return the (4, 3 N / 4, 3 N / 4) blocks of the inverse of a gel's stiffness at rest, m/N, a
    parity each, from the cache if they are there.

    Args:
        shape: the gel's, its own mirror image; one that is loose on one side is not.
        skin_position_m: (V, 3) rest positions of the markers, which the grid must hold.
        grid: of the gel, whose nodes are mirror images of each other.
        law: its material; only its Poisson's ratio matters for the cache.
    """
    form = ArrayForm((4,) + (3 * grid.node_count // 4,) * 2)
    return kept_inverse("blocks", form, _inverse_in_blocks, shape, skin_position_m, grid, law)


def _inverse_in_blocks(body: ElasticBody) -> Float32Array:
    grid = body.discretization
    stiffness = body.stiffness(np.zeros((grid.node_count, 3), dtype=np.float32), 0)
    orbits = mirror_orbits(grid.node_cell)
    blocks = np.empty((4,) + (3 * len(orbits),) * 2, dtype=np.float32)
    for parity, block in enumerate(blocks):
        basis = _parity_basis(orbits, parity)
        part = (basis.T @ stiffness @ basis).toarray()
        block[:] = inverse_of_positive(np.asfortranarray(part, dtype=np.float32))
    return blocks


def _parity_basis(orbits: np.ndarray, parity: int) -> sparse.csr_matrix:
    """Return the nodal vectors (3 N, 3 N / 4) of a parity, orthonormal."""
    count = len(orbits)
    # [orbit, image, component]
    row = 3 * orbits[:, :, None] + np.arange(3)
    column = np.broadcast_to(3 * np.arange(count)[:, None, None] + np.arange(3), row.shape)
    sign = np.broadcast_to(PARITIES[parity][:, None] * MIRRORS, row.shape)
    entries = (sign.ravel(), (row.ravel(), column.ravel()))
    return sparse.csr_matrix(entries, shape=(12 * count, 3 * count))


class RestCompliance:
    """G, the (3 N, 3 N) inverse of the stiffness at rest, m/N.

    Args:
        grid: whose nodes are mirror images of each other.
        blocks: of G, as `kept_blocks` returns them.
        device: torch's name of the device.
    """

    def __init__(self, grid: Discretization, blocks: Float32Array, device: str) -> None:
        orbits = mirror_orbits(grid.node_cell)
        self._orbits = torch.as_tensor(orbits, device=device)
        # [component, parity, image]
        signs = PARITIES[None] * MIRRORS.T[:, None]
        self._signs = torch.as_tensor(signs, dtype=torch.float32, device=device).contiguous()
        self._blocks = torch.as_tensor(blocks, device=device)
        place = np.empty((grid.node_count, 2), dtype=np.int32)
        place[orbits, 0] = np.arange(len(orbits))[:, None]
        place[orbits, 1] = np.arange(4)
        self._between_inputs: list[Any] = [
            wp.from_torch(torch.as_tensor(place, device=device)),
            wp.from_torch(self._signs),
            wp.from_torch(self._blocks),
        ]

    def between(self, node: torch.Tensor) -> torch.Tensor:
        """Return the blocks of G between nodes (B, R), as `compliance_kernels` has them."""
        count, size = node.shape
        result = compliance_kernels.memory(count, size, size, node.device)
        wp.launch(
            compliance_kernels.gather_rest,
            dim=(count, size, size),
            inputs=[wp.from_torch(node), *self._between_inputs],
            outputs=[wp.from_torch(result)],
            device=str(node.device),
        )
        return result

    def _split(self, vectors: torch.Tensor) -> torch.Tensor:
        """Return the parts (4, 3 N / 4, B) of nodal vectors (N, 3, B), a parity each."""
        parts = torch.einsum("cke,oecb->kocb", self._signs, vectors[self._orbits])
        return parts.reshape(4, -1, vectors.shape[2])

    def apply(self, force: torch.Tensor) -> torch.Tensor:
        """Return the displacements (N, 3, B) at rest under nodal forces (N, 3, B)."""
        # The blocks are symmetric; on a CPU few columns take far longer than few rows.
        moved = torch.bmm(self._split(force).transpose(1, 2), self._blocks)
        result = torch.empty_like(force)
        moved = moved.view(4, force.shape[2], -1, 3)
        images = torch.einsum("cke,kboc->oecb", self._signs, moved)
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
