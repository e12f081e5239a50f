# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Distance from points to a triangle mesh, by Warp's bounding volume hierarchy."""

# Warp reads kernels' annotations by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, attr-defined, var-annotated"

from __future__ import annotations

import functools
from collections.abc import Hashable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.io.arrays import FloatArray, IndexArray
from dotsim_ros.io.warp_runtime import wp

# Triangles of metre coordinates have areas of 1e-9 m^2, whose squares underflow towards the
# tolerances of float32 geometry; millimetres are well scaled.
MILLIMETRES_PER_METRE = 1000.0


@wp.kernel(enable_backward=False)
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


@wp.kernel(enable_backward=False)
def _distance(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    farthest: float,
    distance: wp.array(dtype=float),
):
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], farthest)
    if query.result:
        nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        distance[i] = wp.length(points[i] - nearest)
    else:
        distance[i] = farthest


class ClosedMesh(Hashable, Protocol):
    """A closed surface: vertices_m (V, 3), triangles (T, 3), counter-clockwise from outside."""

    @property
    def vertices_m(self) -> FloatArray: ...

    @property
    def triangles(self) -> NDArray[np.int32]: ...


def mesh_signed_distance(mesh: ClosedMesh, points_m: FloatArray) -> FloatArray:
    """Return signed distances (N,) of points (N, 3) to a closed mesh, metres, negative inside.

    Inside is where the winding number is above one half, so overlapping closed bodies count as
    their union for the sign.
    """
    return _found(_signed_distance, _closed_hierarchy(mesh), points_m)


def surface_distance(
    points_m: FloatArray, position_m: FloatArray, triangles: IndexArray
) -> FloatArray:
    """Return the distance (N,) of points to the nearest point of a triangle surface, exact to some
    nanometres."""
    return _found(_distance, _hierarchy(position_m, triangles), points_m)


@functools.lru_cache(maxsize=32)
def _closed_hierarchy(mesh: ClosedMesh) -> wp.Mesh:
    """Return a mesh's bounding volumes, kept: building them takes longer than querying them."""
    return _hierarchy(mesh.vertices_m, mesh.triangles, is_closed=True)


def _hierarchy(
    position_m: FloatArray, triangles: IndexArray, *, is_closed: bool = False
) -> wp.Mesh:
    return wp.Mesh(
        points=_in_millimetres(position_m),
        indices=wp.array(triangles.reshape(-1), dtype=wp.int32, device="cpu"),
        support_winding_number=is_closed,
    )


def _in_millimetres(position_m: FloatArray) -> wp.array:
    scaled = np.ascontiguousarray(position_m * MILLIMETRES_PER_METRE, dtype=np.float32)
    return wp.array(scaled, dtype=wp.vec3, device="cpu")


def _found(kernel: wp.Kernel, mesh: wp.Mesh, points_m: FloatArray) -> FloatArray:
    distance = wp.empty(len(points_m), dtype=float, device="cpu")
    inputs = [mesh.id, _in_millimetres(points_m), 1.0e6]
    wp.launch(kernel, dim=len(points_m), inputs=inputs, outputs=[distance], device="cpu")
    return distance.numpy().astype(np.float64) / MILLIMETRES_PER_METRE
