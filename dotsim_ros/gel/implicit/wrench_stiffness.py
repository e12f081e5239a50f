# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How the wrench on an indenter changes with its pose: what couples the gel to other dynamics."""

import numpy as np
from scipy import linalg

from dotsim_ros.io.arrays import AnyFloatArray, FloatArray


def wrench_stiffness(
    position_m: FloatArray, root: AnyFloatArray, contact_n_m: FloatArray
) -> FloatArray:
    """Return minus the derivative (6, 6) of the wrench on the indenter by its twist.

    The gel is linear with the compliance C = L L^T between the markers, and the contact with its
    own stiffness H, which is not symmetric where markers slip: forces change by (1 + H C)^-1 H J
    for a motion J of the indenter, of which the wrench takes J^T. The result is made symmetric and
    positive, which friction alone is not.

    Args:
        position_m: (A, 3) of the markers, base frame.
        root: (A, 3, k) L.
        contact_n_m: (A, 3, 3) H of each marker.

    Returns:
        (6, 6) for force and torque about the base frame's origin, by translation (m) and rotation
        (rad) about the same: N/m, N/rad, N m/m and N m/rad.
    """
    count, columns = len(position_m), root.shape[-1]
    motion = np.zeros((count, 3, 6))
    motion[:, :, :3] = np.eye(3)
    x, y, z = position_m.T
    motion[:, 0, 4], motion[:, 0, 5] = z, -y
    motion[:, 1, 3], motion[:, 1, 5] = -z, x
    motion[:, 2, 3], motion[:, 2, 4] = y, -x
    # (3 A, ...) for the products over all markers.
    moves = motion.reshape(3 * count, 6)
    forces = np.matmul(contact_n_m, motion).reshape(3 * count, 6)
    roots = root.reshape(3 * count, columns).astype(np.float64)
    pulls = np.matmul(contact_n_m, root).reshape(3 * count, columns)
    between = np.eye(columns) + roots.T @ pulls
    stiffness = moves.T @ forces - moves.T @ pulls @ linalg.solve(between, roots.T @ forces)
    # Only the result: with H of slipping markers made symmetric, `between` can be singular.
    value, vector = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    positive: FloatArray = (vector * np.maximum(value, 0.0)) @ vector.T
    return positive
