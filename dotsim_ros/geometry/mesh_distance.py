# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Signed distance from points to a closed triangle mesh, by Warp's bounding volume hierarchy."""

# Warp reads kernels' annotations by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, attr-defined, var-annotated"

from __future__ import annotations

import functools
from collections.abc import Hashable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.warp_runtime import wp

# Triangles of metre coordinates have areas of 1e-9 m^2, whose squares underflow towards the
# tolerances of float32 geometry; millimetres are well scaled.
MILLIMETRES_PER_METRE = 1000.0


@wp.kernel
def _signed_distance(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    farthest: float,
    distance: wp.array(dtype=float),
):
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, points[i], farthest)
    if query.result:
        nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        distance[i] = query.sign * wp.length(points[i] - nearest)
    else:
        distance[i] = farthest


class ClosedMesh(Hashable, Protocol):
    """A closed surface: vertices_m (V, 3), triangles (T, 3), counter-clockwise from outside."""

    @property
    def vertices_m(self) -> FloatArray: ...

    @property
    def triangles(self) -> NDArray[np.int32]: ...


@functools.lru_cache(maxsize=32)
def _hierarchy(mesh: ClosedMesh) -> wp.Mesh:
    """Return a mesh's bounding volumes, kept: building them takes longer than querying them."""
    return wp.Mesh(
        points=wp.array(mesh.vertices_m * MILLIMETRES_PER_METRE, dtype=wp.vec3, device="cpu"),
        indices=wp.array(mesh.triangles.reshape(-1), dtype=wp.int32, device="cpu"),
        support_winding_number=True,
    )


def mesh_signed_distance(mesh: ClosedMesh, points_m: FloatArray) -> FloatArray:
    """Return signed distances (N,) of points (N, 3) to a closed mesh, metres, negative inside.

    Inside is where the winding number is above one half, so overlapping closed bodies count as
    their union for the sign.
    """
    points = wp.array(
        np.ascontiguousarray(points_m * MILLIMETRES_PER_METRE, dtype=np.float32),
        dtype=wp.vec3,
        device="cpu",
    )
    distance = wp.empty(len(points_m), dtype=float, device="cpu")
    wp.launch(
        _signed_distance,
        dim=len(points_m),
        inputs=[_hierarchy(mesh).id, points, 1.0e6],
        outputs=[distance],
        device="cpu",
    )
    return distance.numpy().astype(np.float64) / MILLIMETRES_PER_METRE
