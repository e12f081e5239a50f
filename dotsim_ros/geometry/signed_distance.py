# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Signed distances of closed triangle meshes, and signed distance on a grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dotsim_ros.io.arrays import FloatArray

MAXIMUM_NODE_COUNT = 20_000_000
# Far from the surface a distance is needed only to know that it is far: there every fourth node is
# evaluated and the rest interpolated, which makes a mesh's grid some thirty times cheaper.
COARSENING = 4
FINE_BAND_NODES = 6.0


@dataclass(frozen=True, eq=False)
class SignedDistanceGrid:
    """A signed distance as a quadratic B-spline: value and gradient are continuous (C1).

    Attributes:
        origin_m: (3,) position of node (0, 0, 0), in the indenter's frame.
        spacing_m: distance between neighbouring nodes, the same along each axis.
        coefficients: (nx, ny, nz) float32, metres: spline coefficients, not nodal values.
    """

    origin_m: FloatArray
    spacing_m: float
    coefficients: NDArray[np.float32]


def sample_on_grid(
    distance: Callable[[FloatArray], FloatArray],
    bounds_m: FloatArray,
    *,
    spacing_m: float,
    margin_m: float,
) -> SignedDistanceGrid:
    """Sample a signed distance function on a grid around a box.

    Args:
        distance: maps points (N, 3) to signed distances (N,), metres.
        bounds_m: (2, 3) lower and upper corner of the body.
        spacing_m: distance between nodes.
        margin_m: how far the grid reaches beyond the body.

    Within six nodes of the surface every node is evaluated; farther away the error stays
    below a fifth of the distance.

    Raises:
        ValueError: the spacing is not positive, or the grid would have too many nodes.
    """
    if not (np.isfinite(spacing_m) and spacing_m > 0.0):
        raise ValueError(f"spacing_m must be a positive length, got {spacing_m}")
    # The spline is evaluated half a cell away from the outermost nodes.
    lower = np.asarray(bounds_m[0]) - margin_m - spacing_m
    upper = np.asarray(bounds_m[1]) + margin_m + spacing_m
    count = np.ceil((upper - lower) / spacing_m).astype(np.int64) + 1
    if np.prod(count) > MAXIMUM_NODE_COUNT:
        raise ValueError(
            f"a distance grid of {count.tolist()} nodes is too large "
            f"(at most {MAXIMUM_NODE_COUNT}); choose a spacing above {spacing_m} m"
        )
    coarse_count = -(-(count - 1) // COARSENING) + 1
    coarse = distance(_nodes(lower, COARSENING * spacing_m, coarse_count)).reshape(coarse_count)
    fine_index = [np.arange(count[axis]) / COARSENING for axis in range(3)]
    values = ndimage.map_coordinates(
        coarse, np.meshgrid(*fine_index, indexing="ij"), order=2, mode="mirror"
    )
    near = np.nonzero((np.abs(values) < FINE_BAND_NODES * spacing_m).reshape(-1))[0]
    values.reshape(-1)[near] = distance(_nodes(lower, spacing_m, count)[near])
    coefficients = ndimage.spline_filter(values, order=2).astype(np.float32)
    return SignedDistanceGrid(lower, float(spacing_m), np.ascontiguousarray(coefficients))


def _nodes(lower: FloatArray, spacing: float, count: NDArray[np.int64]) -> FloatArray:
    axes = [lower[axis] + spacing * np.arange(count[axis]) for axis in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
