# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Nodal fields at particles, markers and bonded points, and how they vary with these points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.gel.discretization import bonded_points, interpolation_at
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.io.arrays import FloatArray, IndexArray


@dataclass(frozen=True)
class FieldGradient:
    """Evaluates the gradient of a nodal field at fixed points."""

    node_index: IndexArray
    weight_gradient: FloatArray

    def at(self, nodal: FloatArray) -> FloatArray:
        """Return (P, 3, 3) of nodal values (N, 3), [point, component, direction]."""
        # Node by node, so that no array of (P, 27, 3, 3) arises.
        result = np.zeros((len(self.node_index), 3, 3))
        for a in range(27):
            result += (
                nodal[self.node_index[:, a]][:, :, None] * self.weight_gradient[:, a][:, None, :]
            )
        return result


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
        self.particle_gradient = FieldGradient(particles.node_index, gradient)
        inward = 1.0 - 1e-9
        markers, gradient, _ = interpolation_at(d, gel.skin.rest_position_m * inward)
        self.marker_gradient = FieldGradient(markers.node_index, gradient)
        self.bonded_m, self.bonded_area_m2 = bonded_points(gel.shape, d.spacing_m)
        bonded, gradient, _ = interpolation_at(d, self.bonded_m)
        self.bonded_weight = bonded.matrix(d.node_count)
        self.bonded_gradient = FieldGradient(bonded.node_index, gradient)
