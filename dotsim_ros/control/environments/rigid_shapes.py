# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The shapes of rigid bodies of a simulator, as indenters.

Each shape comes with the indenter's frame in the frame of the shape, which has its origin in the
middle; a cylinder and a capsule lie along z.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.geometry.closed_mesh import IndenterMesh, closed_surface
from dotsim_ros.geometry.indenter import (
    Indenter,
    IndenterKind,
    box,
    capsule,
    flat_punch,
    sphere,
)
from dotsim_ros.geometry.pose import Pose, compose, inverse
from dotsim_ros.io.arrays import FloatArray

EDGE_SHARE = 0.03
"""Edges of a box or cylinder are rounded by this share of its smallest half extent: a simulator's
are sharp, and a perfectly sharp edge would cut between the skin's markers."""
_HALF_TURN = np.sqrt(0.5)

Placed = tuple[Indenter, Pose]


def middle_sphere(radius_m: float) -> Placed:
    """Return a sphere."""
    return sphere(radius_m), Pose(np.array([0.0, 0.0, -radius_m]))


def middle_box(half_size_m: ArrayLike) -> Placed:
    """Return a box of three half extents."""
    half = np.array(half_size_m, dtype=np.float64)
    shape = box(2.0 * half, EDGE_SHARE * float(half.min()))
    return shape, Pose(np.array([0.0, 0.0, -half[2]]))


def middle_cylinder(radius_m: float, half_length_m: float) -> Placed:
    """Return a cylinder."""
    edge_m = EDGE_SHARE * min(radius_m, half_length_m)
    return (
        flat_punch(radius_m, 2.0 * half_length_m, edge_m),
        Pose(np.array([0.0, 0.0, -half_length_m])),
    )


def middle_capsule(radius_m: float, half_length_m: float) -> Placed:
    """Return a capsule; its length is that between the middles of its ends."""
    # Ours lies along y, with its axis a radius above the tip.
    lying = Pose(np.zeros(3), np.array([_HALF_TURN, 0.0, 0.0, _HALF_TURN]))
    offset = Pose(np.array([0.0, 0.0, -radius_m]))
    return capsule(radius_m, 2.0 * half_length_m), compose(lying, offset)


def closed_mesh(vertices_m: ArrayLike, triangles: ArrayLike, name: str) -> Placed:
    """Return a mesh, (V, 3) and (T, 3).

    Raises:
        ValueError: it has holes.
    """
    surface = closed_surface(np.asarray(vertices_m), np.asarray(triangles), name)
    return Indenter(IndenterKind.MESH, (), mesh=IndenterMesh(*surface)), Pose()


def facing(placed: Placed, away: FloatArray, name: str) -> Placed:
    """Return a shape with a frame whose +z is `away`, and that frame in the body's.

    Args:
        placed: a shape and its frame in the body's frame.
        away: (3,) direction in the body's frame in which the gel lies behind the surface: +z of an
            indenter's frame, along which it comes to its first pose.
        name: of the indenter.
    """
    shape, frame = placed
    turned = Pose(np.zeros(3), _turn_z_to(away))
    mount = compose(inverse(turned), frame)
    if shape.mesh is not None:
        mesh = IndenterMesh(mount.apply(shape.mesh.vertices_m), shape.mesh.triangles)
        return Indenter(IndenterKind.MESH, (), mesh=mesh, name=name), turned
    return replace(shape, mount=compose(mount, shape.mount), name=name), turned


def _turn_z_to(direction: FloatArray) -> FloatArray:
    """Return the quaternion (4,) of the least rotation that takes z to a direction (3,)."""
    x, y, z = np.asarray(direction) / np.linalg.norm(direction)
    if z < -1.0 + 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0])
    quaternion = np.array([-y, x, 0.0, 1.0 + z])
    result: FloatArray = quaternion / np.linalg.norm(quaternion)
    return result
