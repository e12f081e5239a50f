# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hexahedral mesh of a dome shell, graded towards where it is pressed.

The hemisphere is mapped onto the unit disc by the stereographic projection, on which a Moebius map
moves the centre to the place of the press and keeps the rim, the base plane: both keep angles, so
that the mesh is equally good wherever it is pressed. The disc is divided into a square block in the
middle, as fine as asked for, and four blocks around it that grow coarser towards the base. Layers
between skin and core grow coarser inwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, IntArray

GROWTH = 1.35
"""Usual largest ratio of the sizes of two neighbouring elements."""

SQUARE_SHARE = 0.86
"""Half the side of the middle block over the radius that it covers: its corners are drawn in and
its sides bulge, so that no angle comes close to 0 or 180 degrees."""

BULGE = 0.5
"""How far the middle block's edge is on its way from a square (0) to a circle (1)."""

REACH_M = 0.5e-3
"""Skin closer to the indenter than this belongs to the place of the press."""


@dataclass(frozen=True)
class MeshedPress:
    """Where a dome is pressed.

    Attributes:
        pole: (3,) unit vector from the dome's centre to the middle of the pressed skin.
        radius_m: arc length from there to the farthest skin that is pressed.
    """

    pole: FloatArray
    radius_m: float


@dataclass(frozen=True)
class DomeMesh:
    """Quadratic hexahedra with 20 nodes, numbered as CalculiX numbers C3D20R.

    Attributes:
        node_m: (N, 3) at rest, base frame.
        element: (E, 20) node numbers from 0: corners of the inner face, of the outer face, then the
            middles of the inner edges, of the outer and of the radial ones.
        skin_element: (Q,) elements whose outer face lies on the skin.
        skin_face: (Q, 8) nodes of those faces: corners, then middles of the edges.
        bonded: (B,) nodes on the base plane and on the core.
    """

    node_m: FloatArray
    element: IntArray
    skin_element: IntArray
    skin_face: IntArray
    bonded: IntArray


def pressed_place(skin_m: FloatArray, indenter: Indenter, poses: Sequence[Pose]) -> MeshedPress:
    """Return where an indenter on its way presses a dome about the origin.

    Args:
        skin_m: (V, 3) skin at rest.
        indenter: the rigid shape.
        poses: of its frame in the base frame.

    Raises:
        ValueError: the indenter touches the skin in none of the poses.
    """
    pressed = np.zeros(len(skin_m), dtype=bool)
    for pose in poses:
        pressed |= indenter.distance_from(skin_m, pose) < REACH_M
    if not pressed.any():
        raise ValueError("the indenter touches the skin in none of the poses; press deeper")
    radius = np.linalg.norm(skin_m, axis=1)
    direction = skin_m / radius[:, None]
    pole = direction[pressed].mean(axis=0)
    pole /= np.linalg.norm(pole)
    angle = np.arccos(np.clip(direction[pressed] @ pole, -1.0, 1.0))
    return MeshedPress(pole, float(radius.max() * angle.max()))


def growing_marks(length: float, first: float, *, largest_ratio: float = GROWTH) -> FloatArray:
    """Return (n + 1,) marks from 0 to `length` whose intervals grow from about `first`."""
    count, reach, size = 0, 0.0, first
    while reach < length:
        reach += size
        size *= largest_ratio
        count += 1
    marks = np.concatenate([[0.0], np.cumsum(largest_ratio ** np.arange(count))])
    return np.asarray(marks * length / marks[-1])


def halved_marks(marks: FloatArray) -> FloatArray:
    """Return the marks with the middle of each interval between them."""
    between = 0.5 * (marks[1:] + marks[:-1])
    return np.concatenate([np.stack([marks[:-1], between], axis=1).ravel(), marks[-1:]])


def _disc_points(across: FloatArray, along: FloatArray, middle: float) -> FloatArray:
    """Return the points (..., 2), as an angle from the pole times a direction, of the blocks.

    Args:
        across: (...) -1 to 1 over the width of the block on the +x side.
        along: (...) angle from the pole, rad, at the middle of the block's width.
        middle: of the square block's edge.
    """
    angle = 0.25 * np.pi * across
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    square = np.stack([np.ones_like(across), across], axis=-1) * SQUARE_SHARE
    outside = np.clip((along - middle) / (0.5 * np.pi - middle), 0.0, 1.0)
    share = np.where(along < middle, BULGE * along / middle, BULGE + (1.0 - BULGE) * outside**0.5)
    share = share[..., None]
    return np.asarray(along[..., None] * ((1.0 - share) * square + share * circle))


