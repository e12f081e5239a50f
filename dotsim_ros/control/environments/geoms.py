# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Geoms of a MuJoCo model as indenters."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

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
"""Edges of a box or cylinder are rounded by this share of its smallest half extent: MuJoCo's are
sharp, and a perfectly sharp edge would cut between the skin's markers."""
_HALF_TURN = np.sqrt(0.5)


def pose_of(position_m: FloatArray, rotation: FloatArray) -> Pose:
    """Return the pose of a frame whose axes are the columns of a rotation matrix, (3, 3) or flat,
    as MuJoCo keeps them."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.asarray(rotation, dtype=np.float64).ravel())
    return Pose(np.array(position_m, dtype=np.float64), np.roll(quaternion, -1))


def indenter_of(model: mujoco.MjModel, geom: int, away: FloatArray) -> tuple[Indenter, Pose]:
    """Return a geom as an indenter, and the indenter's frame in the geom's.

    Args:
        away: (3,) direction in the geom's frame in which the gel lies behind the geom's surface:
            +z of the indenter's frame, along which it comes to its first pose.

    Raises:
        ValueError: a geom that has no inside, such as a plane, a height field or a mesh with holes.
    """
    shape, frame = _shape_of(model, geom)
    placed = Pose(np.zeros(3), _turn_z_to(away))
    mount = compose(inverse(placed), frame)
    name = model.geom(geom).name or f"geom {geom}"
    if shape.mesh is not None:
        vertices = mount.apply(shape.mesh.vertices_m)
        mesh = IndenterMesh(vertices, shape.mesh.triangles)
        return Indenter(IndenterKind.MESH, (), mesh=mesh, name=name), placed
    return replace(shape, mount=compose(mount, shape.mount), name=name), placed


def _shape_of(model: mujoco.MjModel, geom: int) -> tuple[Indenter, Pose]:
    """Return a geom's shape, and the frame of that indenter in the geom's."""
    size = np.array(model.geom_size[geom], dtype=np.float64)
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    match kind:
        case mujoco.mjtGeom.mjGEOM_SPHERE:
            return sphere(size[0]), Pose(np.array([0.0, 0.0, -size[0]]))
        case mujoco.mjtGeom.mjGEOM_BOX:
            shape = box(2.0 * size, EDGE_SHARE * float(size.min()))
            return shape, Pose(np.array([0.0, 0.0, -size[2]]))
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            shape = flat_punch(size[0], 2.0 * size[1], EDGE_SHARE * float(size[:2].min()))
            return shape, Pose(np.array([0.0, 0.0, -size[1]]))
        case mujoco.mjtGeom.mjGEOM_CAPSULE:
            # Ours lies along y, with its axis a radius above the tip.
            turned = np.array([_HALF_TURN, 0.0, 0.0, _HALF_TURN])
            lying = Pose(np.zeros(3), turned)
            offset = Pose(np.array([0.0, 0.0, -size[0]]))
            return capsule(size[0], 2.0 * size[1]), compose(lying, offset)
        case mujoco.mjtGeom.mjGEOM_MESH:
            return _mesh_of(model, int(model.geom_dataid[geom])), Pose()
    raise ValueError(
        f"geom {model.geom(geom).name or geom} is a {kind.name.removeprefix('mjGEOM_').lower()}, "
        "expected a sphere, box, cylinder, capsule or closed mesh to press the gel with"
    )


def _mesh_of(model: mujoco.MjModel, mesh: int) -> Indenter:
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    begin, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    surface = closed_surface(
        model.mesh_vert[first : first + count],
        model.mesh_face[begin : begin + faces],
        f"mesh {model.mesh(mesh).name!r} of the model",
    )
    return Indenter(IndenterKind.MESH, (), mesh=IndenterMesh(*surface))


def _turn_z_to(direction: FloatArray) -> FloatArray:
    """Return the quaternion (4,) of the least rotation that takes z to a direction (3,)."""
    x, y, z = np.asarray(direction) / np.linalg.norm(direction)
    if z < -1.0 + 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0])
    quaternion = np.array([-y, x, 0.0, 1.0 + z])
    result: FloatArray = quaternion / np.linalg.norm(quaternion)
    return result
