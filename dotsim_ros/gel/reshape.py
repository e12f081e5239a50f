# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shapes that follow smoothly from a reference shape, and how fast a shape's points move with them.

A gel of a slightly different radius, discretised again, has other particles: its response is no
smooth function of the radius. A reshaped body instead moves the particles, markers and bonded
points of its reference, so that the response is smooth and its derivatives exist. The grid stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.gel.body import Body, Dome, Pad
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class ReshapedDome(Dome):
    """A dome whose points are those of a reference dome, moved along the radius: linearly from the
    reference's core and outer radius to this one's.

    Attributes:
        reference: a dome; both have a core, or neither has.
    """

    reference: Dome

    def __post_init__(self) -> None:
        if (self.core_radius_m > 0.0) != (self.reference.core_radius_m > 0.0):
            raise ValueError(
                f"core radii are {self.core_radius_m} m and {self.reference.core_radius_m} m (of "
                "the reference), expected both zero or both positive"
            )

    def _radial_stretch(self) -> float:
        own = self.outer_radius_m - self.core_radius_m
        return own / (self.reference.outer_radius_m - self.reference.core_radius_m)

    def from_reference(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return where points (P, 3) of the reference are, and the ratios (P,) of their volumes
        and of their areas on a sphere."""
        radius = np.maximum(np.linalg.norm(points_m, axis=1), 1e-12)
        stretch = self._radial_stretch()
        moved = self.core_radius_m + (radius - self.reference.core_radius_m) * stretch
        ratio = moved / radius
        return points_m * ratio[:, None], ratio**2 * stretch, ratio**2


@dataclass(frozen=True)
class ReshapedPad(Pad):
    """A pad whose points are those of a reference pad, stretched along the axes.

    The curvature of its face is the reference's, and where the pad is told from the outside it is
    taken for that after the stretch, too.
    """

    reference: Pad

    def from_reference(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return where points (P, 3) of the reference are, and the ratios (P,) of their volumes
        and of their areas on a level plane."""
        x, y, z = np.divide(self.size_m, self.reference.size_m)
        ones = np.ones(len(points_m))
        return points_m * [x, y, z], x * y * z * ones, x * y * ones


@dataclass(frozen=True)
class ShapeRate:
    """How points of a shape move as one of its lengths grows.

    Attributes:
        velocity: (P, 3) metres per metre.
        volume: (P,) rates of the logarithm of the volume around them, 1/m.
        area: (P,) rates of the logarithm of the area around them on the free or bonded surface.
    """

    velocity: FloatArray
    volume: FloatArray
    area: FloatArray


def shape_rates(body: Body, points_m: FloatArray) -> dict[str, ShapeRate]:
    """Return the rates of points (P, 3) of a dome or pad by its lengths, as a reshaped body moves.

    The names are `outer_radius_m` and, with a core, `core_radius_m` of a dome; `size_x_m`,
    `size_y_m` and `thickness_m` of a pad; other bodies have none.
    """
    if isinstance(body, Dome):
        return _dome_rates(body, points_m)
    if isinstance(body, Pad):
        return _pad_rates(body, points_m)
    return {}


def _dome_rates(dome: Dome, points_m: FloatArray) -> dict[str, ShapeRate]:
    radius = np.maximum(np.linalg.norm(points_m, axis=1), 1e-12)
    thickness = dome.outer_radius_m - dome.core_radius_m
    shares = {"outer_radius_m": ((radius - dome.core_radius_m) / thickness, 1.0 / thickness)}
    if dome.core_radius_m > 0.0:
        shares["core_radius_m"] = ((dome.outer_radius_m - radius) / thickness, -1.0 / thickness)
    return {
        name: ShapeRate(
            points_m * (share / radius)[:, None], 2.0 * share / radius + along, 2.0 * share / radius
        )
        for name, (share, along) in shares.items()
    }


def _pad_rates(pad: Pad, points_m: FloatArray) -> dict[str, ShapeRate]:
    rates = {}
    for axis, name in enumerate(("size_x_m", "size_y_m", "thickness_m")):
        rate = 1.0 / pad.size_m[axis]
        velocity = np.zeros_like(points_m)
        velocity[:, axis] = points_m[:, axis] * rate
        uniform = np.full(len(points_m), rate)
        rates[name] = ShapeRate(velocity, uniform, uniform if axis < 2 else np.zeros_like(uniform))
    return rates
