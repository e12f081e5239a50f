# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The skin seen from outside, flattened to a disc and coloured by how far it moved."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay

import msg_adapters
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import ArrayForm, read_arrays

FLAT_RATIO = 0.3
"""A skin lower than this part of its half-width is drawn as it lies, not unrolled."""


def rest_position_m(cloud: msg_adapters.Cloud) -> FloatArray:
    """Return the (V, 3) points of a cloud at rest, as far as the cloud holds them."""
    position = np.asarray(cloud.position, dtype=np.float64)
    return position if cloud.displacement is None else position - cloud.displacement


def read_rest_m(path: Path) -> FloatArray:
    """Return the (V, 3) skin at rest of an .npz with `rest_position_m`.

    Raises:
        FileNotFoundError, ValueError: there is none.
    """
    return read_arrays(path, {"rest_position_m": ArrayForm((None, 3))})["rest_position_m"]


class SkinMap:
    """A raster that shows values at the skin's vertices.

    A dome is unrolled: the distance from the middle is the angle from its apex (azimuthal
    equidistant), +x to the right and +y down, as its camera sees it.

    Args:
        rest_m: (V, 3) vertices at rest.
        size_px: width and height.

    Raises:
        ValueError: fewer than 3 vertices, or all on a line.
    """

    def __init__(self, rest_m: ArrayLike, *, size_px: int) -> None:
        rest = np.asarray(rest_m, dtype=np.float64)
        flat, triangulation = _triangulated(rest)
        half = 1.02 * float(np.abs(flat).max())
        ticks = np.linspace(-half, half, size_px)
        across, down = np.meshgrid(ticks, ticks)
        pixels = np.stack([across.ravel(), down.ravel()], axis=1)
        simplex = triangulation.find_simplex(pixels)
        # The hull of a ring of points bridges their gaps with slivers; a disc ends at its rim.
        inside = (simplex >= 0) & (np.hypot(*pixels.T) <= np.hypot(*flat.T).max())
        transform = triangulation.transform[simplex[inside]]
        two = np.einsum("nij,nj->ni", transform[:, :2], pixels[inside] - transform[:, 2])
        self.vertex_count = len(rest)
        self._inside = inside.reshape(size_px, size_px)
        self._corners = triangulation.simplices[simplex[inside]]
        self._weights = np.concatenate([two, 1.0 - two.sum(axis=1, keepdims=True)], axis=1)

    def raster(self, values: ArrayLike) -> FloatArray:
        """Return (size, size) values, interpolated from (V,) at the vertices; NaN off the skin."""
        image = np.full(self._inside.shape, np.nan)
        at_corners = np.asarray(values, dtype=np.float64)[self._corners]
        image[self._inside] = (at_corners * self._weights).sum(axis=1)
        return image


def skin_triangles(rest_m: ArrayLike) -> NDArray[np.int32]:
    """Return (T, 3) triangles between the vertices (V, 3) of a skin at rest, counter-clockwise seen
    from outside, for a skin of which nothing but its points is known.

    Raises:
        ValueError: fewer than 3 vertices, all on a line, or one that is not finite.
    """
    flat, triangulation = _triangulated(np.asarray(rest_m, dtype=np.float64))
    triangles = triangulation.simplices.astype(np.int32)
    first, second = (flat[triangles[:, corner]] - flat[triangles[:, 0]] for corner in (1, 2))
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    triangles[area < 0.0] = triangles[area < 0.0][:, ::-1]
    return triangles


def _triangulated(rest: FloatArray) -> tuple[FloatArray, Delaunay]:
    """Return the flattened skin (V, 2) and its triangulation."""
    if len(rest) < 3:
        raise ValueError(f"a skin of {len(rest)} points cannot be drawn")
    if not np.isfinite(rest).all():
        raise ValueError("the skin at rest holds a point that is not finite")
    flat = _flattened(rest)
    try:
        return flat, Delaunay(flat)
    except RuntimeError as error:
        raise ValueError("the skin's points lie on a line") from error


def _flattened(rest: FloatArray) -> FloatArray:
    radius = np.hypot(rest[:, 0], rest[:, 1])
    if np.ptp(rest[:, 2]) < FLAT_RATIO * radius.max():
        return rest[:, :2] - 0.5 * (rest[:, :2].min(axis=0) + rest[:, :2].max(axis=0))
    angle = np.arctan2(radius, rest[:, 2])
    scale = np.divide(angle, radius, out=np.ones_like(radius), where=radius > 1e-9)
    return rest[:, :2] * scale[:, None]
