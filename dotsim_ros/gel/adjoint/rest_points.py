# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Nodal fields at particles, markers and bonded points, and how they vary with these points."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from dotsim_ros.gel.discretization import bonded_points, interpolation_at
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.io.arrays import FloatArray, IndexArray


class FieldGradient:
    """Evaluates the gradient of a nodal field at fixed points.

    Args:
        node_index: (P, 27) the nodes around the points.
        weight_gradient: (P, 27, 3) the derivatives of their weights by the points.
        node_count: of all nodes.
    """

    def __init__(
        self, node_index: IndexArray, weight_gradient: FloatArray, node_count: int
    ) -> None:
        row = 3 * np.arange(len(node_index))[:, None, None] + np.arange(3)
        row, column = np.broadcast_arrays(row, node_index[:, :, None])
        entries = weight_gradient.ravel(), (row.ravel(), column.ravel())
        self._matrix = sparse.csr_matrix(entries, shape=(3 * len(node_index), node_count))

    def at(self, nodal: FloatArray) -> FloatArray:
        """Return (P, 3, 3) of nodal values (N, 3), [point, component, direction]."""
        gradient: FloatArray = (self._matrix @ nodal).reshape(-1, 3, 3).transpose(0, 2, 1)
        return gradient


def pulled(gradient: FloatArray, by_value: FloatArray) -> FloatArray:
    """Return the derivatives (P, 3) by positions, of a field's gradient (P, 3, 3) there and the
    derivatives (P, 3) by its values."""
    result: FloatArray = np.einsum("pij,pi->pj", gradient, by_value)
    return result


class RestPoints:
    """Weights at particles, markers and bonded points, and how they vary with the points."""

    def __init__(self, gel: ImplicitGel) -> None:
        d = gel.discretization
        particles, gradient, self.particle_curvature = interpolation_at(d, d.particle_position_m)
        self.particle_weight = particles.matrix(d.node_count)
        self.particle_gradient = FieldGradient(particles.node_index, gradient, d.node_count)
        inward = 1.0 - 1e-9
        markers, gradient, _ = interpolation_at(d, gel.skin.rest_position_m * inward)
        self.marker_gradient = FieldGradient(markers.node_index, gradient, d.node_count)
        self.bonded_m, self.bonded_area_m2 = bonded_points(gel.shape, d.spacing_m)
        bonded, gradient, _ = interpolation_at(d, self.bonded_m)
        self.bonded_weight = bonded.matrix(d.node_count)
        self.bonded_gradient = FieldGradient(bonded.node_index, gradient, d.node_count)
