# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How often the calibration's 95 % intervals cover the truth, on simulated presses of a coarse gel.

python benchmarks/coverage.py --json docs/results/coverage.json

Each data set is a dozen presses and slides of a sphere along ways of their own, solved by the gel
with known constants and then measured badly: white noise of skin and force, and for each press one
offset of the indenter, one error of the skin that neighbours have in common, and one factor of the
force. The fit is given the sizes of these errors, as a maker states them, and nothing else. The
joint fit starts at the constants of the stand-in sensor's file, far from the truth, and takes its
Gauss-Newton steps with solves of its own; the median is that of fits of single presses that start
where the joint fit ends. The model has no error of its own here, so that figures of real sensors
can only be worse.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from dotsim_ros.arrays import FloatArray
from dotsim_ros.calibration.fitting import FitProblem, fit_press, linearise
from dotsim_ros.calibration.loss import POINTS, LossNoise
from dotsim_ros.calibration.parameters import chosen_parameters, coordinates
from dotsim_ros.calibration.statistics import (
    Combination,
    joint_estimate,
    joint_step,
    median_estimate,
)
from dotsim_ros.files import write_json, write_text
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.measured.presses import Press
from dotsim_ros.measured.reading import Observation
from dotsim_ros.provenance import provenance
from dotsim_ros.specification import SensorSpecification, SolverSpecification
from dotsim_ros.twin.simulator import GelSimulator, offset_pose

SENSOR = replace(
    SensorSpecification(), solver=SolverSpecification(grid_spacing_m=4.8e-3, refined=False)
)
SKIN = dome_skin(SENSOR.gel.outer_radius_m, 0.9e-3)
BALL = sphere(0.004)
TRUTH = replace(values_of(SENSOR), youngs_modulus_pa=2.0e5, poisson_ratio=0.465, friction=0.25)
NAMES = ("E", "nu", "friction")
NOISE = LossNoise()
"""As makers state it; see `LossNoise`."""

DEPTHS_M = (-0.2e-3, 0.8e-3, 1.6e-3, 2.2e-3, 2.2e-3)
SLIDES_M = (0.0, 0.0, 0.0, 0.0, 0.6e-3)
FRAME_S = 0.1
JOINT_STEPS = 3
SINGLE_SOLVES = 8
KINDS = ("joint", "median")


@dataclass(frozen=True)
class Trial:
    """What the fit of one data set gave.

    Attributes:
        joint, median: estimates and intervals of the coordinates.
        solve_count: of all presses.
    """

    joint: Combination
    median: Combination
    solve_count: int


def press_poses(random: np.random.Generator) -> list[Pose]:
    """Return a press from outside into the dome, up to 40 degrees off its axis, and a slide."""
    tilt = np.deg2rad(random.uniform(0.0, 40.0))
    turn = random.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    half = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    aside = np.cross(axis, random.normal(size=3))
    aside /= np.linalg.norm(aside)
    radius = SENSOR.gel.outer_radius_m
    return [
        Pose((radius - depth) * axis + slide * aside, half / np.linalg.norm(half))
        for depth, slide in zip(DEPTHS_M, SLIDES_M, strict=True)
    ]


def neighbours_weights() -> FloatArray:
    """Return (V, V) weights that make of white noise one of the same size that a patch shares."""
    distance = cdist(SKIN.rest_position_m, SKIN.rest_position_m)
    weight = np.exp(-((distance / NOISE.patch_radius_m) ** 2))
    return np.asarray(weight / np.linalg.norm(weight, axis=1, keepdims=True))


def observation(
    simulator: GelSimulator, patch: FloatArray, number: int, random: np.random.Generator
) -> Observation:
    """Return a press of the true gel, measured with errors."""
    poses = press_poses(random)
    stamp_s = 1.0 + FRAME_S * np.arange(len(poses), dtype=np.float64)
    offset = NOISE.offset() * random.normal(size=6)
    exact = simulator.press(TRUTH, BALL, [offset_pose(p, offset) for p in poses], stamp_s)
    shape = exact.skin_position_m.shape
    shared = NOISE.skin_discretisation_m * patch @ random.normal(size=shape[1:])
    skin = exact.skin_position_m + shared + NOISE.skin_m * random.normal(size=shape)
    force = exact.force_n * (1.0 + NOISE.force_discretisation * random.normal())
    force = force + NOISE.force_n * random.normal(size=force.shape)
    return Observation(Press(f"press_{number}", "ball", poses, stamp_s, skin, force), BALL)


