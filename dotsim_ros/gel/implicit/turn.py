# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How the gel turns next to the skin: the refinement turns with it.

What a finer grid adds is computed at rest. A deformed gel is turned, next to a tip or an edge by
half a right angle, and what it adds there turns along: R dG R^T, with R of the polar decomposition
of the deformation gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse

from dotsim_ros.gel.discretization import Discretization, interpolation_at
from dotsim_ros.gel.implicit.refinement_kernels import LEAST_RATIO, turn_with_gel
from dotsim_ros.io.arrays import Float32Array, FloatArray, IndexArray
from dotsim_ros.io.warp_runtime import wp


def turning_stencils(
    grid: Discretization, skin_position_m: FloatArray, fine_weight: sparse.csr_matrix
) -> tuple[IndexArray, FloatArray]:
    """Return the nodes (F, 27) of a grid by which the gel turns at each node of a finer one, and
    their weights' gradients (F, 27, 3), 1/m: those at the marker that moves with it most.

    Args:
        grid: of the gel.
        skin_position_m: (V, 3) rest positions of the markers.
        fine_weight: (V, F) weights of the finer grid's nodes at the markers.
    """
    marker = np.asarray(fine_weight.tocsc().argmax(axis=0)).ravel()
    # As `discretize` has it: those on a knot plane belong to the cell inside.
    stencil, gradient, _ = interpolation_at(grid, skin_position_m[marker] * (1.0 - 1e-9))
    return stencil.node_index, gradient


class Turning:
    """The turns at the refinement's nodes, for the arguments of `turning_stencils`."""

    def __init__(
        self, grid: Discretization, skin_position_m: FloatArray, fine_weight: sparse.csr_matrix
    ) -> None:
        self._node, self._gradient = turning_stencils(grid, skin_position_m, fine_weight)
        self._inputs: list[Any] = [
            wp.array(self._node, dtype=wp.int32, device="cpu"),
            wp.array(self._gradient, dtype=wp.vec3, device="cpu"),
        ]

    def at(self, displacement_m: FloatArray) -> Float32Array:
        """Return the turns (F, 3, 3) at displacements (N, 3) of the grid's nodes."""
        turn = wp.empty((1, len(self._node)), dtype=wp.mat33, device="cpu")
        wp.launch(
            turn_with_gel,
            dim=turn.shape,
            inputs=[
                *self._inputs,
                wp.array(displacement_m[None].astype(np.float32), dtype=wp.vec3, device="cpu"),
            ],
            outputs=[turn],
            device="cpu",
        )
        result: Float32Array = turn.numpy()[0]
        return result

    def exactly_at(self, displacement_m: FloatArray, point: IndexArray | None = None) -> FloatArray:
        """Return the same in double precision, of some (n,) or all of the nodes."""
        every = np.arange(len(self._node), dtype=np.int32)
        return self._polar(displacement_m, every if point is None else point)[0]

    def resistance(
        self,
        displacement_m: FloatArray,
        loaded: IndexArray,
        load_n: FloatArray,
        added: Callable[[FloatArray], FloatArray],
    ) -> FloatArray:
        """Return the forces (N, 3) on the grid's nodes by which the gel resists to be turned: the
        derivatives of f . R dG R^T f / 2.

        Args:
            displacement_m: (N, 3) of the grid's nodes.
            loaded: (n,) nodes of the refinement.
            load_n: (n, 3) on these.
            added: what the refinement adds to their displacement under forces on them at rest.
        """
        turn, stretch, is_sound = self._polar(displacement_m, loaded)
        load = np.einsum("nji,nj->ni", turn, load_n)
        couple = np.cross(added(load), load)
        # dR = R [omega], (tr U - U) omega = axis(R^T dF - dF^T R).
        matrix = np.trace(stretch, axis1=1, axis2=2)[:, None, None] * np.eye(3) - stretch
        spin = np.linalg.solve(matrix, couple[:, :, None])[:, :, 0] * is_sound[:, None]
        nodal = np.cross(spin[:, None], self._gradient[loaded]) @ np.swapaxes(turn, 1, 2)
        result = np.zeros_like(displacement_m)
        np.add.at(result, self._node[loaded], nodal)
        return result

    def _polar(
        self, displacement_m: FloatArray, point: IndexArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return turns and stretches (n, 3, 3) at points (n,), and whether (n,) the gel there has a
        volume."""
        node, weight = self._node[point], self._gradient[point]
        gradient = np.eye(3) + np.einsum("nai,naj->nij", displacement_m[node], weight)
        is_sound = np.linalg.det(gradient) > LEAST_RATIO
        gradient = np.where(is_sound[:, None, None], gradient, np.eye(3))
        left, _, right = np.linalg.svd(gradient)
        turn = left @ right
        return turn, np.swapaxes(turn, 1, 2) @ gradient, is_sound
