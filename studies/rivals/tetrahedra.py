# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A dome's gel as tetrahedra: geodesic layers from the core to the skin, prisms cut in three."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin
from dotsim_ros.io.arrays import FloatArray, IndexArray


@dataclass(frozen=True)
class TetrahedralMesh:
    """Tetrahedra of positive volume.

    Attributes:
        position_m: (N, 3) nodes at rest, base frame.
        tetrahedra: (T, 4) node numbers.
        is_fixed: (N,) whether a node is bonded, to the core or to the base.
        surface: (S, 3) triangles of the free skin, node numbers, counter-clockwise from outside.
    """

    position_m: FloatArray
    tetrahedra: IndexArray
    is_fixed: NDArray[np.bool_]
    surface: IndexArray


def edge_matrices(position_m: FloatArray, tetrahedra: IndexArray) -> FloatArray:
    """Return (T, 3, 3) matrices whose columns are the edges from the last node to the others."""
    corner = position_m[tetrahedra]
    return np.swapaxes(corner[:, :3] - corner[:, 3:], 1, 2)


def dome_shell(
    outer_radius_m: float, core_radius_m: float, spacing_m: float, layer_count: int
) -> TetrahedralMesh:
    """Return a hemispherical shell, bonded to its core and to the base plane z = 0.

    Args:
        outer_radius_m: radius of the skin.
        core_radius_m: radius of the bonded core.
        spacing_m: longest edge on the skin.
        layer_count: prisms from core to skin; their heights grow with the radius, as their sides
            do.
    """
    cap = dome_skin(outer_radius_m, spacing_m)
    direction = cap.rest_position_m / outer_radius_m
    share = np.linspace(0.0, 1.0, layer_count + 1)
    radius = core_radius_m * (outer_radius_m / core_radius_m) ** share
    position = (radius[:, None, None] * direction).reshape(-1, 3)
    count = len(direction)
    # Neighbouring prisms agree on the diagonals of their common sides: from the lower number below
    # to the higher above.
    a, b, c = np.sort(cap.triangles, axis=1).T
    below = np.stack([a, b, c], axis=1)[None] + count * np.arange(layer_count)[:, None, None]
    above = below + count
    tetrahedra = np.concatenate(
        [
            np.stack(
                [below[..., 0], *(lower[..., i] for lower, i in corners)],
                axis=-1,
            ).reshape(-1, 4)
            for corners in (
                ((below, 1), (below, 2), (above, 2)),
                ((below, 1), (above, 1), (above, 2)),
                ((above, 0), (above, 1), (above, 2)),
            )
        ]
    )
    inverted = np.linalg.det(edge_matrices(position, tetrahedra)) < 0.0
    tetrahedra[inverted] = tetrahedra[inverted][:, [1, 0, 2, 3]]
    layer = np.repeat(np.arange(layer_count + 1), count)
    return TetrahedralMesh(
        position,
        tetrahedra.astype(np.int32),
        (layer == 0) | np.tile(cap.on_base, layer_count + 1),
        (cap.triangles + count * layer_count).astype(np.int32),
    )


def attach_skin(mesh: TetrahedralMesh, skin: SkinMesh) -> sparse.csr_matrix:
    """Return (V, N) weights of a skin's displacement: barycentric in the triangle that the
    ray from the centre to the vertex passes."""
    direction = skin.rest_position_m
    corner = mesh.position_m[mesh.surface]
    inverse = np.linalg.inv(np.swapaxes(corner, 1, 2))
    weight = np.zeros((len(direction), 3))
    triangle = np.zeros(len(direction), dtype=np.intp)
    for vertex, ray in enumerate(direction):
        share = inverse @ ray
        triangle[vertex] = np.argmax(share.min(axis=1))
        inside = np.maximum(share[triangle[vertex]], 0.0)
        weight[vertex] = inside / inside.sum()
    row = np.repeat(np.arange(len(direction)), 3)
    column = mesh.surface[triangle].ravel()
    shape = (len(direction), len(mesh.position_m))
    return sparse.csr_matrix((weight.ravel(), (row, column)), shape=shape)
