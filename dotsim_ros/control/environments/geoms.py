# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Geoms of a MuJoCo model as indenters."""

from __future__ import annotations

import mujoco
import numpy as np

from dotsim_ros.control.environments.rigid_shapes import (
    Placed,
    closed_mesh,
    facing,
    middle_box,
    middle_capsule,
    middle_cylinder,
    middle_sphere,
)
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray


def pose_of(position_m: FloatArray, rotation: FloatArray) -> Pose:
    """Return the pose of a frame whose axes are the columns of a rotation matrix, (3, 3) or flat,
    as MuJoCo keeps them."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.asarray(rotation, dtype=np.float64).ravel())
    return Pose(np.array(position_m, dtype=np.float64), np.roll(quaternion, -1))


def indenter_of(model: mujoco.MjModel, geom: int, away: FloatArray) -> Placed:
    """Return a geom as an indenter, and the indenter's frame in the geom's.

    Args:
        away: (3,) in the geom's frame, as for `facing`.

    Raises:
        ValueError: a geom that has no inside, such as a plane, a height field or a mesh with holes.
    """
    return facing(_shape_of(model, geom), away, model.geom(geom).name or f"geom {geom}")


def _shape_of(model: mujoco.MjModel, geom: int) -> Placed:
    """Return a geom's shape, and the frame of that indenter in the geom's."""
    size = np.array(model.geom_size[geom], dtype=np.float64)
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    match kind:
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return middle_sphere(size[0])
        case mujoco.mjtGeom.mjGEOM_BOX:
            return middle_box(size)
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return middle_cylinder(size[0], size[1])
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            return middle_capsule(size[0], size[1])
        case mujoco.mjtGeom.mjGEOM_MESH:
            return _mesh_of(model, int(model.geom_dataid[geom]))
    raise ValueError(
        f"geom {model.geom(geom).name or geom} is a {kind.name.removeprefix('mjGEOM_').lower()}, "
        "expected a sphere, box, cylinder, capsule or closed mesh to press the gel with"
    )


def _mesh_of(model: mujoco.MjModel, mesh: int) -> Placed:
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    begin, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return closed_mesh(
        model.mesh_vert[first : first + count],
        model.mesh_face[begin : begin + faces],
        f"mesh {model.mesh(mesh).name!r} of the model",
    )
