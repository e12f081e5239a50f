# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Calibration of a coarse gel: its derivatives, its intervals, and the whole command."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.calibration.fitting import FitProblem, fit_press, linearise
from dotsim_ros.calibration.loss import CHAMFER, POINTS, LossNoise, force_deviation_n
from dotsim_ros.calibration.parameters import chosen_parameters, coordinates
from dotsim_ros.calibration.statistics import identifiability
from dotsim_ros.cli.main import main
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.presses import Press
from dotsim_ros.data.reading import Observation
from dotsim_ros.data.trajectory import PoseChannel, SkinChannel, Trajectory, WrenchChannel
from dotsim_ros.gel.adjoint.backward import trajectory_gradient
from dotsim_ros.gel.adjoint.gradient import LossGradient
from dotsim_ros.gel.adjoint.recorder import Recorder
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.make import body_of, material_of
from dotsim_ros.gel.values import GelValues, specification_with, values_of
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.specification import (
    SensorSpecification,
    SolverSpecification,
    load_sensor,
    write_sensor,
)
from dotsim_ros.twin.simulator import GelSimulator, offset_pose

Array = NDArray[np.float64]

RADIUS = 0.01575
SKIN_MESH = dome_skin(RADIUS, 1.2e-3)
SENSOR = replace(
    SensorSpecification(), solver=SolverSpecification(grid_spacing_m=4.8e-3, refined=False)
)
BALL = sphere(0.004)
TRUTH = replace(values_of(SENSOR), youngs_modulus_pa=2.0e5, poisson_ratio=0.465, friction=0.25)
NOISE = LossNoise(skin_discretisation_m=0.0, force_discretisation=0.01)
NAMES = ("E", "nu", "friction")
QUICK = ((-0.2e-3, 0.0), (0.7e-3, 0.0), (1.4e-3, 0.0), (1.4e-3, 0.7e-3))
SLOW = (
    *((-0.2e-3, 0.0), (0.6e-3, 0.0), (1.2e-3, 0.0)),
    *((1.4e-3, 0.2e-3), (1.4e-3, 0.4e-3), (1.4e-3, 0.6e-3), (1.4e-3, 0.8e-3)),
)
"""Depths and slides of the frames of a press, m."""


@cache
def simulator() -> GelSimulator:
    return GelSimulator(SENSOR, SKIN_MESH)


def path(seed: int, frames: tuple[tuple[float, float], ...] = QUICK) -> list[Pose]:
    """Return a press into the dome from outside, and a slide along it."""
    random = np.random.default_rng(seed)
    axis = np.array([*(0.4 * random.normal(size=2)), 1.0])
    axis /= np.linalg.norm(axis)
    half = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    aside = np.cross(axis, random.normal(size=3))
    aside /= np.linalg.norm(aside)
    return [
        Pose((RADIUS - depth) * axis + slide * aside, half / np.linalg.norm(half))
        for depth, slide in frames
    ]


@cache
def observed(
    seed: int, values: GelValues = TRUTH, frames: tuple[tuple[float, float], ...] = QUICK
) -> Observation:
    """Return a press of the gel with the given values, measured with noise."""
    random = np.random.default_rng([seed, 1])
    poses = path(seed, frames)
    stamp_s = 1.0 + 0.1 * np.arange(len(poses))
    offset = NOISE.offset() * random.normal(size=6) * [1, 1, 1, 0, 0, 0]
    exact = simulator().press(values, BALL, [offset_pose(p, offset) for p in poses], stamp_s)
    skin = exact.skin_position_m + NOISE.skin_m * random.normal(size=exact.skin_position_m.shape)
    force = exact.force_n + NOISE.force_n * random.normal(size=exact.force_n.shape)
    force *= 1.0 + NOISE.force_discretisation * random.normal()
    return Observation(Press(f"press_{seed}", "ball", poses, stamp_s, skin, force), BALL)


def problem_of(names: tuple[str, ...] = NAMES, **changes: object) -> FitProblem:
    made = FitProblem(chosen_parameters(names), values_of(SENSOR), NOISE, POINTS)
    return replace(made, **changes)


