# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The poses of an indenter in a touch, on a dome or a pad.

The first half of the frames, from just above the skin, is the way in along the skin's normal; the
other half is what the kind of the touch says. The depth is that of the indenter's deepest point in
the gel at rest, so that no touch misses, whatever the indenter's shape and tilt.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.data.motion import pose_along
from dotsim_ros.gel.rest_depth import RestDepth
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pad_face import face_normal
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.learning.touches.plan import GRASP
from dotsim_ros.specification import GelSpecification, face_drop_m

CLEARANCE_M = 0.1e-3
"""From the skin to the indenter in a touch's first frame."""
ROUNDS = 3
"""Of the search for a depth: on a dome the way along the normal is not the depth."""
OPPOSITE = Rotation.from_euler("x", np.pi)
"""Of the second sensor of a grasp, seen from the first."""


def place_on(
    gel: GelSpecification, share: float, azimuth_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Return a point (3,) of the skin at rest and its normal (3,).

    Args:
        gel: the sensor's.
        share: of the way from the middle of the face to its edge.
        azimuth_rad: direction of the way, from +x towards +y.
    """
    along = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
    if gel.shape == "dome":
        tilt = 0.5 * np.pi * share
        normal = np.array([*(np.sin(tilt) * along), np.cos(tilt)])
        return gel.outer_radius_m * normal, normal
    x, y = share * along * 0.5 * np.asarray(gel.pad_size_m[:2])
    return _on_pad(gel, x, y)


def _on_pad(gel: GelSpecification, x: float, y: float) -> tuple[FloatArray, FloatArray]:
    x, y = (
        float(np.clip(place, -0.5 * side, 0.5 * side))
        for place, side in zip((x, y), gel.pad_size_m[:2], strict=True)
    )
    curvature = gel.face_curvature_per_m
    height = gel.pad_size_m[2] - float(face_drop_m(x, y, curvature))
    return np.array([x, y, height]), face_normal(np.asarray(x), np.asarray(y), curvature)


def _walked(
    gel: GelSpecification, point_m: FloatArray, way_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the point of the skin at a way (3,) along it from another, and its normal."""
    moved = point_m + way_m
    if gel.shape == "dome":
        normal = moved / np.linalg.norm(moved)
        return gel.outer_radius_m * normal, normal
    return _on_pad(gel, moved[0], moved[1])


class MotionMaker:
    """Makes the poses of touches by one indenter on one gel.

    Args:
        gel: the sensor's.
        indenter: what presses.
        rest_depth: of the indenter in the gel.
        frames: of a touch.
    """

    def __init__(
        self, gel: GelSpecification, indenter: Indenter, rest_depth: RestDepth, frames: int
    ) -> None:
        self._gel, self._rest_depth = gel, rest_depth
        self._frames = frames
        # Of the shorter side across its axis: what it rolls on.
        self._roll_radius_m = 0.5 * float(np.ptp(indenter.bounds_m(), axis=0)[:2].min())

    def poses(
        self, kind: str, drawn: Mapping[str, float], random: np.random.Generator
    ) -> list[Pose]:
        """Return the poses of a touch in the base frame.

        Args:
            kind: of `plan.KINDS`.
            drawn: a number for each of `plan.POSE_LIMITS`.
            random: what directions are drawn from.
        """
        share = 0.0 if kind == GRASP else drawn["place"]
        point, normal = place_on(self._gel, share, random.uniform(0.0, 2.0 * np.pi))
        axis = pose_along(point, normal).rotation() @ _tilted(
            0.0 if kind == GRASP else drawn["tilt"], random.uniform(0.0, 2.0 * np.pi)
        )
        start = pose_along(point, axis, spin_rad=random.uniform(0.0, 2.0 * np.pi))
        heading = np.cross(normal, Rotation.random(rng=random).as_matrix()[0])
        heading /= np.linalg.norm(heading)
        side = random.choice([-1.0, 1.0])
        depth_m = drawn["depth"] * self._gel.thickness_m
        in_count = self._frames - self._frames // 2
        poses = [
            self._at_depth(start, depth, normal)
            for depth in np.linspace(-CLEARANCE_M, depth_m, in_count)
        ]
        shares = np.arange(1, self._frames // 2 + 1) / (self._frames // 2)
        moved: dict[str, Callable[[float], Pose]] = {
            "press": lambda s: self._at_depth(start, (1.0 - s) * depth_m - s * CLEARANCE_M, normal),
            "hold": lambda s: poses[in_count - 1],
            "slide": lambda s: self._slid(start, point, s * drawn["slide"] * heading, depth_m),
            "twist": lambda s: self._turned(
                start,
                Rotation.from_rotvec(side * s * drawn["twist"] * normal),
                point,
                normal,
                depth_m,
            ),
            "roll": lambda s: self._rolled(
                start, point, normal, heading, s * drawn["roll"], depth_m
            ),
        }
        moved[GRASP] = moved["slide" if random.uniform() < 0.5 else "twist"]
        return poses + [moved[kind](share) for share in shares]

    def opposite(self, poses: list[Pose]) -> list[Pose]:
        """Return the poses of the same object in the frame of a second sensor on its other side,
        which the object enters as deep as the first one."""
        point, normal = place_on(self._gel, 0.0, 0.0)
        found = []
        for pose in poses:
            # SciPy takes no array that is read-only.
            x, y, _ = OPPOSITE.apply(pose.position_m.copy())
            turned = (OPPOSITE * Rotation.from_quat(pose.quaternion_xyzw)).as_quat()
            near = Pose(np.array([x, y, point[2]]), turned)
            found.append(self._at_depth(near, self._rest_depth(pose), normal))
        return found

    def _at_depth(self, pose: Pose, depth_m: float, normal: FloatArray) -> Pose:
        """Return a pose moved along a normal until its deepest point has a depth."""
        for _ in range(ROUNDS):
            raised = self._rest_depth(pose) - depth_m
            pose = Pose(pose.position_m + raised * normal, pose.quaternion_xyzw)
        return pose

    def _slid(self, start: Pose, point: FloatArray, way_m: FloatArray, depth_m: float) -> Pose:
        place, normal = _walked(self._gel, point, way_m)
        before = point - start.position_m
        moved = Pose(place - before, start.quaternion_xyzw)
        return self._at_depth(moved, depth_m, normal)

    def _turned(
        self, start: Pose, turn: Rotation, about_m: FloatArray, normal: FloatArray, depth_m: float
    ) -> Pose:
        position = about_m + turn.apply(start.position_m - about_m)
        quaternion = (turn * Rotation.from_quat(start.quaternion_xyzw)).as_quat()
        return self._at_depth(Pose(position, quaternion), depth_m, normal)

    def _rolled(
        self,
        start: Pose,
        point: FloatArray,
        normal: FloatArray,
        heading: FloatArray,
        angle_rad: float,
        depth_m: float,
    ) -> Pose:
        """Return the pose after the indenter has rolled on its round side without sliding."""
        radius = self._roll_radius_m
        turn = Rotation.from_rotvec(angle_rad * np.cross(normal, heading))
        centre = start.position_m + radius * start.rotation()[:, 2]
        place, there = _walked(self._gel, point, radius * angle_rad * heading)
        moved = centre + (place - point) + turn.apply(start.position_m - centre)
        quaternion = (turn * Rotation.from_quat(start.quaternion_xyzw)).as_quat()
        return self._at_depth(Pose(moved, quaternion), depth_m, there)


def _tilted(angle_rad: float, towards_rad: float) -> FloatArray:
    """Return the direction (3,) at an angle from +z."""
    across = np.sin(angle_rad) * np.array([np.cos(towards_rad), np.sin(towards_rad)])
    return np.array([*across, np.cos(angle_rad)])
