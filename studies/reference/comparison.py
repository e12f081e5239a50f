# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Our gel at the poses of a reference trajectory: how far its skin and force are off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from dotsim_ros.data.trajectory import Trajectory
from dotsim_ros.gel.make import make_gel
from dotsim_ros.geometry.indenter import Indenter, way_m
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import GelAnswer

STEP_S = 0.05
"""Time step of our gel; without effect, since it is quasi-static."""

MOVE_M = 0.25e-3
"""Our gel is moved at most so far at once, about a frame of the sensor at 5 mm/s: friction depends
on the way, and a marker that a longer move brings into contact has already slid by then."""

CONTACT_BAND_M = 0.1e-3
"""Skin of the reference this close to the indenter is the contact region."""


def _root_mean_square(distance: FloatArray, weight: FloatArray) -> float:
    total = float(weight.sum())
    return float(np.sqrt((weight * distance**2).sum() / total)) if total > 0.0 else float("nan")


def implicit_step(
    specification: SensorSpecification, skin: SkinMesh, indenter: Indenter
) -> Callable[[Pose, float], GelAnswer]:
    """Return what moves the indenter of a sensor's implicit gel, without inertia, to a pose."""
    solver = replace(specification.solver, dynamic=False)
    return make_gel(replace(specification, solver=solver), skin, indenter).step


def compare(
    step: Callable[[Pose, float], GelAnswer],
    skin: SkinMesh,
    indenter: Indenter,
    trajectory: Trajectory,
) -> list[dict[str, Any]]:
    """Return the comparison of every solved frame with contact.

    Args:
        step: moves our gel's indenter to a pose in so many seconds; the gel is at rest.
        skin: whose vertices the trajectory lists.
        indenter: the rigid shape.
        trajectory: with poses, skin and wrench; the first frame is without contact.

    Returns:
        Of each frame, with errors ours minus the reference's: `frame`, its number; `force_n` and
        `our_force_n` (3,) of the gel on the indenter, `our_torque_nm` about
        the base frame's origin; of the reference's force `normal_n` along the
        indenter's axis and `tangential_n` across it; `normal_error` along that axis and
        `tangential_error`, the length of the rest of the difference, as shares of the normal force;
        `force_error`, the length of the whole difference, as a share of the whole force;
        `skin_rms_mm` and `skin_max_mm`, distances of corresponding points over the whole dome, and
        `contact_rms_mm` over the contact region; `converged`, whether our solver met its tolerance.

    Raises:
        ValueError: the trajectory lacks poses, skin or wrench, or our gel refuses a pose.
    """
    if trajectory.pose is None or trajectory.skin is None or trajectory.wrench is None:
        raise ValueError("a reference trajectory needs poses, skin and wrench")
    found = []
    poses = trajectory.pose.poses()
    step(poses[0], STEP_S)
    for frame, (before, pose) in enumerate(pairwise(poses), start=1):
        count = max(1, int(np.ceil(way_m(before, pose, indenter) / MOVE_M - 1e-9)))
        for k in range(1, count + 1):
            ours = step(interpolate(before, pose, k / count), STEP_S)
        reference = trajectory.skin.position_m[frame].astype(np.float64)
        distance = np.linalg.norm(ours.skin_position_m - reference, axis=1)
        near = indenter.distance_from(reference, pose) < CONTACT_BAND_M
        force, axis = trajectory.wrench.force_n[frame], pose.rotation()[:, 2]
        difference = ours.wrench.force_n - force
        normal, normal_difference = float(force @ axis), float(difference @ axis)
        across = difference - normal_difference * axis
        found.append(
            {
                "frame": frame,
                "force_n": force.tolist(),
                "our_force_n": ours.wrench.force_n.tolist(),
                "our_torque_nm": ours.wrench.torque_nm.tolist(),
                "normal_n": normal,
                "tangential_n": float(np.linalg.norm(force - normal * axis)),
                "normal_error": normal_difference / abs(normal),
                "tangential_error": float(np.linalg.norm(across)) / abs(normal),
                "force_error": float(np.linalg.norm(difference) / np.linalg.norm(force)),
                "skin_rms_mm": 1e3 * _root_mean_square(distance, skin.rest_area_m2),
                "skin_max_mm": 1e3 * float(distance.max()),
                "contact_rms_mm": 1e3 * _root_mean_square(distance, skin.rest_area_m2 * near),
                "converged": ours.converged,
            }
        )
    return found