def adjoint_gradient(observation: Observation, values: GelValues) -> dict[str, float]:
    """Return the derivatives of the same loss by the fitted coordinates, through the adjoint."""
    specification = specification_with(SENSOR, values)
    gel = ImplicitGel(
        body_of(specification.gel),
        SKIN_MESH,
        material_of(specification.material),
        contact=specification.contact,
        solver=replace(specification.solver, iterations=40),
        indenter=BALL,
    )
    press = observation.press
    assert press.skin_position_m is not None
    assert press.force_n is not None
    sigma_m = NOISE.skin_point_m(SKIN_MESH)
    sigma_n = force_deviation_n(press, NOISE, SKIN_MESH)
    recorder = Recorder(gel)
    losses = []
    for frame, pose in enumerate(press.poses):
        state = recorder.step([pose], 0.1)[0]
        missed = (state.skin_position_m - press.skin_position_m[frame]) / sigma_m**2
        missed[SKIN_MESH.on_base] = 0.0
        force = (state.wrench.force_n - press.force_n[frame]) / sigma_n[frame] ** 2
        losses.append(LossGradient(missed, force, np.zeros(3)))
    found = trajectory_gradient(gel, recorder.trajectories[0], losses)
    by_law = found.by_law(gel.material.law)
    return {
        "E": by_law["youngs_modulus_pa"] * values.youngs_modulus_pa,
        "nu": -by_law["poisson_ratio"] * (0.5 - values.poisson_ratio),
        "friction": found.friction_coefficient * values.friction,
    }


def test_the_gradient_that_the_columns_give_is_the_adjoints():
    # Off the truth, so that the gradient is no sum of noise.
    values = replace(TRUTH, youngs_modulus_pa=2.4e5, poisson_ratio=0.44, friction=0.35)
    # In small steps: of a long slide in one step the two solvers find the friction less alike.
    observation = observed(0, frames=SLOW)
    # A gradient is compared, not a Gauss-Newton step: smaller steps, both ways; at a step of 0.03
    # a marker that sticks in one solution slips in the other, however tightly both are solved.
    both = []
    for sign in (1.0, -1.0):
        parameters = tuple(replace(p, step=0.01) for p in chosen_parameters(NAMES))
        away = coordinates(parameters, values) + sign
        centre = values_of(SENSOR)
        for parameter, place in zip(parameters, away, strict=True):
            centre = replace(centre, **{parameter.field: parameter.to_value(float(place))})
        problem = FitProblem(parameters, centre, NOISE, POINTS)
        both.append(
            linearise(simulator(), observation, problem, coordinates(parameters, values)).total()[1]
        )
    found = dict(zip(NAMES, 0.5 * (both[0] + both[1]), strict=True))
    expected = adjoint_gradient(observation, values)
    for name in NAMES:
        assert found[name] == pytest.approx(expected[name], rel=0.05)


def test_the_skin_does_not_depend_on_youngs_modulus_and_the_force_is_proportional():
    states = []
    for youngs_pa in (2.0e5, 5.0e5):
        specification = specification_with(SENSOR, replace(TRUTH, youngs_modulus_pa=youngs_pa))
        gel = ImplicitGel(
            body_of(specification.gel),
            SKIN_MESH,
            material_of(specification.material),
            contact=specification.contact,
            solver=replace(specification.solver, tolerance_m=1e-7, iterations=60),
            indenter=BALL,
        )
        states.append([gel.step([pose], 0.1)[0] for pose in path(1)][-1])
    assert np.abs(states[1].skin_position_m - states[0].skin_position_m).max() < 1e-6
    ratio = states[1].wrench.force_n[2] / states[0].wrench.force_n[2]
    assert ratio == pytest.approx(2.5, rel=2e-3)


def test_the_skin_alone_tells_nothing_of_youngs_modulus_and_the_force_a_few_percent():
    problem = problem_of()
    here = coordinates(problem.parameters, TRUTH)
    press = linearise(simulator(), observed(0), problem, here)
    rows = {(r.parameter, r.data): r for r in identifiability(problem, [press])}
    assert rows["E", "skin alone"].information == 0.0
    assert not rows["E", "skin alone"].is_told
    assert rows["E", "skin and force"].is_told
    assert rows["E", "skin and force"].deviation < 0.05 * np.sqrt(3.0)


