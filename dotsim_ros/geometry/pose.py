# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rigid poses and wrenches as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.io.arrays import FloatArray


def _vector(value: ArrayLike, length: int, name: str) -> FloatArray:
    array = np.array(value, dtype=np.float64).reshape(-1)
    if array.shape != (length,):
        raise ValueError(f"{name} needs {length} numbers, got {array.size}")
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name} holds a number that is not finite: {array.tolist()}")
    array.setflags(write=False)
    return array


@dataclass(frozen=True)
class Pose:
    """A rigid pose, of a child frame in a parent frame.

    Attributes:
        position_m: (3,) origin of the child frame, in the parent frame.
        quaternion_xyzw: (4,) rotation from child to parent, of unit length, scalar last (as in
            geometry_msgs).

    Raises:
        ValueError: a number is not finite, or the quaternion's length differs from 1 by more than
            1e-3 (a smaller difference is normalised away).
    """

    position_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    quaternion_xyzw: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0]))

    def __post_init__(self) -> None:
        position = _vector(self.position_m, 3, "position_m")
        quaternion = _vector(self.quaternion_xyzw, 4, "quaternion_xyzw")
        length = float(np.linalg.norm(quaternion))
        if abs(length - 1.0) > 1e-3:
            raise ValueError(
                f"quaternion_xyzw has length {length:.6g}, expected 1 within 1e-3; normalise it"
            )
        quaternion = quaternion / length
        quaternion.setflags(write=False)
        object.__setattr__(self, "position_m", position)
        object.__setattr__(self, "quaternion_xyzw", quaternion)

    def rotation(self) -> FloatArray:
        """Return the (3, 3) rotation matrix from child to parent."""
        x, y, z, w = self.quaternion_xyzw
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )

    @staticmethod
    def above_apex(
        depth_m: float = 0.0, *, x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0
    ) -> ApexPose:
        """Return a pose that a sensor takes from its own apex, dome or pad; see `ApexPose`.

        Raises:
            ValueError: a number is not finite.
        """
        return ApexPose(depth_m, x_m, y_m, yaw_rad)

    def apply(self, points: ArrayLike) -> FloatArray:
        """Return points (..., 3) of the child frame in the parent frame."""
        return np.asarray(points, dtype=np.float64) @ self.rotation().T + self.position_m


@dataclass(frozen=True)
class ApexPose:
    """A pose of the indenter told from the apex of whichever sensor it is given to.

    The apex is where the sensor's axis, z of the base frame, meets the skin at rest. The indenter's
    axis is parallel to the sensor's. Depth is measured along that axis from the plane through the
    apex: a tip next to the axis of a dome lies less deep below the skin there.

    Attributes:
        depth_m: of the tip below the apex; negative above it.
        x_m, y_m: of the tip next to the sensor's axis, base frame.
        yaw_rad: rotation of the indenter about its own axis.

    Raises:
        ValueError: a number is not finite.
    """

    depth_m: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        _vector([self.depth_m, self.x_m, self.y_m, self.yaw_rad], 4, "a pose above the apex")

    def on(self, apex_m: ArrayLike) -> Pose:
        """Return the pose in the base frame of a sensor whose apex is at (3,)."""
        tip = _vector(apex_m, 3, "apex_m") + np.array([self.x_m, self.y_m, -self.depth_m])
        half = 0.5 * self.yaw_rad
        return Pose(tip, np.array([0.0, 0.0, np.sin(half), np.cos(half)]))


def quaternion_product(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the (4,) unit quaternion of the rotation `second` followed by `first`."""
    x, y, z, w = first.tolist()
    u, v, t, s = second.tolist()
    product = np.array(
        [
            w * u + x * s + y * t - z * v,
            w * v - x * t + y * s + z * u,
            w * t + x * v - y * u + z * s,
            w * s - x * u - y * v - z * t,
        ]
    )
    return product / np.linalg.norm(product)


def compose(outer: Pose, inner: Pose) -> Pose:
    """Return the pose of a frame that is at `inner` in a frame that is at `outer`."""
    return Pose(
        outer.apply(inner.position_m),
        quaternion_product(outer.quaternion_xyzw, inner.quaternion_xyzw),
    )


def inverse(pose: Pose) -> Pose:
    """Return the pose of the parent frame in the child frame."""
    return Pose(
        -pose.position_m @ pose.rotation(), pose.quaternion_xyzw * np.array([-1, -1, -1, 1.0])
    )


def interpolate(start: Pose, end: Pose, fraction: float) -> Pose:
    """Return the pose between two: linear in position, spherical-linear in rotation."""
    a = start.quaternion_xyzw
    b = end.quaternion_xyzw
    cosine = float(a @ b)
    if cosine < 0.0:
        b, cosine = -b, -cosine
    if cosine > 0.9995:
        quaternion = a + fraction * (b - a)
    else:
        angle = np.arccos(cosine)
        quaternion = (np.sin((1 - fraction) * angle) * a + np.sin(fraction * angle) * b) / np.sin(
            angle
        )
    position = start.position_m + fraction * (end.position_m - start.position_m)
    return Pose(position, quaternion / np.linalg.norm(quaternion))


@dataclass(frozen=True)
class Wrench:
    """A force (N) and a torque (N m) about the origin of the frame that they are expressed in."""

    force_n: FloatArray = field(default_factory=lambda: np.zeros(3))
    torque_nm: FloatArray = field(default_factory=lambda: np.zeros(3))

    def seen_from(self, pose: Pose) -> Wrench:
        """Return the same wrench in a frame that is at `pose` in this one: along its axes, and with
        the torque about its origin."""
        axes = pose.rotation()
        torque_nm = self.torque_nm - np.cross(pose.position_m, self.force_n)
        return Wrench(self.force_n @ axes, torque_nm @ axes)

    def opposite(self) -> Wrench:
        """Return what acts back."""
        return Wrench(-self.force_n, -self.torque_nm)
