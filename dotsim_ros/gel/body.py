"""The shapes a gel can have: where its material is, where it is bonded, where its skin lies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Body(Protocol):
    """What the discretisation asks of a shape; its base plane is z = 0 and always bonded."""

    def bounds_m(self) -> FloatArray:
        """Return the (2, 3) lower and upper corner of a box around the material."""

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return for points (..., 3) whether they lie in the material."""

    def bonded_surface(self, spacing_m: float) -> tuple[FloatArray, FloatArray]:
        """Return points (B, 3) on the bonded surface above the base, and their areas (B,)."""


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

    def bounds_m(self) -> FloatArray:
        r = self.outer_radius_m
        return np.array([[-r, -r, 0.0], [r, r, r]])

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        squared = np.sum(points_m**2, axis=-1)
        return np.asarray(
            (squared <= self.outer_radius_m**2)
            & (squared >= self.core_radius_m**2)
            & (points_m[..., 2] >= 0.0)
        )

    def bonded_surface(self, spacing_m: float) -> tuple[FloatArray, FloatArray]:
        if self.core_radius_m == 0.0:
            return np.zeros((0, 3)), np.zeros(0)
        area = 2.0 * np.pi * self.core_radius_m**2
        count = int(np.ceil(area / spacing_m**2))
        return fibonacci_hemisphere(self.core_radius_m, count), np.full(count, area / count)


@dataclass(frozen=True)
class Pad:
    """A flat block of gel on the base, centred on the z axis.

    Attributes:
        size_m: lengths along x and y, and the thickness along z.
    """

    size_m: tuple[float, float, float]

    def bounds_m(self) -> FloatArray:
        x, y, z = self.size_m
        return np.array([[-x / 2, -y / 2, 0.0], [x / 2, y / 2, z]])

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        lower, upper = self.bounds_m()
        return np.asarray(np.all((points_m >= lower) & (points_m <= upper), axis=-1))

    def bonded_surface(self, spacing_m: float) -> tuple[FloatArray, FloatArray]:
        return np.zeros((0, 3)), np.zeros(0)
