# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Our gel at the poses of a reference trajectory: how far its skin and force are off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from dotsim_ros.data.trajectory import Trajectory
from dotsim_ros.gel.make import make_gel
from dotsim_ros.geometry.indenter import Indenter, way_m
from dotsim_ros.geometry.pose import interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import SensorSpecification

STEP_S = 0.05
"""Time step of our gel; without effect, since it is quasi-static."""

MOVE_M = 0.25e-3
"""Our gel is moved at most so far at once, about a frame of the sensor at 5 mm/s: friction depends
on the way, and a marker that a longer move brings into contact has already slid by then."""

CONTACT_BAND_M = 0.1e-3
"""Skin of the reference this close to the indenter is the contact region."""


@dataclass(frozen=True)
class FrameComparison:
    """One frame; errors are ours minus the reference's.

    Attributes:
        frame: its number in the trajectory.
        reference_force_n, our_force_n: (3,) of the gel on the indenter.
        normal_n, tangential_n: the reference's force along the indenter's axis and across it.
        normal_error: of the force along the indenter's axis, as a share of the reference's.
        tangential_error: length of the rest of the difference, as a share of the same.
        force_error: length of the whole difference, as a share of the reference's force.
        skin_rms_m, skin_max_m: distance of corresponding points, over the whole dome.
        contact_rms_m: over the contact region.
        converged: whether our solver met its tolerance.
    """

    frame: int
    reference_force_n: FloatArray
    our_force_n: FloatArray
    normal_n: float
    tangential_n: float
    normal_error: float
    tangential_error: float
    force_error: float
    skin_rms_m: float
    skin_max_m: float
    contact_rms_m: float
    converged: bool

    def figures(self) -> dict[str, Any]:
        """Return the frame as plain values, lengths in mm."""
        return {
            "frame": self.frame,
            "force_n": self.reference_force_n.tolist(),
            "our_force_n": self.our_force_n.tolist(),
            "normal_n": self.normal_n,
            "tangential_n": self.tangential_n,
            "normal_error": self.normal_error,
            "tangential_error": self.tangential_error,
            "force_error": self.force_error,
            "skin_rms_mm": 1e3 * self.skin_rms_m,
            "skin_max_mm": 1e3 * self.skin_max_m,
            "contact_rms_mm": 1e3 * self.contact_rms_m,
            "converged": self.converged,
        }


def _root_mean_square(distance: FloatArray, weight: FloatArray) -> float:
    total = float(weight.sum())
    return float(np.sqrt((weight * distance**2).sum() / total)) if total > 0.0 else float("nan")


def compare(
    specification: SensorSpecification,
    skin: SkinMesh,
    indenter: Indenter,
    trajectory: Trajectory,
    *,
    progress: Callable[[float], None] | None = None,
) -> list[FrameComparison]:
    """Return the comparison of every solved frame with contact.

    Args:
        specification: the sensor that the reference was solved for.
        skin: whose vertices the trajectory lists.
        indenter: the rigid shape.
        trajectory: with poses, skin and wrench; the first frame is without contact.
        progress: called with the finished share of tables that are computed once and cached.

    Raises:
        ValueError: the trajectory lacks poses, skin or wrench, or our gel refuses a pose.
    """
    if trajectory.pose is None or trajectory.skin is None or trajectory.wrench is None:
        raise ValueError("a reference trajectory needs poses, skin and wrench")
    quasi_static = replace(specification, solver=replace(specification.solver, dynamic=False))
    gel = make_gel(quasi_static, skin, indenter, progress=progress)
    found = []
    poses = trajectory.pose.poses()
    gel.step(poses[0], STEP_S)
    for frame, (before, pose) in enumerate(pairwise(poses), start=1):
        count = max(1, int(np.ceil(way_m(before, pose, indenter) / MOVE_M - 1e-9)))
        for k in range(1, count + 1):
            ours = gel.step(interpolate(before, pose, k / count), STEP_S)
        reference = trajectory.skin.position_m[frame].astype(np.float64)
        distance = np.linalg.norm(ours.skin_position_m - reference, axis=1)
        near = indenter.distance_from(reference, pose) < CONTACT_BAND_M
        force, axis = trajectory.wrench.force_n[frame], pose.rotation()[:, 2]
        difference = ours.wrench.force_n - force
        normal, normal_difference = float(force @ axis), float(difference @ axis)
        scale = abs(normal)
        found.append(
            FrameComparison(
                frame,
                force,
                ours.wrench.force_n,
                normal,
                float(np.linalg.norm(force - normal * axis)),
                normal_difference / scale,
                float(np.linalg.norm(difference - normal_difference * axis)) / scale,
                float(np.linalg.norm(difference) / np.linalg.norm(force)),
                _root_mean_square(distance, skin.rest_area_m2),
                float(distance.max()),
                _root_mean_square(distance, skin.rest_area_m2 * near),
                ours.converged,
            )
        )
    return found
