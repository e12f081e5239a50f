# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The elastic body on its grid: energy, nodal forces and tangent stiffness for given displacements.

Energy of the paper's continuum (section III-A) in total-Lagrangian form,
W(u) = sum_p V_p psi(I + sum_i u_i (x) grad w_ip) + u . L u / 2, where L holds the bond to the rigid
core and the ghost penalty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dotsim_ros.gel.discretization import Discretization
from dotsim_ros.gel.elastic_kernels import elastic_kernels
from dotsim_ros.gel.material import ElasticLaw, small_strain_moduli_pa
from dotsim_ros.io.arrays import IndexArray
from dotsim_ros.io.warp_runtime import wp

Array = NDArray[np.floating]

GHOST_PENALTY = 0.002
"""gamma of gamma mu h |third difference|^2: small enough not to stiffen the gel by over 2 %."""

BOND_STIFFNESS = 30.0
"""Stiffness of the bond to the core, in units of Young's modulus over the grid spacing."""


@dataclass(frozen=True)
class Cells:
    """Particles grouped by the cell that they lie in; a cell's particles share their 27 nodes.

    A grid cell of a reshaped body may hold more than eight particles; it then counts as several.

    Attributes:
        particle: (C, 8) particles of each cell, -1 where there are fewer.
        node: (C, 27) nodes of each cell.
        gradient: (C, 24, 27) weight gradients, row 3 q + j for particle q and direction j.
    """

    particle: IndexArray
    node: IndexArray
    gradient: Array


