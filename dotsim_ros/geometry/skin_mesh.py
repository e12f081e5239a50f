# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The outer skin of the gel: triangle meshes of fixed topology that move with the gel.

Both meshes are made of nearly equilateral triangles: rows of vertices with a varying count would
need half as many more for the same longest edge.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from dotsim_ros.geometry.pad_face import face_normal
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import BoolArray, FloatArray, IndexArray
from dotsim_ros.specification import face_drop_m


def face_vectors(position_m: FloatArray, triangles: IndexArray) -> FloatArray:
    """Return (T, 3) normals of the triangles, as long as twice their areas (m^2)."""
    first = position_m[triangles[:, 0]]
    return np.cross(position_m[triangles[:, 1]] - first, position_m[triangles[:, 2]] - first)


def _sum_at_vertices(values: FloatArray, triangles: IndexArray, vertex_count: int) -> FloatArray:
    return np.asarray(
        np.bincount(triangles.ravel(), np.repeat(values, 3), vertex_count), dtype=np.float64
    )


def vertex_normals(position_m: ArrayLike, triangles: IndexArray) -> FloatArray:
    """Return (V, 3) unit normals on the side of the triangles' winding, weighted by area.

    Args:
        position_m: (V, 3) vertices, in any frame.
        triangles: (T, 3) vertex numbers.

    A vertex whose triangles have no area, or cancel out, gets the zero vector.
    """
    position = np.asarray(position_m, dtype=np.float64)
    faces = face_vectors(position, triangles)
    summed = np.stack(
        [_sum_at_vertices(faces[:, axis], triangles, len(position)) for axis in range(3)], axis=-1
    )
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.divide(summed, length, out=np.zeros_like(summed), where=length > 0.0)


@dataclass(frozen=True)
class SkinMesh:
    """A skin at rest, in the base frame; triangles wind so that normals point out of the gel.

    Attributes:
        rest_position_m: (V, 3) vertices at rest.
        triangles: (T, 3) int32 vertex numbers.
        on_base: (V,) whether a vertex lies on the base plane z = 0, where the gel is bonded.
        rest_area_m2: (V,) a third of the area of the triangles around each vertex.
    """

    rest_position_m: FloatArray
    triangles: IndexArray
    on_base: BoolArray
    rest_area_m2: FloatArray

    @property
    def vertex_count(self) -> int:
        return len(self.rest_position_m)

    @property
    def apex_m(self) -> FloatArray:
        """Where the sensor's axis, z of the base frame, meets the skin of a dome or pad: (3,)."""
        return np.array([0.0, 0.0, self.rest_position_m[:, 2].max()])


def skin_of_triangles(rest_position_m: ArrayLike, triangles: ArrayLike) -> SkinMesh:
    """Return the skin of given triangles, such as those of a measured one.

    Args:
        rest_position_m: (V, 3) vertices at rest, in the base frame.
        triangles: (T, 3) vertex numbers, counter-clockwise seen from outside.

    Raises:
        ValueError: a wrong shape, a coordinate that is not finite, or a number of no vertex.
    """
    position = np.array(rest_position_m, dtype=np.float64)
    faces = np.array(triangles)
    if position.ndim != 2 or position.shape[1] != 3 or not np.all(np.isfinite(position)):
        raise ValueError(
            f"rest_position_m has shape {position.shape}, expected (V, 3) of finite numbers"
        )
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(
            f"triangles have shape {faces.shape} and type {faces.dtype}, expected (T, 3) integers"
        )
    if faces.size and not 0 <= faces.min() <= faces.max() < len(position):
        raise ValueError(
            f"triangles name vertices {faces.min()} to {faces.max()}, expected 0 to "
            f"{len(position) - 1}"
        )
    faces = faces.astype(np.int32)
    area = 0.5 * np.linalg.norm(face_vectors(position, faces), axis=1)
    return SkinMesh(
        rest_position_m=position,
        triangles=faces,
        on_base=np.abs(position[:, 2]) < 1e-9,
        rest_area_m2=_sum_at_vertices(area / 3.0, faces, len(position)),
    )


