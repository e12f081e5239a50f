# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bodies, gels and presses that several tests of the implicit gel share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dotsim_ros.gel.body import Dome, Pad
from dotsim_ros.gel.implicit.gel import GelState, ImplicitGel
from dotsim_ros.gel.material import (
    ElasticLaw,
    Material,
    MooneyRivlin,
    NeoHookean,
    PronySeries,
    Yeoh,
)
from dotsim_ros.geometry.indenter import Indenter, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin, flat_pad_skin
from dotsim_ros.specification import ContactSpecification, SolverSpecification

FloatArray = NDArray[np.float64]

YOUNGS_PA = 1.0e5
LAWS: dict[str, ElasticLaw] = {
    "neo_hookean": NeoHookean(YOUNGS_PA, 0.45),
    "mooney_rivlin": MooneyRivlin(12.0e3, 6.0e3, 4.0e5),
    "yeoh": Yeoh(18.0e3, 2.0e3, 0.5e3, 4.0e5),
}
FRICTIONLESS = ContactSpecification(friction_coefficient=0.0)


@dataclass(frozen=True)
class FloatingBlock:
    """A block so far above the base that no spline of its grid is mirrored there."""

    lower_m: tuple[float, float, float]
    upper_m: tuple[float, float, float]

    @property
    def symmetries(self) -> FloatArray:
        return np.eye(3)[None]

    def bounds_m(self) -> FloatArray:
        return np.array([self.lower_m, self.upper_m])

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        return np.asarray(np.all((points_m >= self.lower_m) & (points_m <= self.upper_m), axis=-1))

    def bonded_surface(self, spacing_m: float) -> tuple[FloatArray, FloatArray]:
        return np.zeros((0, 3)), np.zeros(0)


@dataclass(frozen=True)
class FloatingBall:
    """A ball above the base; the grid cuts its cells in all ways."""

    centre_m: tuple[float, float, float]
    radius_m: float

    @property
    def symmetries(self) -> FloatArray:
        return np.eye(3)[None]

    def bounds_m(self) -> FloatArray:
        return np.array(self.centre_m) + self.radius_m * np.array([[-1.0] * 3, [1.0] * 3])

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        return np.asarray(np.sum((points_m - self.centre_m) ** 2, axis=-1) <= self.radius_m**2)

    def bonded_surface(self, spacing_m: float) -> tuple[FloatArray, FloatArray]:
        return np.zeros((0, 3)), np.zeros(0)


BALL = FloatingBall((0.3e-3, -0.4e-3, 24.0e-3), 8.1e-3)
BLOCK = FloatingBlock((-4.8e-3, -4.8e-3, 9.6e-3), (4.8e-3, 4.8e-3, 19.2e-3))
PAD_SIZE_M = (24.0e-3, 24.0e-3, 12.0e-3)
PAD_TOP_M = PAD_SIZE_M[2]
DOME = Dome(15.75e-3, 6.0e-3)
DOME_TOP_M = DOME.outer_radius_m


def pad_skin(
    spacing_m: float = 0.8e-3, size_m: tuple[float, float, float] = PAD_SIZE_M
) -> SkinMesh:
    return flat_pad_skin(size_m[:2], size_m[2], spacing_m)


def pad_gel(**changes: Any) -> ImplicitGel:
    """Return a small pad on a coarse grid without refinement, under a large frictionless ball."""
    solver: dict[str, Any] = {"grid_spacing_m": 3.0e-3, "refined": False, "tolerance_m": 1.0e-7}
    solver |= changes.pop("solver", {})
    material = Material(
        changes.pop("law", LAWS["neo_hookean"]), changes.pop("prony", PronySeries())
    )
    arguments: dict[str, Any] = {
        "contact": FRICTIONLESS,
        "indenter": sphere(10.0e-3),
        "solver": SolverSpecification(**{"friction_passes": 100, **solver}),
    }
    size_m = changes.pop("size_m", PAD_SIZE_M)
    skin = changes.pop("skin", None) or pad_skin(size_m=size_m)
    return ImplicitGel(Pad(size_m), skin, material, **(arguments | changes))


def dome_gel(indenter: Indenter, **changes: Any) -> ImplicitGel:
    """Return the sensor's dome on a coarse grid without refinement."""
    solver: dict[str, Any] = {"grid_spacing_m": 3.6e-3, "refined": False, "iterations": 25}
    solver |= changes.pop("solver", {})
    material = Material(changes.pop("law", NeoHookean(3.0e5, 0.48)))
    arguments: dict[str, Any] = {
        "contact": ContactSpecification(),
        "indenter": indenter,
        "solver": SolverSpecification(**{"friction_passes": 100, **solver}),
    }
    return ImplicitGel(
        DOME, dome_skin(DOME.outer_radius_m, 1.0e-3), material, **arguments | changes
    )


def at(x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0) -> Pose:
    return Pose(np.array([x_m, y_m, z_m]))


def pressed(depth_m: float, x_m: float = 0.0, y_m: float = 0.0) -> Pose:
    """Return the pose whose tip is `depth_m` below the pad's upper face."""
    return at(x_m, y_m, PAD_TOP_M - depth_m)


def towards_centre(direction: ArrayLike, depth_m: float) -> Pose:
    """Return the pose of an indenter that presses the dome radially along -direction."""
    axis = np.asarray(direction, dtype=float)
    axis = axis / np.linalg.norm(axis)
    # The rotation that turns +z the shortest way onto the axis.
    quaternion = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    return Pose(axis * (DOME_TOP_M - depth_m), quaternion / np.linalg.norm(quaternion))


def one(gel: ImplicitGel, pose: Pose | None, dt_s: float = 0.04) -> GelState:
    """Return the state of a single environment after a step."""
    return gel.step([pose], dt_s)[0]
