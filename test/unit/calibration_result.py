# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A calibration of a gel that answers in a straight line, for tests of its report: no solve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dotsim_ros.calibration.fitting import FitProblem, PressFit, PressLinearisation
from dotsim_ros.calibration.loss import FORCE, POINTS, SKIN, LossNoise
from dotsim_ros.calibration.parameters import chosen_parameters, with_coordinates
from dotsim_ros.calibration.run import Calibration
from dotsim_ros.calibration.statistics import identifiability, joint_estimate, median_estimate
from dotsim_ros.data.reading import Omission
from dotsim_ros.gel.values import values_of
from dotsim_ros.specification import SensorSpecification

NAMES = ("E", "nu", "friction")
SENSITIVITY = {SKIN: np.array([0.0, 3.0, 2.0]), FORCE: np.array([20.0, 2.0, 5.0])}
"""Change of a residual by a coordinate; the skin of a slow press does not depend on E."""
TRUE_SHIFT = np.array([0.2, -0.3, 0.1])
COUNT = 60


def _linearised(problem: FitProblem, random: np.random.Generator) -> PressLinearisation:
    found = {}
    for channel, size in SENSITIVITY.items():
        jacobian = size * random.normal(size=(COUNT, len(NAMES)))
        found[channel] = (jacobian, random.normal(size=COUNT) - jacobian @ TRUE_SHIFT)
    return PressLinearisation(
        point=problem.centre(),
        information={c: j.T @ j for c, (j, _) in found.items()},
        gradient={c: j.T @ r for c, (j, r) in found.items()},
        loss={c: 0.5 * float(r @ r) for c, (_, r) in found.items()},
        count=dict.fromkeys(found, COUNT),
        solve_count=4,
        converged=True,
    )


def calibration(press_count: int = 8) -> Calibration:
    """Return a calibration of some presses, one more left out."""
    random = np.random.default_rng(0)
    sensor = SensorSpecification()
    problem = FitProblem(chosen_parameters(NAMES), values_of(sensor), LossNoise(), POINTS)
    at = {f"{k}_slide_of_a_cone": _linearised(problem, random) for k in range(press_count)}
    fits = {}
    for name, lin in at.items():
        information, gradient, _ = lin.total()
        step = -np.linalg.solve(information, gradient)
        fits[name] = PressFit(replace(lin, point=lin.point + step), [2.0, 1.0], 9, True)
    joint = joint_estimate(problem, list(at.values()))
    values = with_coordinates(problem.start, problem.parameters, joint.point)
    return Calibration(
        problem=problem,
        asked=NAMES,
        frozen=(),
        identifiability=identifiability(problem, list(at.values())),
        fits=fits,
        median=median_estimate(problem, list(fits.values())),
        joint=joint,
        values=values,
        specification=sensor,
        linearisations=at,
        solve_counts=dict.fromkeys(at, 13),
        scores=[],
        omissions=[Omission("9_cone", "9_cone: no message on /indenter/pose; record them")],
        fit_seconds=12.0,
    )