def _icosahedron() -> tuple[FloatArray, IndexArray]:
    """Return the vertices (11, 3) and the faces (15, 3) of a unit icosahedron that stands on one
    vertex, without that vertex: the upper cap and the band around the equator."""
    turn = 2.0 * np.pi * np.arange(5) / 5.0
    height = 1.0 / np.sqrt(5.0)
    upper = np.stack([2 * height * np.cos(turn), 2 * height * np.sin(turn), 0 * turn + height], 1)
    turn = turn + np.pi / 5.0
    lower = np.stack([2 * height * np.cos(turn), 2 * height * np.sin(turn), 0 * turn - height], 1)
    first = np.arange(5)
    following = (first + 1) % 5
    faces = np.concatenate(
        [
            np.stack([0 * first, 1 + first, 1 + following], axis=1),
            np.stack([6 + first, 1 + following, 1 + first], axis=1),
            np.stack([1 + following, 6 + first, 6 + following], axis=1),
        ]
    )
    return np.concatenate([[[0.0, 0.0, 1.0]], upper, lower]), faces.astype(np.int32)


def _subdivision(frequency: int) -> tuple[FloatArray, IndexArray]:
    """Return barycentric coordinates (N, 3) and triangles (frequency^2, 3) of a divided face."""
    i, j = np.meshgrid(np.arange(frequency + 1), np.arange(frequency + 1), indexing="ij")
    inside = i + j <= frequency
    number = np.where(inside, np.cumsum(inside).reshape(inside.shape) - 1, -1)
    here, right, up, across = number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]
    upright = np.stack([here, right, up], axis=-1)[here >= 0]
    inverted = np.stack([right, across, up], axis=-1)[across >= 0]
    triangles = np.concatenate([upright, inverted])
    weights = np.stack([frequency - i - j, i, j], axis=-1)[inside] / frequency
    return weights, triangles[np.all(triangles >= 0, axis=1)].astype(np.int32)


def _dome_of_frequency(outer_radius_m: float, frequency: int) -> SkinMesh:
    """Return the upper half of a geodesic sphere; an even frequency puts a row of edges exactly on
    the equator, half-way down the band of faces."""
    corners, faces = _icosahedron()
    weights, small = _subdivision(frequency)
    points = np.einsum("nc,fcx->fnx", weights, corners[faces]).reshape(-1, 3)
    points[np.abs(points[:, 2]) < 1e-9, 2] = 0.0
    triangles = (small[None] + len(weights) * np.arange(len(faces))[:, None, None]).reshape(-1, 3)
    triangles = triangles[np.all(points[triangles, 2] >= 0.0, axis=1)]
    # Neighbouring faces share the points of their common edge.
    _, first, merged = np.unique(
        np.round(points * 1e7).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    triangles = merged.reshape(-1)[triangles]
    kept = np.unique(triangles)
    position = points[first[kept]]
    position *= outer_radius_m / np.linalg.norm(position, axis=1, keepdims=True)
    return skin_of_triangles(position, np.searchsorted(kept, triangles))


def _longest_edge(mesh: SkinMesh) -> float:
    corner = mesh.rest_position_m[mesh.triangles]
    return float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max())


def dome_skin(outer_radius_m: float, spacing_m: float) -> SkinMesh:
    """Return the skin of a hemispherical dome, base ring z = 0 included, apex on +z.

    The mesh is half a geodesic sphere: its edges differ by at most a third, and 0.5 mm on a dome
    of 15.75 mm takes 8,926 vertices.

    Args:
        outer_radius_m: radius of the dome.
        spacing_m: no two neighbouring vertices are farther apart than this.

    Raises:
        ValueError: the spacing is not between 0 and half the radius.
    """
    if not 0.0 < spacing_m <= 0.5 * outer_radius_m:
        raise ValueError(
            f"skin spacing is {spacing_m} m, expected above 0 and at most half the dome's radius "
            f"({0.5 * outer_radius_m:.4g} m)"
        )
    mesh = _dome_of_frequency(outer_radius_m, 2)
    frequency = 2
    while _longest_edge(mesh) > spacing_m:
        # The longest edge shrinks in proportion to the frequency, from above.
        needed = frequency * _longest_edge(mesh) / spacing_m
        frequency = max(frequency + 2, 2 * int(np.floor(0.5 * needed)))
        mesh = _dome_of_frequency(outer_radius_m, frequency)
    return mesh


