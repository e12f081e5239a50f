# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The arrays of the explicit method: particles, grid nodes, the indenter's motion in a frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.warp_runtime import wp


def rotation_vector(start: Pose, end: Pose) -> FloatArray:
    """Return the axis times the angle (3,) of the rotation from one pose to another."""
    x, y, z, w = start.quaternion_xyzw
    a, b, c, d = end.quaternion_xyzw
    scalar = d * w + a * x + b * y + c * z
    vector = np.array(
        [
            a * w - d * x - b * z + c * y,
            b * w - d * y - c * x + a * z,
            c * w - d * z - a * y + b * x,
        ]
    )
    if scalar < 0.0:
        scalar, vector = -scalar, -vector
    sine = float(np.linalg.norm(vector))
    if sine < 1e-12:
        return np.zeros(3)
    return vector * (2.0 * np.arctan2(sine, scalar) / sine)


class ParticleState:
    """Particles and skin between two substeps."""

    def __init__(self, shape: tuple[int, int], vertices: int, scalar: Any, **where: Any) -> None:
        vec3 = wp.types.vector(3, scalar)
        mat33 = wp.types.matrix((3, 3), scalar)
        self.position: Any = wp.zeros(shape, dtype=vec3, **where)
        self.velocity: Any = wp.zeros(shape, dtype=vec3, **where)
        self.affine: Any = wp.zeros(shape, dtype=mat33, **where)
        self.deformation: Any = wp.zeros(shape, dtype=mat33, **where)
        self.skin: Any = wp.zeros((shape[0], vertices), dtype=vec3, **where)

    def arrays(self) -> tuple[Any, ...]:
        return self.position, self.velocity, self.affine, self.deformation, self.skin

    def assign(self, other: ParticleState) -> None:
        for own, source in zip(self.arrays(), other.arrays(), strict=True):
            wp.copy(own, source)


class GridState:
    """Nodes during one substep."""

    def __init__(self, shape: tuple[int, int], scalar: Any, **where: Any) -> None:
        vec3 = wp.types.vector(3, scalar)
        self.mass: Any = wp.zeros(shape, dtype=scalar, **where)
        self.momentum: Any = wp.zeros(shape, dtype=vec3, **where)
        self.area: Any = wp.zeros(shape, dtype=scalar, **where)
        self.wanted: Any = wp.zeros(shape, dtype=vec3, **where)
        self.free_velocity: Any = wp.zeros(shape, dtype=vec3, **where)
        self.velocity: Any = wp.zeros(shape, dtype=vec3, **where)

    def clear(self) -> None:
        for array in (self.mass, self.momentum, self.area, self.wanted):
            array.zero_()


class IndenterMotion:
    """The indenter during a frame: equation 4, forward kinematics, for all substeps."""

    def __init__(
        self,
        start: Sequence[Pose],
        end: Sequence[Pose],
        count: int,
        substep_s: float,
        scalar: Any,
        **where: Any,
    ) -> None:
        rows = np.zeros((count, len(start), 7))
        linear = np.zeros((count, len(start), 3))
        angular = np.zeros((count, len(start), 3))
        for e, (a, b) in enumerate(zip(start, end, strict=True)):
            linear[:, e] = (b.position_m - a.position_m) / (count * substep_s)
            angular[:, e] = rotation_vector(a, b) / (count * substep_s)
            for s in range(count):
                pose = interpolate(a, b, (s + 1) / count)
                rows[s, e] = [*pose.position_m, *pose.quaternion_xyzw]
        vec3 = wp.types.vector(3, scalar)
        self.pose: Any = wp.array(rows, dtype=wp.types.transformation(scalar), **where)
        self.linear: Any = wp.array(linear, dtype=vec3, **where)
        self.angular: Any = wp.array(angular, dtype=vec3, **where)
        self.force: Any = wp.zeros((count, len(start)), dtype=vec3, **where)
        self.torque: Any = wp.zeros((count, len(start)), dtype=vec3, **where)
