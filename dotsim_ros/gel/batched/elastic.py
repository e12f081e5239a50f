# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Elastic forces of many gels, cell by cell."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import torch
from scipy import sparse

from dotsim_ros.gel.batched import kernels
from dotsim_ros.gel.discretization import Discretization
from dotsim_ros.gel.elasticity import GHOST_PENALTY, group_by_cell, linear_stiffness
from dotsim_ros.gel.material import ElasticLaw
from dotsim_ros.io.warp_runtime import wp


class ElasticForces:
    """The elastic gel on its grid, for B gels.

    Args:
        discretization: the grid and its particles.
        law: the material.
        count: B.
        device: torch's name of the device.
        lost_bond: (3 N, 3 N) stiffness, N/m, that the bond to the core lacks; None for a sound one.

    Attributes:
        fast_share, history_pa: (B,) what relaxation leaves of each gel's stress, and the stress
            (3 P, 3, B) that it remembers; empty where nothing relaxes.
    """

    def __init__(
        self,
        discretization: Discretization,
        law: ElasticLaw,
        count: int,
        device: str,
        *,
        lost_bond: sparse.csr_matrix | None = None,
    ) -> None:
        d = discretization
        cells = group_by_cell(d)
        volume = np.where(cells.particle >= 0, d.particle_volume_m3[cells.particle], 0.0)
        self._cell_node = torch.as_tensor(cells.node.astype(np.int32), device=device)
        self._gradient = torch.as_tensor(
            np.ascontiguousarray(cells.gradient), dtype=torch.float32, device=device
        )
        self._volume: Any = wp.array(volume.ravel(), dtype=wp.float32, device=device)
        self._law = kernels.coefficients(*law.coefficients_pa())
        self.node_count, self.device = d.node_count, device
        self.fast_share = torch.ones(count, device=device)
        self.history_pa = torch.empty(0, 3, count, device=device)
        self._lost_bond = None if lost_bond is None else sparse_tensor(lost_bond, device)
        self._linear = sparse_tensor(linear_stiffness(d, law, GHOST_PENALTY), device)

    def __call__(self, displacement_m: torch.Tensor, gels: torch.Tensor) -> torch.Tensor:
        """Return the derivative of the elastic energy (N, 3, b) of some gels (b,) by their
        displacements (N, 3, b)."""
        n, _, b = displacement_m.shape
        given = displacement_m.contiguous()
        force = (self._linear @ given.view(n, 3 * b)).view(n, 3, b)
        if self._lost_bond is not None:
            force += (self._lost_bond @ given.view(3 * n, b)).view(n, 3, b)
        width = kernels.GELS if self.device == "cpu" else 1
        wp.launch(
            kernels.add_elastic_forces,
            dim=(len(self._gradient), -(-b // width)),
            inputs=[
                wp.from_torch(given),
                wp.from_torch(self._cell_node),
                wp.from_torch(self._gradient),
                self._volume,
                self._law,
                wp.from_torch(gels.to(torch.int32)),
                wp.from_torch(self.fast_share[gels]),
                wp.from_torch(self.history_pa),
                width,
                wp.from_torch(force),
            ],
            device=self._volume.device,
        )
        return force

    def shape_stress(self, displacement_m: torch.Tensor) -> torch.Tensor:
        """Return the second Piola-Kirchhoff stress (3 P, 3, B), Pa, of the part of the energy that
        relaxes, at displacements (N, 3, B)."""
        n, _, b = displacement_m.shape
        cells = len(self._gradient)
        nodal = displacement_m.reshape(n, 3 * b)[self._cell_node.view(-1)].view(cells, 27, -1)
        gradient = torch.bmm(self._gradient, nodal).view(-1, 3, b)
        stress = torch.empty_like(gradient)
        wp.launch(
            kernels.second_piola_kirchhoff,
            dim=(len(gradient) // 3, b),
            inputs=[wp.from_torch(gradient), self._law, wp.from_torch(stress)],
            device=self._volume.device,
        )
        return stress


def sparse_tensor(matrix: Any, device: str) -> torch.Tensor:
    """Return a SciPy matrix as a sparse tensor of single precision."""
    csr = matrix.tocsr().sorted_indices()
    with warnings.catch_warnings():
        # Of all that torch's sparse tensors can do, only their product with a matrix is used.
        warnings.filterwarnings("ignore", "Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(
            torch.as_tensor(csr.indptr, dtype=torch.int64),
            torch.as_tensor(csr.indices, dtype=torch.int64),
            torch.as_tensor(csr.data, dtype=torch.float32),
            csr.shape,
            device=device,
            check_invariants=True,
        )
