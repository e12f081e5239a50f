# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The arrays of the explicit method, as its kernels take them: particles, grid nodes, the
indenter's motion in a frame."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
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


def new_particles(
    kernels: SimpleNamespace, shape: tuple[int, int], vertices: int, **where: Any
) -> Any:
    """Return `Particles` of a shape (E, P), with so many vertices of the skin."""
    return _zeros(kernels.Particles, shape, {"skin": (shape[0], vertices)}, **where)


def copy_particles(source: Any, target: Any) -> None:
    """Copy all arrays of `Particles`."""
    for name in ("position", "velocity", "affine", "deformation", "skin"):
        wp.copy(getattr(target, name), getattr(source, name))


def new_nodes(kernels: SimpleNamespace, shape: tuple[int, int], **where: Any) -> Any:
    """Return `Nodes` of a shape (E, N)."""
    return _zeros(kernels.Nodes, shape, {}, **where)


def clear(nodes: Any) -> None:
    """Zero what a substep adds to."""
    for array in (nodes.mass, nodes.momentum, nodes.area, nodes.wanted):
        array.zero_()


def new_motion(
    kernels: SimpleNamespace,
    start: Sequence[Pose],
    end: Sequence[Pose],
    count: int,
    substep_s: float,
    **where: Any,
) -> Any:
    """Return the indenter's `Motion` during a frame: equation 4, forward kinematics, for all
    substeps."""
    rows = np.zeros((count, len(start), 7))
    linear = np.zeros((count, len(start), 3))
    angular = np.zeros((count, len(start), 3))
    for e, (a, b) in enumerate(zip(start, end, strict=True)):
        linear[:, e] = (b.position_m - a.position_m) / (count * substep_s)
        angular[:, e] = rotation_vector(a, b) / (count * substep_s)
        for s in range(count):
            pose = interpolate(a, b, (s + 1) / count)
            rows[s, e] = [*pose.position_m, *pose.quaternion_xyzw]
    motion = _zeros(kernels.Motion, (count, len(start)), {}, **where)
    motion.pose.assign(rows)
    motion.linear.assign(linear)
    motion.angular.assign(angular)
    return motion


def _zeros(
    kind: Any, shape: tuple[int, int], shapes: dict[str, tuple[int, int]], **where: Any
) -> Any:
    """Return a struct of kernels whose arrays are zero, of a shape but for those that are named."""
    made = kind()
    for name, variable in kind.vars.items():
        array = wp.zeros(shapes.get(name, shape), dtype=variable.type.dtype, **where)
        setattr(made, name, array)
    return made