def _cells(shape: tuple[int, int]) -> IntArray:
    """Return the (n, 9) numbers of the points, in a grid of doubled marks, of each cell: corners,
    middles of the edges, centre."""
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    order = [(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1), (1, 1)]
    rows, columns = shape[0] - 2, shape[1] - 2
    return np.stack(
        [number[i : i + rows : 2, j : j + columns : 2].ravel() for i, j in order], axis=1
    )


def _disc(middle: float, step: float, growth: float) -> tuple[FloatArray, IntArray]:
    """Return points (P, 2), angle times direction, and cells (C, 9) of the divided disc.

    Args:
        middle: angle that the square block covers, rad.
        step: size of its cells, rad.
        growth: largest ratio of the sizes of two neighbouring rings around it.
    """
    count = 2 * max(1, int(np.ceil(middle / step)))
    across = halved_marks(np.linspace(-1.0, 1.0, count + 1))
    # Of the square block each point lies in the quarter of its larger coordinate.
    x, y = np.meshgrid(across, across, indexing="ij")
    larger = np.maximum(np.abs(x), np.abs(y))
    along_x = np.abs(x) >= np.abs(y)
    side = np.where(along_x, y, x) / np.maximum(larger, 1e-12)
    lying = _disc_points(side, larger * middle, middle)
    points = np.where(
        along_x[..., None],
        np.stack([np.sign(x) * lying[..., 0], lying[..., 1]], axis=-1),
        np.stack([lying[..., 1], np.sign(y) * lying[..., 0]], axis=-1),
    )
    points = np.where((x == 0.0)[..., None] & (y == 0.0)[..., None], 0.0, points)
    blocks = [points.reshape(-1, 2)]
    cells = [_cells((len(across), len(across)))]
    outer = middle / (0.5 * count) * 1.2
    rings = middle + halved_marks(growing_marks(0.5 * np.pi - middle, outer, largest_ratio=growth))
    along, width = np.meshgrid(rings, across, indexing="ij")
    block = _disc_points(width, along, middle).reshape(-1, 2)
    for quarter in range(4):
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
        cells.append(_cells((len(rings), len(across))) + sum(map(len, blocks)))
        blocks.append(block @ np.array([[c, s], [-s, c]], dtype=np.float64))
    position = np.concatenate(blocks)
    _, first, merged = np.unique(
        np.round(position * 1e8).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    return position[first], merged.reshape(-1)[np.concatenate(cells)]


def _on_hemisphere(points: FloatArray, pole: FloatArray) -> FloatArray:
    """Return (P, 3) unit vectors: the disc's centre becomes the pole, its rim stays the base."""
    angle = np.linalg.norm(points, axis=1)
    direction = (points[:, 0] + 1j * points[:, 1]) / np.maximum(angle, 1e-12)
    plane = np.tan(0.5 * angle) * direction
    # The stereographic image of the pole.
    shift = (pole[0] + 1j * pole[1]) / (1.0 + pole[2])
    moved = (plane + shift) / (1.0 + np.conj(shift) * plane)
    square = np.abs(moved) ** 2
    height = (1.0 - square) / (1.0 + square)
    height[angle > 0.5 * np.pi - 1e-9] = 0.0
    radius = np.sqrt(1.0 - height**2)
    turned = moved / np.maximum(np.abs(moved), 1e-12)
    return np.stack([radius * turned.real, radius * turned.imag, height], axis=1)


def dome_mesh(
    *,
    core_radius_m: float,
    outer_radius_m: float,
    press: MeshedPress,
    spacing_m: float,
    growth: float = GROWTH,
) -> DomeMesh:
    """Return the mesh of a dome shell.

    Args:
        core_radius_m: the gel is bonded here.
        outer_radius_m: the skin at rest.
        press: where it is pressed: the middle block.
        spacing_m: size of the elements there.
        growth: largest ratio of the sizes of two neighbouring elements.

    Raises:
        ValueError: no shell, or a spacing that does not fit into it.
    """
    if not 0.0 < core_radius_m < outer_radius_m:
        raise ValueError(
            f"the reference needs a rigid core: its radius is {core_radius_m} m, expected above 0 "
            f"and below the dome's {outer_radius_m} m"
        )
    if not 0.0 < spacing_m <= 0.5 * (outer_radius_m - core_radius_m):
        raise ValueError(
            f"element spacing is {spacing_m} m, expected above 0 and at most half the gel's "
            f"thickness of {outer_radius_m - core_radius_m:.4g} m"
        )
    # Elsewhere the rings would have no room to grow.
    middle = min(press.radius_m / outer_radius_m, 0.6)
    points, cells = _disc(middle, spacing_m / outer_radius_m, growth)
    direction = _on_hemisphere(points, press.pole)
    depth = halved_marks(
        growing_marks(outer_radius_m - core_radius_m, spacing_m, largest_ratio=growth)
    )
    radii = (outer_radius_m - depth)[::-1]
    node = (radii[:, None, None] * direction).reshape(-1, 3)
    count = len(points)
    corner, edge = cells[:, :4], cells[:, 4:8]
    elements = []
    for lower in range(0, len(radii) - 1, 2):
        inner, between, outer = (count * (lower + k) for k in range(3))
        elements.append(
            np.concatenate(
                [corner + inner, corner + outer, edge + inner, edge + outer, corner + between],
                axis=1,
            )
        )
    element = np.concatenate(elements)
    used, element = np.unique(element, return_inverse=True)
    element = element.reshape(-1, 20)
    node = node[used]
    skin_element = np.arange(len(element) - len(cells), len(element))
    skin_face = element[skin_element][:, [4, 5, 6, 7, 12, 13, 14, 15]]
    on_core = np.linalg.norm(node, axis=1) < core_radius_m * (1.0 + 1e-9)
    bonded = np.flatnonzero(on_core | (node[:, 2] < 1e-9 * outer_radius_m))
    return DomeMesh(node, element, skin_element, skin_face, bonded)


def _face_shapes(at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the 8 shape functions (M, 8) of a quadratic face and their derivatives (M, 8, 2)."""
    r, s = at[:, :1], at[:, 1:]
    rc = np.array([-1.0, 1.0, 1.0, -1.0])
    sc = np.array([-1.0, -1.0, 1.0, 1.0])
    corner = 0.25 * (1 + rc * r) * (1 + sc * s) * (rc * r + sc * s - 1)
    corner_r = 0.25 * rc * (1 + sc * s) * (2 * rc * r + sc * s)
    corner_s = 0.25 * sc * (1 + rc * r) * (rc * r + 2 * sc * s)
    edges, edges_r, edges_s = [], [], []
    for side, sign in ((0, -1.0), (1, 1.0), (0, 1.0), (1, -1.0)):
        if side == 0:
            edges.append(0.5 * (1 - r * r) * (1 + sign * s))
            edges_r.append(-r * (1 + sign * s))
            edges_s.append(0.5 * sign * (1 - r * r))
        else:
            edges.append(0.5 * (1 - s * s) * (1 + sign * r))
            edges_r.append(0.5 * sign * (1 - s * s))
            edges_s.append(-s * (1 + sign * r))
    shape = np.concatenate([corner, *edges], axis=1)
    along_r = np.concatenate([corner_r, *edges_r], axis=1)
    along_s = np.concatenate([corner_s, *edges_s], axis=1)
    return shape, np.stack([along_r, along_s], axis=2)


@dataclass(frozen=True)
class SkinInterpolation:
    """Where points of the skin lie in the mesh: nodes (V, 8) and weights (V, 8)."""

    node: IntArray
    weight: FloatArray

    def of(self, values: FloatArray) -> FloatArray:
        """Return nodal values (N, 3) at the points (V, 3)."""
        return np.einsum("va,vax->vx", self.weight, values[self.node])


CANDIDATE_FACES = 8
"""A point is looked for in this many faces nearest to it."""


def interpolate_skin(mesh: DomeMesh, points_m: FloatArray) -> SkinInterpolation:
    """Return where points (V, 3) on the skin at rest lie in the mesh's outer faces.

    Raises:
        ValueError: a point lies off the mesh.
    """
    corners = mesh.node_m[mesh.skin_face]
    _, candidates = cKDTree(corners.mean(axis=1)).query(points_m, k=CANDIDATE_FACES)
    node = np.zeros((len(points_m), 8), dtype=np.int64)
    weight = np.zeros((len(points_m), 8))
    best = np.full(len(points_m), np.inf)
    for column in candidates.T:
        face = corners[column]
        at = np.zeros((len(points_m), 2))
        for _ in range(8):
            shape, derivative = _face_shapes(at)
            missing = points_m - np.einsum("va,vax->vx", shape, face)
            tangent = np.einsum("vab,vax->vxb", derivative, face)
            normal = np.einsum("vxb,vxc->vbc", tangent, tangent)
            side = np.einsum("vxb,vx->vb", tangent, missing)
            at = np.clip(at + np.linalg.solve(normal, side[..., None])[..., 0], -1.5, 1.5)
        outside = np.abs(at).max(axis=1)
        better = outside < best - 1e-9
        shape, _ = _face_shapes(np.clip(at, -1.0, 1.0))
        node[better], weight[better] = mesh.skin_face[column][better], shape[better]
        best = np.minimum(best, outside)
    if best.max() > 1.05:
        lost = int(np.argmax(best))
        raise ValueError(f"skin point {lost} at {points_m[lost].tolist()} m lies off the mesh")
    return SkinInterpolation(node, weight)
