# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Motion of a rigid frame at a constant velocity."""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.geometry.pose import Pose, quaternion_product
from dotsim_ros.io.arrays import FloatArray


class TwistFrame(Enum):
    """The axes that a velocity is given along."""

    PARENT = "parent"
    OWN = "own"


def advance(
    pose: Pose,
    linear_m_s: ArrayLike,
    angular_rad_s: ArrayLike,
    *,
    duration_s: float,
    along: TwistFrame = TwistFrame.PARENT,
) -> Pose:
    """Return the pose after a time at a constant velocity of the frame's origin.

    Args:
        pose: of the frame in its parent, at the start.
        linear_m_s: (3,) velocity of the frame's origin.
        angular_rad_s: (3,) angular velocity.
        duration_s: how long, not negative.
        along: the axes of both velocities: those of the parent, or the frame's own, which turn
            with it (then the path is a screw).

    Raises:
        ValueError: the time is negative, or a number is not finite.
    """
    if not (np.isfinite(duration_s) and duration_s >= 0.0):
        raise ValueError(f"duration_s is {duration_s}, expected a time that is not negative")
    linear = np.asarray(linear_m_s, dtype=np.float64)
    rotation_vector = np.asarray(angular_rad_s, dtype=np.float64) * duration_s
    turn = _quaternion_of_rotation_vector(rotation_vector)
    if along is TwistFrame.PARENT:
        position = pose.position_m + linear * duration_s
        return Pose(position, quaternion_product(turn, pose.quaternion_xyzw))
    travelled = _screw_integral(rotation_vector) @ (linear * duration_s)
    return Pose(pose.apply(travelled), quaternion_product(pose.quaternion_xyzw, turn))


def _quaternion_of_rotation_vector(vector: FloatArray) -> FloatArray:
    angle = float(np.linalg.norm(vector))
    # np.sinc(x) is sin(pi x) / (pi x), finite at 0.
    return np.append(0.5 * np.sinc(angle / (2.0 * np.pi)) * vector, np.cos(0.5 * angle))


def _screw_integral(vector: FloatArray) -> FloatArray:
    """Return the mean (3, 3) rotation on the way from none to that of the rotation vector."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * cross)
    return np.asarray(
        np.eye(3)
        + (1.0 - np.cos(angle)) / angle**2 * cross
        + (angle - np.sin(angle)) / angle**3 * cross @ cross
    )