def flat_pad_skin(size_m: tuple[float, float], thickness_m: float, spacing_m: float) -> SkinMesh:
    """Return the upper face of a flat pad that stands on the base, centred on the z axis.

    Args:
        size_m: lengths along x and y.
        thickness_m: height of the face over the base plane.
        spacing_m: no two neighbouring vertices are farther apart than this.

    Raises:
        ValueError: a length is not positive, or the spacing exceeds half the shorter side.
    """
    if min(*size_m, thickness_m) <= 0.0:
        raise ValueError(f"pad is {size_m} m and {thickness_m} m thick, expected positive lengths")
    if not 0.0 < spacing_m <= 0.5 * min(size_m):
        raise ValueError(
            f"skin spacing is {spacing_m} m, expected above 0 and at most half the pad's shorter "
            f"side ({0.5 * min(size_m):.4g} m)"
        )
    width, depth = size_m
    column_count = int(np.ceil(width / spacing_m))
    row_count = 2 * int(np.ceil(depth / (np.sqrt(3.0) * spacing_m)))
    even = width * (np.arange(column_count + 1) / column_count - 0.5)
    # Odd rows lie half a pitch aside and keep the pad's two edges.
    odd = np.concatenate([even[:1], 0.5 * (even[1:] + even[:-1]), even[-1:]])
    y = depth * (np.arange(row_count + 1) / row_count - 0.5)
    x = [odd if row % 2 else even for row in range(row_count + 1)]
    position = np.stack(
        np.broadcast_arrays(np.concatenate(x), np.repeat(y, [len(r) for r in x]), thickness_m),
        axis=-1,
    )
    column = np.arange(column_count + 1, dtype=np.int32)
    triangles = []
    for row in range(0, row_count, 2):
        below = row // 2 * (2 * column_count + 3)
        middle = below + column_count + 1
        above = middle + column_count + 2
        for start, winding in ((below, 1), (above, -1)):
            narrow = np.stack([start + column, middle + column + 1, middle + column], axis=1)
            wide = np.stack([start + column, start + column + 1, middle + column + 1], axis=1)[:-1]
            triangles.append(np.concatenate([narrow, wide])[:, ::winding])
    return skin_of_triangles(position, np.concatenate(triangles))


def pad_skin(
    size_m: tuple[float, float, float],
    spacing_m: float,
    *,
    curvature_per_m: tuple[float, float] = (0.0, 0.0),
) -> SkinMesh:
    """Return the upper face of a pad, flat or curved, centred on the z axis.

    Args:
        size_m: lengths along x and y, and the thickness in the middle.
        spacing_m: no two neighbouring vertices are farther apart than this.
        curvature_per_m: of the face along x and y.

    Raises:
        ValueError: as `flat_pad_skin`.
    """
    x, y, thickness = size_m
    # Edges lengthen with the slope, which is largest at the corners.
    corner = face_normal(np.array(0.5 * x), np.array(0.5 * y), curvature_per_m)
    flat = flat_pad_skin((x, y), thickness, spacing_m * float(corner[2]))
    if not any(curvature_per_m):
        return flat
    position = flat.rest_position_m.copy()
    position[:, 2] -= face_drop_m(position[:, 0], position[:, 1], curvature_per_m)
    return skin_of_triangles(position, flat.triangles)


def tip_depth_m(skin: SkinMesh, poses: Iterable[Pose]) -> FloatArray:
    """Return how deep (F,) the indenter's tip lies below the skin at rest; negative outside."""
    normal = vertex_normals(skin.rest_position_m, skin.triangles)
    tip = np.stack([pose.position_m for pose in poses])
    nearest = KDTree(skin.rest_position_m).query(tip)[1]
    return np.asarray(-np.sum((tip - skin.rest_position_m[nearest]) * normal[nearest], axis=1))