def trial(simulator: GelSimulator, patch: FloatArray, press_count: int, seed: int) -> Trial:
    """Return what the fit of one data set gives."""
    random = np.random.default_rng([seed, press_count])
    problem = FitProblem(chosen_parameters(NAMES), values_of(SENSOR), NOISE, POINTS)
    observations = [observation(simulator, patch, k, random) for k in range(press_count)]
    point = problem.centre()
    solves = press_count
    for _ in range(JOINT_STEPS):
        at = [linearise(simulator, o, problem, point) for o in observations]
        solves += sum(lin.solve_count for lin in at)
        point = point + joint_step(problem, at)
    joint = joint_estimate(problem, at, seed=seed)
    fits = [
        fit_press(simulator, o, problem, lin, budget=SINGLE_SOLVES)
        for o, lin in zip(observations, at, strict=True)
    ]
    solves += sum(fit.solve_count for fit in fits)
    return Trial(joint, median_estimate(problem, fits, seed=seed), solves)


def row_of(kind: str, index: int, trials: Sequence[Trial]) -> dict[str, Any]:
    """Return how often one parameter's interval covered the truth."""
    true = float(coordinates(chosen_parameters(NAMES), TRUTH)[index])
    found: list[Combination] = [getattr(t, kind) for t in trials]
    covered = [bool(c.low[index] <= true <= c.high[index]) for c in found]
    error = np.array([c.point[index] - true for c in found])
    return {
        "estimate": kind,
        "parameter": NAMES[index],
        "covered": sum(covered),
        "data_sets": len(trials),
        "coverage": float(np.mean(covered)),
        "bias": float(error.mean()),
        "deviation": float(error.std(ddof=1)),
        "mean_width": float(np.mean([c.high[index] - c.low[index] for c in found])),
    }


def page(figures: dict[str, Any]) -> str:
    """Return the Markdown page of the figures."""
    origin = figures["origin"]
    lines = [
        "# How often 95 % intervals cover the truth",
        "",
        f"`{origin['command']}`, commit {origin['commit']}, {origin['date']}, {origin['machine']}.",
        "",
        f"{figures['data_sets']} simulated data sets of {figures['presses']} presses; E "
        f"{1e-3 * TRUTH.youngs_modulus_pa:g} kPa, nu {TRUTH.poisson_ratio:g}, friction "
        f"{TRUTH.friction:g}. Bias, deviation of the estimates and width of the intervals are of "
        "the coordinate that is fitted: log E, log(1/2 - nu), log friction.",
        "",
        "| estimate | parameter | covered | of | share | bias | deviation | mean width |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    lines += [
        f"| {r['estimate']} | {r['parameter']} | {r['covered']} | {r['data_sets']} | "
        f"{100 * r['coverage']:.0f} % | {r['bias']:+.3f} | {r['deviation']:.3f} | "
        f"{r['mean_width']:.3f} |"
        for r in figures["rows"]
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data-sets", type=int, default=40, help="how many (40)")
    parser.add_argument("--presses", type=int, default=12, help="of each (12)")
    parser.add_argument("--seed", type=int, default=0, help="of the first (0)")
    parser.add_argument("--json", type=Path, help="write the figures here, and a page beside them")
    arguments = parser.parse_args()
    simulator = GelSimulator(SENSOR, SKIN)
    patch = neighbours_weights()
    trials = []
    for number in range(arguments.data_sets):
        trials.append(trial(simulator, patch, arguments.presses, arguments.seed + number))
        print(f"{number + 1}/{arguments.data_sets}: {trials[-1].solve_count} solves", flush=True)
    figures = {
        "origin": provenance() | {"seed": str(arguments.seed)},
        "noise": asdict(NOISE),
        "truth": asdict(TRUTH),
        "data_sets": arguments.data_sets,
        "presses": arguments.presses,
        "rows": [row_of(kind, index, trials) for kind in KINDS for index in range(len(NAMES))],
    }
    print(page(figures))
    if arguments.json is not None:
        write_json(arguments.json, figures)
        write_text(arguments.json.with_suffix(".md"), page(figures))


if __name__ == "__main__":
    main()
