# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How deep an indenter lies in a gel at rest, whatever the gel does under it."""

from __future__ import annotations

import numpy as np

from dotsim_ros.gel.body import Body, Dome, Pad
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pad_face import face_normal
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.surface import indenter_surface
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import face_drop_m

POINT_SPACING_M = 0.4e-3
"""Of the points on an indenter: between them a ball of 4 mm radius lies up to 7 um deeper..."""
POINTS_ACROSS = 60
"""...or wider, on an indenter of more than 24 mm: so many lie across it."""


class RestDepth:
    """Depth of one indenter in the shape of one gel.

    The depth is that of the indenter's deepest point below the gel's free surface. Outside it is
    negative, and the indenter is at least so far from the gel. In a dome it is exact, in a pad as
    exact as the spacing of the points on the indenter.

    Args:
        body: the gel's shape.
        indenter: the rigid shape.
    """

    def __init__(self, body: Body, indenter: Indenter) -> None:
        self._body, self._indenter = body, indenter
        self._point_m = np.zeros((0, 3))
        if isinstance(body, Pad):
            longest_m = float(np.ptp(indenter.bounds_m(), axis=0).max())
            self._point_m = _points_on(indenter, max(POINT_SPACING_M, longest_m / POINTS_ACROSS))

    def __call__(self, pose: Pose) -> float:
        """Return the depth in metres at a pose in the base frame."""
        if isinstance(self._body, Dome):
            # The deepest point of the indenter is the one that is nearest to the dome's centre.
            nearest_m = self._indenter.distance_from(np.zeros((1, 3)), pose)
            return self._body.outer_radius_m - float(nearest_m[0])
        assert isinstance(self._body, Pad)
        return float(_depth_in_pad_m(self._body, pose.apply(self._point_m)).max())


def _depth_in_pad_m(pad: Pad, points_m: FloatArray) -> FloatArray:
    """Return the depth (N,) of points (N, 3) below the nearest of a pad's faces but the base."""
    x, y, z = points_m.T
    half_x, half_y = 0.5 * pad.size_m[0], 0.5 * pad.size_m[1]
    place = np.clip(x, -half_x, half_x), np.clip(y, -half_y, half_y)
    height_m = pad.size_m[2] - face_drop_m(*place, pad.curvature_per_m)
    below_m = (height_m - z) * face_normal(*place, pad.curvature_per_m)[..., 2]
    depth_m: FloatArray = np.minimum(below_m, np.minimum(half_x - np.abs(x), half_y - np.abs(y)))
    return depth_m


def _points_on(indenter: Indenter, spacing_m: float) -> FloatArray:
    """Return points (N, 3) on an indenter's surface, in its frame."""
    surface = indenter_surface(indenter, spacing_m)
    if indenter.mesh is None:
        return surface.vertices_m
    # Loaded on use: primitives need no trimesh.
    from trimesh.remesh import subdivide_to_size

    points_m: FloatArray = subdivide_to_size(
        surface.vertices_m, surface.triangles, max_edge=2.0 * spacing_m
    )[0]
    # A fine mesh has many more than are needed.
    cell = np.floor(points_m / spacing_m).astype(np.int64)
    return points_m[np.unique(cell, axis=0, return_index=True)[1]]
