# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The skin of many gels: its motion with the grid, and its compliance around the contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from dotsim_ros.gel.batched import compliance_kernels, kernels
from dotsim_ros.gel.batched.contact import vectors
from dotsim_ros.gel.batched.elastic import sparse_tensor
from dotsim_ros.gel.batched.rest_compliance import RestCompliance
from dotsim_ros.gel.implicit.refinement import Refinement
from dotsim_ros.io.warp_runtime import wp

ROUNDING = 16
"""Counts of markers and nodes that are not fixed are rounded up to multiples of this."""


def rounded_up(most: int, limit: int) -> int:
    """Return a count that is at least `most`, a multiple of `ROUNDING`, and at most a limit."""
    return min(-(-max(most, 1) // ROUNDING) * ROUNDING, limit)


@dataclass(frozen=True)
class Stencils:
    """The nodes (V, 27) that each marker of the skin moves with, their weights (V, 27), the same as
    a sparse matrix (V, N), and the number of nodes."""

    node: torch.Tensor
    weight: torch.Tensor
    matrix: torch.Tensor
    node_count: int


def stencils_of(matrix: Any, device: str) -> Stencils:
    """Return the rows of a sparse matrix (V, N), none of which has more than 27 entries."""
    csr = matrix.tocsr()
    length = np.diff(csr.indptr)
    row = np.repeat(np.arange(len(length)), length)
    column = np.arange(len(row)) - np.repeat(csr.indptr[:-1], length)
    node = np.zeros((len(length), 27), dtype=np.int32)
    weight = np.zeros((len(length), 27), dtype=np.float32)
    node[row, column], weight[row, column] = csr.indices, csr.data
    return Stencils(
        torch.as_tensor(node, device=device),
        torch.as_tensor(weight, device=device),
        sparse_tensor(csr, device),
        csr.shape[1],
    )


class Skin:
    """The skin on its grid, and on the finer grid that refines it.

    Args:
        rest_m: (V, 3) its markers at rest.
        stencils: on the grid.
        rest: the grid's compliance.
        fine: stencils on the finer grid and what that adds to the compliance; None for a skin that
            is not refined.
    """

    def __init__(
        self,
        rest_m: torch.Tensor,
        stencils: Stencils,
        rest: RestCompliance,
        fine: tuple[Stencils, Refinement] | None,
    ) -> None:
        self.rest_m, self._stencils, self._rest = rest_m, stencils, rest
        self._device = str(rest_m.device)
        self._fine: Stencils | None = None
        if fine is not None:
            self._fine, table = fine
            self._table: list[Any] = [
                wp.array(table.indptr, dtype=wp.int32, device=self._device),
                wp.array(table.index, dtype=wp.int32, device=self._device),
                wp.array(table.block.astype(np.float32), dtype=wp.mat33, device=self._device),
            ]

    def positions(
        self, displacement_m: torch.Tensor, index: torch.Tensor, force_n: torch.Tensor
    ) -> torch.Tensor:
        """Return the skin (B, V, 3) at displacements (N, 3, B) of the grid under forces (B, K, 3)
        on markers (B, K)."""
        moved = _times(self._stencils.matrix, displacement_m)
        if self._fine is not None:
            added = self._fine_displacement(_spread(self._fine, index, force_n))
            moved = moved + _times(self._fine.matrix, added)
        return (self.rest_m[:, :, None] + moved).permute(2, 0, 1).contiguous()

    def markers_at(self, index: torch.Tensor, displacement_m: torch.Tensor) -> torch.Tensor:
        """Return markers (B, K) of the skin (B, K, 3) at displacements (N, 3, B) of the grid."""
        nodal = displacement_m.permute(2, 0, 1).contiguous()
        result = self.rest_m[index]
        wp.launch(
            kernels.add_interpolated,
            dim=tuple(index.shape),
            inputs=[
                wp.from_torch(index.to(torch.int32)),
                wp.from_torch(self._stencils.node),
                wp.from_torch(self._stencils.weight),
                vectors(nodal),
                vectors(result),
            ],
            device=self._device,
        )
        return result

    def load(self, index: torch.Tensor, force_n: torch.Tensor) -> torch.Tensor:
        """Return the forces on the grid's nodes (N, 3, B) under forces (B, K, 3) on markers."""
        return _spread(self._stencils, index, force_n).permute(1, 2, 0).contiguous()

    def compliance(self, index: torch.Tensor, node_limit: int | None) -> torch.Tensor:
        """Return the compliance (B, 3 K, 3 K) at rest between markers (B, K), m/N.

        Args:
            index: of the markers.
            node_limit: of how many nodes around the markers of a gel, those that carry most; None
                for all, which are counted.
        """
        b, k = index.shape
        result = torch.zeros(b, 3 * k, 3 * k, device=index.device)
        near = _around(self._stencils, index, node_limit)
        _weigh(near, self._rest.between(near.node), result)
        if self._fine is not None:
            near = _around(self._fine, index, node_limit)
            size = near.node.shape[1]
            blocks = compliance_kernels.memory(b, size, size, index.device).zero_()
            wp.launch(
                compliance_kernels.gather_refinement,
                dim=tuple(near.node.shape),
                inputs=[
                    wp.from_torch(near.node),
                    wp.from_torch(near.number),
                    *self._table,
                    wp.from_torch(blocks),
                ],
                device=self._device,
            )
            _weigh(near, blocks, result)
        return result

    def _fine_displacement(self, load_n: torch.Tensor) -> torch.Tensor:
        """Return what the finer grid adds (F, 3, B) under forces (B, F, 3) on its nodes."""
        moved = torch.zeros_like(load_n)
        wp.launch(
            kernels.refined_displacement,
            dim=tuple(load_n.shape[:2]),
            inputs=[vectors(load_n), *self._table, vectors(moved)],
            device=self._device,
        )
        return moved.permute(1, 2, 0).contiguous()


def _spread(stencils: Stencils, index: torch.Tensor, force_n: torch.Tensor) -> torch.Tensor:
    """Return the forces on nodes (B, N, 3) under forces (B, K, 3) on markers (B, K)."""
    nodal = force_n.new_zeros(len(index), stencils.node_count, 3)
    wp.launch(
        kernels.spread,
        dim=tuple(index.shape),
        inputs=[
            wp.from_torch(index.to(torch.int32)),
            wp.from_torch(stencils.node),
            wp.from_torch(stencils.weight),
            vectors(force_n.contiguous()),
            vectors(nodal),
        ],
        device=str(nodal.device),
    )
    return nodal


def _times(matrix: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Return a sparse matrix (n, m) times (m, 3, B)."""
    return (matrix @ values.reshape(len(values), -1)).view(-1, *values.shape[1:])


@dataclass(frozen=True)
class _Near:
    """The nodes (B, R) around markers (B, K), the number of each of all nodes (B, N) among them, -1
    for others, and the markers' weights (B, K, 27) on those of a number (B, K, 27)."""

    node: torch.Tensor
    number: torch.Tensor
    weight: torch.Tensor
    column: torch.Tensor


def _around(stencils: Stencils, index: torch.Tensor, limit: int | None) -> _Near:
    """Return the nodes around markers (B, K), those that carry most, of a number or all."""
    b, k = index.shape
    flat = stencils.node[index].view(b, -1).to(torch.int64)
    weight = stencils.weight[index]
    used = torch.zeros(b, stencils.node_count, device=index.device)
    used.scatter_add_(1, flat, weight.abs().view(b, -1))
    count = limit or rounded_up(int((used > 0.0).sum(dim=1).max()), stencils.node_count)
    count = min(count, stencils.node_count)
    node = torch.topk(used, count, dim=1).indices
    number = torch.full((b, stencils.node_count), -1, dtype=torch.int32, device=index.device)
    every = torch.arange(count, dtype=torch.int32, device=index.device)
    number.scatter_(1, node, every.expand(b, -1))
    column = torch.gather(number, 1, flat).view(b, k, 27)
    weight = torch.where(column < 0, 0.0, weight)
    return _Near(node.to(torch.int32), number, weight, column.clamp(min=0))


def _weigh(near: _Near, blocks: torch.Tensor, result: torch.Tensor) -> None:
    """Add to (B, 3 K, 3 K) the compliance that markers have by that between nodes."""
    count, k, _ = near.weight.shape
    of_one = 1 if result.device.type == "cpu" else count
    row = compliance_kernels.memory(of_one, blocks.shape[2], k, result.device)
    wp.launch_tiled(
        compliance_kernels.weigh,
        dim=[count],
        inputs=[
            wp.from_torch(near.column),
            wp.from_torch(near.weight),
            wp.from_torch(blocks),
            wp.from_torch(row),
            wp.from_torch(result),
        ],
        block_dim=kernels.BLOCK,
        device=str(result.device),
    )