@pytest.mark.parametrize("skin_loss", [POINTS, CHAMFER])
def test_one_press_is_fitted_from_far_away(skin_loss):
    problem = problem_of(skin_loss=skin_loss)
    observation = observed(2)
    start = linearise(simulator(), observation, problem, problem.centre())
    assert start.solve_count == 3
    fit = fit_press(simulator(), observation, problem, start, budget=15)
    assert fit.solve_count <= 15
    assert all(later < earlier for earlier, later in zip(fit.losses, fit.losses[1:], strict=False))
    found = fit.best.point - coordinates(problem.parameters, TRUTH)
    # E by the force's common error and the pose's; nu and friction as one press tells them.
    assert abs(found[0]) < 0.1
    assert abs(found[1]) < 0.5
    assert abs(found[2]) < 0.3


@pytest.mark.parametrize("beyond", [0.0, 0.3])
def test_differences_at_a_bound_are_taken_where_the_model_answers(beyond):
    (parameter,) = chosen_parameters(("nu",))
    start = replace(values_of(SENSOR), poisson_ratio=parameter.bounds[0])
    problem = FitProblem((parameter,), start, NOISE, POINTS)
    wide = replace(parameter, bounds=(0.01, parameter.bounds[1]))
    found = linearise(simulator(), observed(1), problem, problem.centre() + beyond)
    expected = linearise(
        simulator(), observed(1), replace(problem, parameters=(wide,)), problem.centre()
    )
    assert found.point == pytest.approx(problem.centre(), abs=1e-12)
    ratio = found.total()[0] / expected.total()[0]
    assert ratio == pytest.approx(np.ones((1, 1)), rel=0.5)


def trajectory(press: Press) -> Trajectory:
    stamp_ns = np.round(1e9 * press.stamp_s).astype(np.int64)
    return Trajectory(
        pose=PoseChannel.of(stamp_ns, press.poses),
        wrench=WrenchChannel(stamp_ns, press.force_n, np.zeros_like(press.force_n)),
        skin=SkinChannel(stamp_ns, press.skin_position_m.astype(np.float32)),
        name=press.name,
    )


def test_the_command_fits_reports_and_goes_on_where_it_was_killed(tmp_path):
    data, sensor, out = tmp_path / "data", tmp_path / "before.yaml", tmp_path / "fitted.yaml"
    presses = [(trajectory(observed(seed).press), replace(BALL, name="ball")) for seed in range(3)]
    write_data_set(data, presses, skin=SKIN_MESH, indenter_step_m=0.6e-3)
    index = data / "dataset.yaml"
    before, _, last = index.read_text().rpartition("indenter: ball")
    index.write_text(f"{before}indenter: bell{last}")
    write_sensor(sensor, SENSOR, "coarse")
    command = ["calibrate", "--data", str(data), "--sensor", str(sensor), "--out", str(out)]
    command += ["--hold-out", "0", "--noise-skin-discretisation-m", "0"]
    command += ["--noise-force-discretisation", "0.01", "--joint-steps", "1"]
    command += ["--workers", "1", "--solves", "12"]
    assert main(command) == 0

    fitted = values_of(load_sensor(out))
    assert fitted.youngs_modulus_pa == pytest.approx(TRUTH.youngs_modulus_pa, rel=0.06)
    assert np.log(0.5 - fitted.poisson_ratio) == pytest.approx(np.log(0.035), abs=0.4)
    report = json.loads((tmp_path / "fitted_report" / "report.json").read_text())
    assert report["most_solves"] <= 12
    assert report["frozen"] == []
    assert [o["name"] for o in report["omissions"]] == ["press_2"]
    assert "holds ball" in report["omissions"][0]["reason"]
    page = (tmp_path / "fitted_report" / "report.html").read_text()
    assert page.count("data:image/png") == len(NAMES) + 2

    files = sorted((tmp_path / "fitted_report" / "run").rglob("*.json"))
    written = {path: path.stat().st_mtime_ns for path in files}
    torn = next(path for path in files if path.parent.name == "single")
    torn.write_text("{")
    assert main(command) == 0
    assert values_of(load_sensor(out)) == fitted
    again = [path for path in files if path.stat().st_mtime_ns != written[path]]
    assert again == [torn]
