# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Why data do not identify a parameter, and what to record or state instead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dotsim_ros.calibration.fitting import FitProblem, PressLinearisation
from dotsim_ros.calibration.loss import FORCE
from dotsim_ros.data.reading import Observation
from dotsim_ros.data.trajectory import Topics
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.io.arrays import FloatArray

DEEP_M = 1.0e-3
"""Presses that stay shallower show little of anything but E."""
SLIDE_M = 0.5e-3
"""Less way along the skin is no slide."""


FAR = 10.0
"""A start that is off by this factor sees next to nothing of what the forces tell."""
UNITS_N = {"grams": 9.80665e-3, "millinewtons": 1e-3, "kilograms": 9.80665, "pounds": 4.448222}
"""Newtons in what a gauge may show instead; a gram's weight for a mass."""


def far_modulus(found_pa: float, start_pa: float) -> str | None:
    """Return what to check where a fitted modulus is far from the one that the fit began at; None
    where it is not."""
    ratio = found_pa / start_pa
    if 1.0 / FAR < ratio < FAR:
        return None
    unit = min(UNITS_N, key=lambda name: abs(np.log(UNITS_N[name] * ratio)))
    converted_pa = found_pa * UNITS_N[unit]
    return (
        f"E is {ratio:.3g} times that of the sensor's file, {start_pa:.3g} Pa: check the unit of "
        f"the force, which is to be newtons (were it in {unit}, E is {converted_pa:.3g} Pa), and "
        "that of the mesh; else state a value near it in that file"
    )


def shown_modulus_pa(
    problem: FitProblem, linearisations: Sequence[PressLinearisation]
) -> float | None:
    """Return Young's modulus that scales the simulated forces to the measured ones best; None where
    E is not fitted or no force was measured. The linearisations are at the problem's start."""
    index = next((k for k, p in enumerate(problem.parameters) if p.name == "E"), None)
    parts = [lin for lin in linearisations if FORCE in lin.loss]
    if index is None or not parts:
        return None
    # The column of E is the simulated force itself, and the residual simulated minus measured.
    simulated = sum(float(lin.information[FORCE][index, index]) for lin in parts)
    missed = sum(float(lin.gradient[FORCE][index]) for lin in parts)
    if simulated == 0.0:
        return None
    return problem.start.youngs_modulus_pa * (1.0 - missed / simulated)


def is_far(shown_pa: float, problem: FitProblem) -> bool:
    """Return whether the start is too far from what the forces show to fit from there."""
    ratio = shown_pa / problem.start.youngs_modulus_pa
    return not 1.0 / FAR < ratio < FAR


def why_not_identified(
    problem: FitProblem,
    names: Sequence[str],
    observations: Sequence[Observation],
    skin: SkinMesh,
    *,
    losses: Sequence[str],
    topics: Topics,
    shown_pa: float | None = None,
) -> dict[str, str]:
    """Return for each named parameter what keeps the data from identifying it, and what to do.

    The observations are without the channels that no loss asks for; `shown_pa` is Young's modulus
    that the forces show, by `shown_modulus_pa`.
    """
    presses = [o.press for o in observations]
    depths_m = [np.asarray(tip_depth_m(skin, press.poses)) for press in presses]
    deepest_m = max(float(depth.max()) for depth in depths_m)
    forces_n = [np.linalg.norm(p.force_n, axis=1).max() for p in presses if p.force_n is not None]
    has_skin = any(press.skin_position_m is not None for press in presses)
    slide_m = max(
        _way_along_m(press.poses, depth) for press, depth in zip(presses, depths_m, strict=True)
    )
    noise = problem.noise
    found = {}
    for name in names:
        if name == "E" and FORCE not in losses:
            found[name] = "it shows in the force alone, which --loss leaves out; add force to it"
        elif name == "E" and not forces_n:
            found[name] = (
                f"it shows in the force alone, and no trajectory has one on {topics.wrench}; "
                "record a gauge, or name its topic with --wrench-topic"
            )
        elif name == "E" and max(forces_n) < 3.0 * noise.force_n:
            found[name] = (
                f"the largest force, {max(forces_n):.3g} N, is hardly more than the noise of "
                f"{noise.force_n:.3g} N an axis; press deeper, or state the gauge's own noise with "
                "--noise-force-n"
            )
        elif name == "E" and shown_pa is not None and is_far(shown_pa, problem):
            found[name] = (
                f"the forces are those of some {shown_pa:.2g} Pa, and the fit begins at "
                f"{problem.start.youngs_modulus_pa:.2g} Pa; write a value near the former as "
                "material.youngs_modulus_pa into the file of --sensor, if the force is in newtons"
            )
        elif name == "E":
            found[name] = (
                f"the stated error of the force, {100.0 * noise.force_discretisation:.3g} % and "
                f"{noise.force_n:.3g} N, leaves it open; state your gauge's own with "
                "--noise-force-discretisation and --noise-force-n"
            )
        elif deepest_m < DEEP_M:
            found[name] = (
                f"the deepest press goes {1e3 * max(deepest_m, 0.0):.2f} mm into the gel; press at "
                "least 2 mm deep"
            )
        elif name == "friction" and slide_m < SLIDE_M:
            found[name] = (
                f"no press slides more than {1e3 * slide_m:.2f} mm along the skin; record slides "
                "of 2 mm or more"
            )
        elif not has_skin:
            found[name] = (
                f"it shows in the skin first, and no trajectory has one on {topics.skin}; record "
                "the skin, or fit E alone with --fit E"
            )
        else:
            found[name] = (
                f"{len(presses)} presses with the stated noise leave it open; record more of them, "
                "by other indenters and at other places, or state your own noise with --noise-..."
            )
    return found


def _way_along_m(poses: Sequence[Pose], depth_m: FloatArray) -> float:
    """Return how far the tip goes along the skin, across its own axis, while it is in it."""
    inside = [pose for pose, depth in zip(poses, depth_m.tolist(), strict=True) if depth > 0.0]
    if len(inside) < 2:
        return 0.0
    outward = inside[0].rotation()[:, 2]
    way = np.stack([pose.position_m - inside[0].position_m for pose in inside])
    return float(np.linalg.norm(way - np.outer(way @ outward, outward), axis=1).max())
