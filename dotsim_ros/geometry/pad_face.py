# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The upper face of a pad: where rays from behind meet it, and how it is turned."""

from __future__ import annotations

import numpy as np

from dotsim_ros.io.arrays import BoolArray, FloatArray
from dotsim_ros.specification import face_drop_m

ROUNDS = 30
"""Of Newton's method along a ray: a face is flat next to the distance of its camera."""
MISSED_M = 1e-9


def face_normal(
    x_m: FloatArray, y_m: FloatArray, curvature_per_m: tuple[float, float]
) -> FloatArray:
    """Return the unit normals (..., 3) out of a pad at places (...,) of its face.

    Args:
        x_m, y_m: places, base frame.
        curvature_per_m: of the face along x and y.
    """
    slope_x, slope_y = _slopes(x_m, y_m, curvature_per_m)
    normal = np.stack([slope_x, slope_y, np.ones_like(slope_x)], axis=-1)
    return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def _slopes(
    x_m: FloatArray, y_m: FloatArray, curvature_per_m: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return how steeply the face drops along x and y: the derivatives of `face_drop_m`."""
    along_x, along_y = curvature_per_m
    numerator = along_x * x_m**2 + along_y * y_m**2
    root = np.sqrt(1.0 - (along_x * x_m) ** 2 - (along_y * y_m) ** 2)
    # (N / (1 + D))' = N' / (1 + D) - N D' / (1 + D)^2, with D' = -k^2 x / D.
    by_x, by_y = (
        2.0 * k * at / (1.0 + root) + numerator * k**2 * at / (root * (1.0 + root) ** 2)
        for k, at in ((along_x, x_m), (along_y, y_m))
    )
    return by_x, by_y


def meet_face(
    origin_m: FloatArray,
    rays: FloatArray,
    size_m: tuple[float, float, float],
    curvature_per_m: tuple[float, float],
) -> tuple[FloatArray, BoolArray]:
    """Return where rays from behind a pad meet its upper face (..., 3), and which (...,) do.

    Args:
        origin_m: (3,) of all rays, base frame.
        rays: (..., 3) directions, base frame.
        size_m: the pad's lengths along x and y, and its thickness in the middle.
        curvature_per_m: of the face along x and y.
    """
    width, depth, thickness = size_m
    # A ray along the face or from it has no such place, and so has one that leaves the face's arc.
    with np.errstate(divide="ignore", invalid="ignore"):
        way = (thickness - origin_m[2]) / rays[..., 2]
        points = origin_m + way[..., None] * rays
        missed = np.zeros_like(way)
        if any(curvature_per_m):
            for _ in range(ROUNDS):
                x, y = points[..., 0], points[..., 1]
                missed = points[..., 2] - thickness + face_drop_m(x, y, curvature_per_m)
                slope_x, slope_y = _slopes(x, y, curvature_per_m)
                rate = rays[..., 2] + slope_x * rays[..., 0] + slope_y * rays[..., 1]
                way = way - missed / rate
                points = origin_m + way[..., None] * rays
        inside = (np.abs(points[..., 0]) <= 0.5 * width) & (np.abs(points[..., 1]) <= 0.5 * depth)
        return points, inside & (way > 0.0) & (np.abs(missed) < MISSED_M)
