# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A skin clipped by a rigid indenter: where the indenter's surface is, along the skin's normals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, vertex_normals
from dotsim_ros.io.arrays import FloatArray

# Another search of a mesh costs more than many points of one, so rays are sampled many at once.
SAMPLES = 64
# A gap between two parts of an indenter that is narrower than this is stepped over.
STEP_M = 1.0e-4
REFINEMENTS = 2
"""Each divides what is left of a bracket of one step by the number of samples: 0.1 mm to 24 nm."""


def clip_depths(skin: SkinMesh, poses: Sequence[Pose], indenter: Indenter) -> FloatArray:
    """Return (F, V) how far each vertex at rest lies below the indenter's surface, metres.

    A vertex inside the indenter moves against the skin's outward normal until it has left it; one
    outside has depth zero.

    Args:
        skin: the skin at rest.
        poses: F poses of the indenter's frame in the base frame.
        indenter: the rigid shape.
    """
    rest, inward = skin.rest_position_m, -vertex_normals(skin.rest_position_m, skin.triangles)
    # In the frame of the indenter all frames are one set of rays against one shape.
    start = np.concatenate([(rest - p.position_m) @ p.rotation() for p in poses])
    direction = np.concatenate([inward @ p.rotation() for p in poses])
    depth = np.zeros(len(start))
    lower, upper = indenter.bounds_m()
    near = np.flatnonzero(np.all((start > lower) & (start < upper), axis=1))
    inside = near[indenter.signed_distance(start[near]) < 0.0]
    depth[inside] = _exit_depths(indenter, start[inside], direction[inside])
    return depth.reshape(len(poses), len(rest))


def clipped_skin(skin: SkinMesh, depth_m: FloatArray) -> FloatArray:
    """Return (F, V, 3) the skin with its vertices moved inwards by depths (F, V)."""
    normal = vertex_normals(skin.rest_position_m, skin.triangles)
    return np.asarray(skin.rest_position_m - depth_m[..., None] * normal)


def _exit_depths(indenter: Indenter, start_m: FloatArray, direction: FloatArray) -> FloatArray:
    """Return (N,) the least known length after which rays that start inside are outside."""
    inner = np.zeros(len(start_m))
    going = np.arange(len(start_m))
    while going.size:
        left = _last_inside(indenter, start_m[going], direction[going], inner[going], STEP_M)
        inner[going] += STEP_M * left
        going = going[left == SAMPLES]
    step = STEP_M
    for _ in range(REFINEMENTS):
        step /= SAMPLES
        inner += step * _last_inside(indenter, start_m, direction, inner, step)
    return inner + step


def _last_inside(
    indenter: Indenter,
    start_m: FloatArray,
    direction: FloatArray,
    length_m: FloatArray,
    step_m: float,
) -> NDArray[np.intp]:
    """Return (N,) how many steps from a length that is inside a ray stays so, at most SAMPLES."""
    steps = length_m[:, None] + step_m * np.arange(1, SAMPLES + 1)
    points = start_m[:, None] + steps[..., None] * direction[:, None]
    outside = indenter.signed_distance(points.reshape(-1, 3)).reshape(steps.shape) >= 0.0
    return np.where(outside.any(axis=1), outside.argmax(axis=1), SAMPLES)
