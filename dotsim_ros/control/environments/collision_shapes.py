# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Collision shapes of SAPIEN's bodies, as ManiSkill holds them, as indenters."""

from __future__ import annotations

import numpy as np
from mani_skill.utils.structs import Actor, Link
from sapien import physx

from dotsim_ros.control.environments.rigid_shapes import (
    Placed,
    closed_mesh,
    facing,
    middle_box,
    middle_capsule,
    middle_cylinder,
    middle_sphere,
)
from dotsim_ros.geometry.pose import Pose, compose
from dotsim_ros.io.arrays import FloatArray

ALONG_X = Pose(np.zeros(3), np.sqrt([0.0, 0.5, 0.0, 0.5]))
"""SAPIEN's cylinders and capsules lie along x."""


def indenter_of(body: Actor | Link, away: FloatArray) -> Placed:
    """Return a body's first collision shape as an indenter, and the indenter's frame in the body's.

    Args:
        away: (3,) in the body's frame, as for `facing`.

    Raises:
        ValueError: there is none, or one that has no inside.
    """
    shapes = body._bodies[0].collision_shapes
    along_z = Pose()
    match shapes[0] if shapes else None:
        case physx.PhysxCollisionShapeSphere() as shape:
            found = middle_sphere(shape.radius)
        case physx.PhysxCollisionShapeBox() as shape:
            found = middle_box(shape.half_size)
        case physx.PhysxCollisionShapeCylinder() as shape:
            found, along_z = middle_cylinder(shape.radius, shape.half_length), ALONG_X
        case physx.PhysxCollisionShapeCapsule() as shape:
            found, along_z = middle_capsule(shape.radius, shape.half_length), ALONG_X
        case (
            physx.PhysxCollisionShapeConvexMesh() | physx.PhysxCollisionShapeTriangleMesh()
        ) as shape:
            corners = shape.vertices * shape.scale
            found = closed_mesh(corners, shape.get_triangles(), f"the mesh of {body.name}")
        case other:
            kind = "no collision shape" if other is None else type(other).__name__
            raise ValueError(
                f"{body.name} has {kind}, expected a sphere, box, cylinder, capsule or closed mesh "
                "to press the gel with"
            )
    local = shape.local_pose
    at = Pose(np.array(local.p, dtype=np.float64), np.roll(local.q, -1).astype(np.float64))
    return facing((found[0], compose(compose(at, along_z), found[1])), away, body.name)
