# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The force of a rigid contact with a penalty: proportional to the penetration, along the normal.

Tacto's gel has no force: PyBullet finds it between rigid bodies, and Tacto sinks the
object in by a depth in proportion to it, `depth = force / largest_force * largest_depth` (Wang et
al. 2022; 100 N and 5 mm in the file of its DIGIT). With the pose given, the same line read
the other way gives the force. Taxim's experiments with a robot take PyBullet's force as well.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.geometry.skin_mesh import SkinMesh, vertex_normals
from dotsim_ros.io.arrays import FloatArray


def penetration_vectors(skin: SkinMesh, depth_m: FloatArray) -> FloatArray:
    """Return (F, 3) the deepest penetration, along the contact's mean outward normal, metres.

    Args:
        skin: the skin at rest.
        depth_m: (F, V) depth of its vertices below the indenter's surface.
    """
    normal = vertex_normals(skin.rest_position_m, skin.triangles)
    mean = (depth_m * skin.rest_area_m2) @ normal
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    direction = np.divide(mean, length, out=np.zeros_like(mean), where=length > 0.0)
    return np.asarray(depth_m.max(axis=1)[:, None] * direction)


def fit_stiffness(penetration_m: FloatArray, force_n: FloatArray) -> float:
    """Return the stiffness (N/m) of least squares in the force.

    Args:
        penetration_m: (N, 3) of `penetration_vectors`.
        force_n: (N, 3) measured, of the gel on the indenter.

    Raises:
        ValueError: nothing penetrates, so that no stiffness can be estimated.
    """
    square = float(np.sum(penetration_m**2))
    if square == 0.0:
        raise ValueError(
            "no indenter touches the skin in the presses to fit on; a stiffness cannot be estimated"
        )
    return float(np.sum(penetration_m * force_n)) / square
