# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A soft layer of even top, bonded to a rigid insert whose face is flat, bulged or dented.

The layer's grid is that of a flat pad, fitted to the insert: a reference point (x, y, s) lies at
(x, y, h + s (t - h) / T), with h the insert's height there, t the layer's thickness over the flat
part and T the thickness of the pad. The bond is exact, since the displacement vanishes on the pad's
base, whatever the insert's shape; the same nodes serve every insert.

The layer's frame: z = 0 is the insert's flat face, +z leads out of the layer, towards the gel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dotsim_ros.gel.body import Pad
from dotsim_ros.gel.discretization import (
    Discretization,
    Interpolation,
    discretize,
    interpolation_at,
)
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.io.arrays import FloatArray

LEAST_SHARE = 0.2
"""Of the layer's thickness that an insert must leave over its bulge."""


@dataclass(frozen=True)
class Insert:
    """A rigid face with one round bulge or dent, (1 - r^2 / R^2)^2 high within a radius.

    Attributes:
        height_m: of the bulge; negative for a dent, 0 for a flat face.
        radius_m: where it ends, R.
        centre_m: of it, (x, y) in the layer's frame.

    Raises:
        ValueError: a radius that is not positive.
    """

    height_m: float = 0.0
    radius_m: float = 5.0e-3
    centre_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not self.radius_m > 0.0:
            raise ValueError(f"the insert's radius is {self.radius_m} m, expected a positive one")

    def heights_m(self, points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the height (P,) and its slope (P, 2) at points (P, 2) of the face."""
        offset = points_m - np.asarray(self.centre_m)
        left = np.maximum(0.0, 1.0 - np.sum(offset**2, axis=1) / self.radius_m**2)
        slope = (-4.0 * self.height_m / self.radius_m**2) * left[:, None] * offset
        return self.height_m * left**2, slope


@dataclass(frozen=True)
class LayerSpecification:
    """A layer, and its resolution.

    Attributes:
        thickness_m: over the insert's flat part.
        youngs_modulus_pa, poisson_ratio: of its neo-Hookean material.
        side_m: length of its two sides, centred on the frame's z axis.
        spacing_m: of the grid along the sides, which it divides.
        cells: of the grid through the thickness.

    Raises:
        ValueError: a length or a count that is not positive, or a spacing that does not divide
            the sides.
    """

    thickness_m: float
    youngs_modulus_pa: float
    poisson_ratio: float = 0.3
    side_m: float = 24.0e-3
    spacing_m: float = 2.0e-3
    cells: int = 3

    def __post_init__(self) -> None:
        if not (min(self.thickness_m, self.side_m, self.spacing_m) > 0.0 and self.cells >= 2):
            raise ValueError(
                f"a layer of {self.side_m} m, {self.thickness_m} m thick, on a grid of "
                f"{self.spacing_m} m with {self.cells} cells through it: expected positive lengths "
                "and two cells at least"
            )
        count = self.side_m / self.spacing_m
        if abs(count - round(count)) > 1e-6:
            raise ValueError(
                f"the layer's sides of {self.side_m} m are {count:.4g} times its grid spacing of "
                f"{self.spacing_m} m, expected a whole number"
            )


@dataclass(frozen=True)
class SurfacePoints:
    """Points on the layer's top, as parameters of the surface give them.

    Attributes:
        interpolation: weights of the layer's nodes, (P, 27).
        position_m: (P, 3) in the layer's frame.
        tangent: (P, 3, 2) derivatives of the position by the parameters x and y.
        curvature: (P, 3, 2, 2) its second derivatives, 1/m.
    """

    interpolation: Interpolation
    position_m: FloatArray
    tangent: FloatArray
    curvature: FloatArray


class SoftLayer:
    """The layer's elastic body on its fitted grid, and its top as a smooth surface.

    Args:
        specification: size, material and resolution.
        insert: what lies below it.

    Attributes:
        specification, insert: as given.
        body: energy, forces and stiffness; its displacements are in the layer's frame.

    Raises:
        ValueError: the insert leaves too little of the layer.
    """

    def __init__(self, specification: LayerSpecification, insert: Insert) -> None:
        s = specification
        if insert.height_m > (1.0 - LEAST_SHARE) * s.thickness_m:
            raise ValueError(
                f"the insert's bulge of {insert.height_m} m leaves less than {LEAST_SHARE:.0%} of "
                f"the layer of {s.thickness_m} m; take a thicker layer or a lower bulge"
            )
        self.specification, self.insert = specification, insert
        self._reference_m = s.cells * s.spacing_m
        pad = Pad((s.side_m, s.side_m, self._reference_m))
        # The grid needs no marker: the top is evaluated wherever it is touched.
        flat = discretize(pad, np.zeros((0, 3)), s.spacing_m)
        self.body = ElasticBody(
            self._fitted(flat), NeoHookean(s.youngs_modulus_pa, s.poisson_ratio)
        )

    @property
    def node_count(self) -> int:
        return self.body.discretization.node_count

    def _fitted(self, flat: Discretization) -> Discretization:
        """Return the pad's particles and weights, mapped onto the layer.

        Grid coordinates stay those of the pad, by which particles are grouped into cells.
        """
        at = flat.particle_position_m
        height, slope = self.insert.heights_m(at[:, :2])
        stretch = (self.specification.thickness_m - height) / self._reference_m
        lean = slope * (1.0 - at[:, 2:] / self._reference_m)
        # The transposed inverse of the map's gradient [1 0 0; 0 1 0; lean, stretch].
        gradient = flat.particle_weight_gradient.copy()
        gradient[..., 2] /= stretch[:, None]
        gradient[..., :2] -= gradient[..., 2:] * lean[:, None]
        return replace(
            flat,
            particle_volume_m3=flat.particle_volume_m3 * stretch,
            particle_weight_gradient=gradient,
        )

    def surface(self, parameters_m: FloatArray, displacement_m: FloatArray) -> SurfacePoints:
        """Return points of the deformed top.

        Args:
            parameters_m: (P, 2) x and y of the points at rest.
            displacement_m: (N, 3) of the layer's nodes.
        """
        top = np.full((len(parameters_m), 1), self._reference_m * (1.0 - 1e-9))
        at = np.concatenate([parameters_m, top], axis=1)
        interpolation, gradient, bend = interpolation_at(self.body.discretization, at)
        moved = displacement_m[interpolation.node_index]
        position = np.einsum("pa,pax->px", interpolation.weight, moved)
        position[:, :2] += parameters_m
        position[:, 2] += self.specification.thickness_m
        tangent = np.einsum("pak,pax->pxk", gradient[..., :2], moved)
        tangent[:, :2] += np.eye(2)
        curvature = np.einsum("pakl,pax->pxkl", bend[..., :2, :2], moved)
        return SurfacePoints(interpolation, position, tangent, curvature)