def group_by_cell(discretization: Discretization) -> Cells:
    """Group the particles by cell."""
    cell = np.floor(discretization.particle_position_m / discretization.spacing_m).astype(int)
    _, cell_of, size = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    cell_of = cell_of.reshape(-1)
    order = np.argsort(cell_of, kind="stable")
    first = np.concatenate([[0], np.cumsum(size)[:-1]])
    slot = np.empty(len(cell_of), dtype=int)
    slot[order] = np.arange(len(cell_of)) - first[cell_of[order]]
    part_count = -(-size // 8)
    cell_of = (np.cumsum(part_count) - part_count)[cell_of] + slot // 8
    slot %= 8
    particle = np.full((int(part_count.sum()), 8), -1, dtype=np.int32)
    particle[cell_of, slot] = np.arange(len(cell_of))
    gradient = np.where(
        (particle >= 0)[:, :, None, None],
        discretization.particle_weight_gradient[particle],
        0.0,
    )
    # A node mirrored at the base appears with its sign in the gradient, so cells need no sign.
    return Cells(
        particle=particle,
        node=discretization.particle_interpolation.node_index[particle[:, 0]],
        gradient=gradient.transpose(0, 1, 3, 2).reshape(len(particle), 24, 27),
    )


class ElasticBody:
    """Energy, force and stiffness of the gel without contact, for a batch of environments.

    Args:
        discretization: the grid and the particles.
        law: the material, the same in all environments until `set_coefficients`.
        environment_count: length of the leading axis of every array.
        dtype: numpy float type of the computation.
        device: Warp device.
        ghost_penalty: gamma.
        lost_bond: (3 N, 3 N) stiffness, N/m, that the bond to the core lacks; None for a sound one.
    """

    def __init__(
        self,
        discretization: Discretization,
        law: ElasticLaw,
        *,
        environment_count: int = 1,
        dtype: type[np.floating] = np.float64,
        device: str = "cpu",
        ghost_penalty: float = GHOST_PENALTY,
        lost_bond: sparse.csr_matrix | None = None,
    ) -> None:
        self.discretization = discretization
        self.environment_count = environment_count
        self.dtype = dtype
        self.device = device
        self.kernels = elastic_kernels(wp.float64 if dtype is np.float64 else wp.float32)
        self.cells = group_by_cell(discretization)
        self.cell_gradient = self.cells.gradient.astype(dtype)
        d, k = discretization, self.kernels
        self.node_index: Any = wp.array(
            d.particle_interpolation.node_index, dtype=wp.int32, device=device
        )
        self.weight_gradient: Any = wp.array(
            d.particle_weight_gradient.astype(dtype), dtype=k.vec3, device=device
        )
        self.volume: Any = wp.array(
            d.particle_volume_m3.astype(dtype), dtype=k.scalar, device=device
        )
        self.cell_particle: Any = wp.array(self.cells.particle, dtype=wp.int32, device=device)
        self.all_particles: Any = wp.array(
            np.arange(d.particle_count, dtype=np.int32), dtype=wp.int32, device=device
        )
        self.all_cells = np.arange(len(self.cells.node), dtype=np.int32)
        shape = (environment_count, d.particle_count)
        self.history_stress = wp.zeros(shape, dtype=k.mat33, device=device)
        self.displacement = wp.zeros((environment_count, d.node_count), dtype=k.vec3, device=device)
        self.force_buffer = wp.zeros_like(self.displacement)
        self.energy_buffer = wp.zeros(shape, dtype=k.scalar, device=device)
        self._pattern: tuple[IndexArray, IndexArray, IndexArray] | None = None
        self.set_coefficients(np.tile(law.coefficients_pa(), (environment_count, 1)))
        self.fast_share: Any = wp.array(
            np.ones(environment_count, dtype=dtype), dtype=k.scalar, device=device
        )
        youngs, _ = small_strain_moduli_pa(law)
        self.linear = linear_stiffness(d, law, ghost_penalty)
        self.lost_bond = lost_bond
        self.youngs_modulus_pa = youngs

    def set_coefficients(self, coefficients_pa: Array) -> None:
        """Set the law's coefficients (E, 5) of every environment."""
        self.coefficients: Any = wp.array(
            coefficients_pa.astype(self.dtype), dtype=self.kernels.vec5, device=self.device
        )

    def set_history(self, fast_share: float, history_stress_pa: Array, environment: int) -> None:
        """Set what relaxation leaves of the fast stress, and the stress (P, 3, 3) it remembers."""
        self.fast_share[environment : environment + 1].fill_(fast_share)
        self.history_stress[environment].assign(history_stress_pa.astype(self.dtype))

    def material_stress(self, displacement_m: Array, environment: int) -> Array:
        """Return the second Piola-Kirchhoff stress (P, 3, 3) of the shape-changing part, Pa."""
        self.displacement[environment].assign(displacement_m)
        stress = wp.empty_like(self.history_stress)
        wp.launch(
            self.kernels.material_stress,
            dim=stress.shape,
            inputs=[self.node_index, self.weight_gradient, self.coefficients, self.displacement],
            outputs=[stress],
            device=self.device,
        )
        return stress.numpy()[environment].copy()

    def force(self, displacement_m: Array) -> tuple[Array, Array]:
        """Return energies (E,) and their gradients (E, N, 3) for displacements (E, N, 3)."""
        each = [self.force_in(e, here) for e, here in enumerate(displacement_m)]
        return np.array([energy for energy, _ in each]), np.stack([force for _, force in each])

    def force_in(self, environment: int, displacement_m: Array) -> tuple[float, Array]:
        """Return the energy of one environment and its gradient (N, 3) at displacements (N, 3)."""
        here = slice(environment, environment + 1)
        self.displacement[environment].assign(displacement_m)
        buffer = self.force_buffer[here]
        buffer.zero_()
        energies = self.energy_buffer[here]
        wp.launch(
            self.kernels.internal_force,
            dim=(1, self.discretization.particle_count),
            inputs=[
                self.all_particles,
                self.node_index,
                self.weight_gradient,
                self.volume,
                self.coefficients[here],
                self.fast_share[here],
                self.history_stress[here],
                self.displacement[here],
            ],
            outputs=[buffer, energies],
            device=self.device,
        )
        linear = self.linear @ displacement_m
        if self.lost_bond is not None:
            linear = linear + (self.lost_bond @ displacement_m.ravel()).reshape(-1, 3)
        force = buffer.numpy()[0] + linear
        energy = float(energies.numpy().sum()) + 0.5 * float(np.vdot(displacement_m, linear))
        return energy, force

    def cell_stiffness(
        self, displacement_m: Array, cells: IndexArray, environment: int
    ) -> wp.array:
        """Return the stiffness of the listed cells, (C, 3, 27, 81) as [cell, i, a, 27 k + b]."""
        self.displacement[environment].assign(displacement_m)
        contracted = wp.empty(
            (len(cells), 3, 24, 81), dtype=self.kernels.scalar, device=self.device
        )
        wp.launch(
            self.kernels.stress_tangent,
            dim=(len(cells), 8),
            inputs=[
                wp.array(cells, dtype=wp.int32, device=self.device),
                self.cell_particle,
                self.node_index,
                self.weight_gradient,
                self.volume,
                self.coefficients,
                self.fast_share,
                self.history_stress,
                self.displacement,
                environment,
            ],
            outputs=[contracted],
            device=self.device,
        )
        gradient = self.cell_gradient[cells].transpose(0, 2, 1)[:, None]
        product = np.matmul(gradient, contracted.numpy())
        return wp.array(product, dtype=self.kernels.scalar, device=self.device, copy=False)

    def _scatter(self, stiffness: wp.array, base: IndexArray, row_stride: int, size: int) -> Array:
        values = wp.zeros(size, dtype=self.kernels.scalar, device=self.device)
        wp.launch(
            self.kernels.scatter_stiffness,
            dim=(stiffness.shape[0], 27),
            inputs=[
                stiffness,
                wp.array(base, dtype=wp.int32, device=self.device, copy=False),
                row_stride,
            ],
            outputs=[values],
            device=self.device,
        )
        result: Array = values.numpy()
        return result

    def stiffness(self, displacement_m: Array, environment: int) -> sparse.csr_matrix:
        """Return the exact tangent stiffness (3 N, 3 N) at displacements (N, 3), linear terms
        included."""
        if self._pattern is None:
            self._pattern = _block_pattern(self.cells.node, self.discretization.node_count)
        base, indices, indptr = self._pattern
        size = 9 * len(indices)
        values = self._scatter(
            self.cell_stiffness(displacement_m, self.all_cells, environment), base, 3, size
        )
        n = 3 * self.discretization.node_count
        blocks = sparse.bsr_matrix((values.reshape(-1, 3, 3), indices, indptr), shape=(n, n))
        whole = blocks.tocsr() + sparse.kron(self.linear, sparse.eye(3))
        if self.lost_bond is not None:
            whole = whole + self.lost_bond
        return whole.tocsr()

    def region_stiffness(
        self,
        displacement_m: Array,
        cells: IndexArray,
        base: IndexArray,
        dof_count: int,
        environment: int,
    ) -> Array:
        """Return the dense (n, n) stiffness that the listed cells add to a region of n unknowns.

        `base` is `region_base` of the same cells; the linear terms are not included.
        """
        values = self._scatter(
            self.cell_stiffness(displacement_m, cells, environment),
            base,
            dof_count,
            dof_count * dof_count,
        )
        return values.reshape(dof_count, dof_count)


def linear_stiffness(
    discretization: Discretization, law: ElasticLaw, ghost_penalty: float
) -> sparse.csr_matrix:
    """Return the (N, N) stiffness, N/m, of bond and ghost penalty, the same for x, y, z."""
    youngs, _ = small_strain_moduli_pa(law)
    c10, c01, *_ = law.coefficients_pa()
    h = discretization.spacing_m
    bond = discretization.bond * (BOND_STIFFNESS * youngs / h)
    return (bond + discretization.ghost * (ghost_penalty * 2.0 * (c10 + c01) * h)).tocsr()


def region_base(cell_node: IndexArray, region_of_node: IndexArray, dof_count: int) -> IndexArray:
    """Return (C, 27, 27) positions of the blocks of cells in a dense matrix of a region's unknowns.

    Args:
        cell_node: (C, 27) nodes of the cells.
        region_of_node: (N,) number of each node in the region, -1 outside.
        dof_count: unknowns of the region.
    """
    number = region_of_node[cell_node]
    row, column = number[:, :, None], number[:, None, :]
    return np.where((row >= 0) & (column >= 0), 3 * row * dof_count + 3 * column, -1).astype(
        np.int32
    )


def _block_pattern(
    cell_node: IndexArray, node_count: int
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Return the positions (C, 27, 27) of the cells' blocks in a block-sparse matrix, and its
    column indices and row pointers."""
    key = cell_node[:, :, None].astype(np.int64) * node_count + cell_node[:, None, :]
    blocks, position = np.unique(key, return_inverse=True)
    indptr = np.searchsorted(blocks // node_count, np.arange(node_count + 1)).astype(np.int32)
    base = 9 * position.reshape(key.shape)
    return base.astype(np.int32), (blocks % node_count).astype(np.int32), indptr
