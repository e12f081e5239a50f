# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The shapes a gel can have: where its material is, where it is bonded, where its skin lies."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import face_drop_m


class Body(Protocol):
    """What the discretisation asks of a shape; its base plane is z = 0 and always bonded."""

    @property
    def symmetries(self) -> FloatArray:
        """Return (S, 3, 3) maps of the grid onto itself that leave the shape as it is."""

    def bounds_m(self) -> FloatArray:
        """Return the (2, 3) lower and upper corner of a box around the material."""

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return for points (..., 3) whether they lie in the material."""

    def bonded_surface(self, spacing_m: float) -> tuple[FloatArray, FloatArray]:
        """Return points (B, 3) on the bonded surface above the base, and their areas (B,)."""


QUARTER_TURNS_AND_MIRRORS = np.array(
    [
        [[sx, 0, 0], [0, sy, 0], [0, 0, 1]] if straight else [[0, sx, 0], [sy, 0, 0], [0, 0, 1]]
        for straight in (True, False)
        for sx in (1, -1)
        for sy in (1, -1)
    ],
    dtype=float,
)
"""(8, 3, 3) the symmetries about the z axis that map the grid onto itself."""


def fibonacci_hemisphere(radius_m: float, count: int) -> FloatArray:
    """Return (count, 3) points spread evenly over the upper hemisphere (golden-angle spiral)."""
    index = np.arange(count)
    height = 1.0 - (index + 0.5) / count
    ring = np.sqrt(1.0 - height**2)
    angle = np.pi * (3.0 - np.sqrt(5.0)) * index
    return radius_m * np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=-1)


@dataclass(frozen=True)
class Dome:
    """A hemisphere of gel around a rigid, bonded core of the same centre.

    Attributes:
        outer_radius_m: radius of the free surface.
        core_radius_m: radius of the bonded lens core; 0 for none.
    """

    outer_radius_m: float
    core_radius_m: float

    @property
    def symmetries(self) -> FloatArray:
        return QUARTER_TURNS_AND_MIRRORS

    def bounds_m(self) -> FloatArray:
        r = self.outer_radius_m
        return np.array([[-r, -r, 0.0], [r, r, r]])

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        x, y, z = np.moveaxis(points_m, -1, 0)
        squared = x * x + y * y + z * z
        return np.asarray(
            (squared <= self.outer_radius_m**2) & (squared >= self.core_radius_m**2) & (z >= 0.0)
        )

    def bonded_surface(self, spacing_m: float) -> tuple[FloatArray, FloatArray]:
        if self.core_radius_m == 0.0:
            return np.zeros((0, 3)), np.zeros(0)
        area = 2.0 * np.pi * self.core_radius_m**2
        spread = fibonacci_hemisphere(self.core_radius_m, int(np.ceil(area / spacing_m**2)))
        # All images of the points, so that the grid's stiffness keeps the symmetry of its axes.
        points = np.concatenate([spread @ image.T for image in QUARTER_TURNS_AND_MIRRORS])
        return points, np.full(len(points), area / len(points))


@dataclass(frozen=True)
class Pad:
    """A block of gel on the base, centred on the z axis, with a flat or a curved upper face.

    Attributes:
        size_m: lengths along x and y, and the thickness along z in the middle.
        curvature_per_m: of the upper face along x and y.
    """

    size_m: tuple[float, float, float]
    curvature_per_m: tuple[float, float] = field(default=(0.0, 0.0), kw_only=True)

    @property
    def symmetries(self) -> FloatArray:
        along_x, along_y = zip(self.size_m[:2], self.curvature_per_m, strict=True)
        square = along_x == along_y
        return QUARTER_TURNS_AND_MIRRORS if square else QUARTER_TURNS_AND_MIRRORS[:4]

    def bounds_m(self) -> FloatArray:
        x, y, z = self.size_m
        return np.array([[-x / 2, -y / 2, 0.0], [x / 2, y / 2, z]])

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        lower, upper = self.bounds_m()
        inside = np.all((points_m >= lower) & (points_m <= upper), axis=-1)
        if any(self.curvature_per_m):
            drop = face_drop_m(points_m[..., 0], points_m[..., 1], self.curvature_per_m)
            inside &= points_m[..., 2] <= self.size_m[2] - drop
        return np.asarray(inside)

    def bonded_surface(self, spacing_m: float) -> tuple[FloatArray, FloatArray]:
        return np.zeros((0, 3)), np.zeros(0)
