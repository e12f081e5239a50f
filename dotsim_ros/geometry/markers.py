# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Dots that are printed on the skin: where they are, and how far a press moves them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, IndexArray
from dotsim_ros.specification import MarkerSpecification

EDGE = 1e-9
"""A marker on the edge of two triangles lies in both but for rounding."""


@dataclass(frozen=True)
class MarkerMotion:
    """Where printed markers are at rest and now; row by row, along +x first, then along +y.

    Attributes:
        rest_m, position_m: (N, 3) base frame.
        rest_px, position_px: (N, 2) x and y in the camera's image, also of a marker beyond its
            edge; NaN where the camera has no image of it.
    """

    rest_m: FloatArray
    position_m: FloatArray
    rest_px: FloatArray
    position_px: FloatArray


def grid_m(markers: MarkerSpecification) -> FloatArray:
    """Return the places (N, 2) of markers seen along the z axis, row by row."""
    x, y = (
        spacing * (np.arange(count) - 0.5 * (count - 1))
        for spacing, count in zip(markers.spacing_m, (markers.columns, markers.rows), strict=True)
    )
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


class PrintedMarkers:
    """Markers that go along with the triangles of a skin.

    Args:
        markers: the grid.
        skin: that it is printed on, from above.

    Attributes:
        corner, weight: (N, 3) vertices of the triangle that each lies on, and their weights.
        rest_m: (N, 3) at rest, base frame.

    Raises:
        ValueError: a marker lies next to the skin.
    """

    def __init__(self, markers: MarkerSpecification, skin: SkinMesh) -> None:
        places = grid_m(markers)
        corner, weight = zip(*(_found(place, skin) for place in places), strict=True)
        self.corner: IndexArray = np.stack(corner)
        self.weight: FloatArray = np.stack(weight)
        self.rest_m: FloatArray = self.position_m(skin.rest_position_m)

    def position_m(self, skin_position_m: FloatArray) -> FloatArray:
        """Return where the markers (N, 3) of a skin (V, 3) are."""
        return np.asarray(np.einsum("nc,ncx->nx", self.weight, skin_position_m[self.corner]))

    def motion(self, skin_position_m: FloatArray, camera: Camera) -> MarkerMotion:
        """Return how the markers of a skin (V, 3) have moved, and how a camera sees it."""
        position_m = self.position_m(skin_position_m)
        return MarkerMotion(
            self.rest_m, position_m, camera.project(self.rest_m), camera.project(position_m)
        )


def _found(place_m: FloatArray, skin: SkinMesh) -> tuple[IndexArray, FloatArray]:
    """Return the vertices (3,) of the triangle below a place (2,), and its weights there (3,)."""
    first, second, third = np.moveaxis(skin.rest_position_m[skin.triangles, :2], 1, 0)
    area = _cross(second - first, third - first)
    # A triangle that stands upright is seen from its edge.
    weight = (
        np.stack(
            [
                _cross(second - place_m, third - place_m),
                _cross(third - place_m, first - place_m),
                _cross(first - place_m, second - place_m),
            ],
            axis=1,
        )
        / np.where(area > 0.0, area, np.nan)[:, None]
    )
    inside = np.flatnonzero(np.all(weight >= -EDGE, axis=1))
    if not len(inside):
        raise ValueError(
            f"a marker at x, y {place_m.tolist()} m lies next to the skin; expected "
            "markers.columns, markers.rows and markers.spacing_m of a grid that fits it"
        )
    return skin.triangles[inside[0]], weight[inside[0]]


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
