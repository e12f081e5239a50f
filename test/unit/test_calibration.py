# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters, losses, statistics and reading of a calibration, without a gel."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from calibration_result import calibration
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from dotsim_ros.calibration.advice import shown_modulus_pa, why_not_identified
from dotsim_ros.calibration.fitting import FitProblem, PressFit, PressLinearisation
from dotsim_ros.calibration.loss import FORCE, POINTS, SKIN, LossNoise, nearest_partners
from dotsim_ros.calibration.loss import residuals as missed
from dotsim_ros.calibration.parameters import (
    chosen_parameters,
    coordinate_bounds,
    coordinates,
    shown_value,
    with_coordinates,
)
from dotsim_ros.calibration.report import figures, summary_lines
from dotsim_ros.calibration.run import check_modulus
from dotsim_ros.calibration.statistics import (
    Combination,
    joint_estimate,
    joint_step,
    median_estimate,
    offset_step,
)
from dotsim_ros.data.presses import Press
from dotsim_ros.data.reading import Observation
from dotsim_ros.data.trajectory import Topics
from dotsim_ros.gel.values import specification_with, values_of
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin, pad_skin
from dotsim_ros.specification import SensorSpecification, load_sensor, write_sensor
from dotsim_ros.twin.follow import SimulatedPress
from dotsim_ros.twin.simulator import offset_pose

Array = NDArray[np.float64]

SENSOR = SensorSpecification()
SKIN_MESH = dome_skin(0.01575, 3e-3)


def problem_of(*names: str, with_offset: bool = False) -> FitProblem:
    return FitProblem(chosen_parameters(names), values_of(SENSOR), LossNoise(), POINTS, with_offset)


def test_parameters_go_by_their_names_and_stay_within_their_bounds(tmp_path):
    values = values_of(SENSOR)
    parameters = chosen_parameters(["E", "nu", "friction", "contact_stiffness", "c30", "thickness"])
    far = with_coordinates(values, parameters, coordinates(parameters, values) + 100.0)
    assert (far.youngs_modulus_pa, far.poisson_ratio, far.friction) == (1e8, 0.2, 3.0)
    (bulk,) = chosen_parameters(["bulk_modulus"])
    assert shown_value(bulk, values) == pytest.approx(3e5 / (3 * (1 - 0.96)))
    for names, said in (
        (["nu", "bulk_modulus"], "one, given E"),
        (["F"], "known are E"),
        ([], "no"),
    ):
        with pytest.raises(ValueError, match=said):
            chosen_parameters(names)
    path = tmp_path / "a.yaml"
    write_sensor(path, specification_with(SENSOR, replace(values, c20_ratio=0.1)), "one\ntwo")
    assert values_of(load_sensor(path)).c20_ratio == pytest.approx(0.1, rel=1e-9)
    assert path.read_text().startswith("# one\n# two\n")


def test_a_law_with_a_second_invariant_is_refused():
    material = replace(
        SENSOR.material, law="mooney_rivlin", c10_pa=1e4, c01_pa=1e4, bulk_modulus_pa=1e6
    )
    with pytest.raises(ValueError, match="neo_hookean or yeoh"):
        values_of(replace(SENSOR, material=material))


def one_frame_press(skin_m: Array, force_n: Array) -> Press:
    return Press(
        "a",
        "sphere",
        [Pose(np.array([0.0, 0.0, 0.0130]))],
        np.array([1.0]),
        skin_m[None],
        force_n[None],
    )


def test_a_shift_is_weighed_by_the_noise_point_to_point():
    noise = LossNoise(skin_discretisation_m=0.0)
    rest = SKIN_MESH.rest_position_m
    press = one_frame_press(rest, np.array([0.0, 0.0, 2.0]))
    simulated = SimulatedPress(
        (rest + np.array([0.0, 0.0, 0.08e-3]))[None], np.array([[0.0, 0.0, 2.12]]), True
    )
    found = missed(press, simulated, noise, SKIN_MESH, None)
    free = np.count_nonzero(~SKIN_MESH.on_base)
    assert np.sum(found[SKIN] ** 2) == pytest.approx(4.0 * free)
    assert found[FORCE] == pytest.approx([0.0, 0.0, 0.12 / np.hypot(0.015, 0.12)])


def test_chamfer_needs_no_order_of_the_points():
    # Points that err together tell no more than one.
    noise = LossNoise(skin_m=1e-9)
    meshes = dome_skin(0.01575, 1e-3), SKIN_MESH
    told = [mesh.vertex_count / noise.skin_point_m(mesh) ** 2 for mesh in meshes]
    assert told[0] == pytest.approx(told[1], rel=0.2)
    rest = SKIN_MESH.rest_position_m
    moved = rest + np.array([0.0, 0.0, 0.2e-3])
    simulated = SimulatedPress(moved[None], np.zeros((1, 3)), True)
    found = []
    for order in (np.arange(len(rest)), np.random.default_rng(0).permutation(len(rest))):
        press = one_frame_press(rest[order], np.zeros(3))
        partners = nearest_partners(press, simulated)
        found.append(np.sum(missed(press, simulated, LossNoise(), SKIN_MESH, partners)[SKIN] ** 2))
    assert found[0] == pytest.approx(found[1])
    expected = len(rest) * (0.2e-3 / LossNoise().skin_point_m(SKIN_MESH)) ** 2
    assert found[0] == pytest.approx(expected)


def test_an_offset_moves_along_the_indenters_axes():
    quarter = Pose(np.array([1.0, 2.0, 3.0]), [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    moved = offset_pose(quarter, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.02]))
    assert moved.position_m == pytest.approx([1.0, 2.1, 3.0])
    turned = quarter.rotation().T @ moved.rotation()
    assert turned[1, 0] == pytest.approx(0.02, rel=1e-3)


def linear_press(
    jacobian: dict[str, Array], residual: dict[str, Array], point: Array
) -> PressLinearisation:
    return PressLinearisation(
        point,
        {c: j.T @ j for c, j in jacobian.items()},
        {c: jacobian[c].T @ residual[c] for c in jacobian},
        {c: 0.5 * float(r @ r) for c, r in residual.items()},
        {c: len(r) for c, r in residual.items()},
        1,
        True,
    )


def test_a_press_own_offset_is_eliminated_as_if_all_were_solved_together():
    problem = problem_of("E", "nu", with_offset=True)
    random = np.random.default_rng(2)
    scale = 1.0 / np.concatenate([[0.3, 0.3], problem.noise.offset()])
    point = problem.centre()
    presses = []
    for _ in range(3):
        jacobian = {SKIN: random.normal(size=(40, 8)) * scale}
        presses.append(linear_press(jacobian, {SKIN: random.normal(size=40)}, point))
    whole = np.zeros((2 + 18, 2 + 18))
    right = np.zeros(2 + 18)
    precision = problem.precision()
    whole[:2, :2] += np.diag(precision[:2])
    for k, press in enumerate(presses):
        rows = [0, 1, *range(2 + 6 * k, 8 + 6 * k)]
        own = np.diag(np.concatenate([[0.0, 0.0], precision[2:]]))
        whole[np.ix_(rows, rows)] += press.information[SKIN] + own
        right[rows] += press.gradient[SKIN]
    expected = -np.linalg.solve(whole, right)
    step = joint_step(problem, presses)
    assert step == pytest.approx(expected[:2], rel=1e-8)
    for k, press in enumerate(presses):
        assert offset_step(problem, press, step) == pytest.approx(
            expected[2 + 6 * k : 8 + 6 * k], rel=1e-6
        )


def test_intervals_of_linear_presses_cover_the_truth_as_often_as_they_say():
    """Presses that each have an error of their own, which no stated noise covers."""
    problem = problem_of("E", "nu")
    random = np.random.default_rng(3)
    truth = problem.centre() + np.array([0.1, -0.3])
    covered = []
    for trial in range(80):
        presses, fits = [], []
        for _ in range(19):
            jacobian = random.normal(size=(12, 2)) * [4.0, 2.0]
            here = truth + random.normal(size=2) * [0.1, 0.2]
            residual = jacobian @ (problem.centre() - here) + random.normal(size=12)
            presses.append(linear_press({FORCE: jacobian}, {FORCE: residual}, problem.centre()))
            alone = np.linalg.lstsq(jacobian, -residual)[0]
            fits.append(PressFit(replace(presses[-1], point=problem.centre() + alone), [], 1, True))
        joint = joint_estimate(problem, presses, replicates=200, seed=trial)
        median = median_estimate(problem, fits, replicates=200, seed=trial)
        covered.append([(c.low <= truth) & (truth <= c.high) for c in (joint, median)])
    share = np.mean(covered, axis=0)
    # 0.95 within four deviations of a share of 80.
    assert np.all(share > 0.85)
    assert np.all(share[0] < 1.0)


def test_the_interval_of_one_press_is_that_of_its_information():
    problem = problem_of("E", "nu")
    random = np.random.default_rng(6)
    jacobian = random.normal(size=(40, 2)) * [4.0, 2.0]
    one = linear_press({FORCE: jacobian}, {FORCE: random.normal(size=40)}, problem.centre())
    covariance = np.linalg.inv(jacobian.T @ jacobian + np.diag(problem.precision()))
    half = 1.96 * np.sqrt(np.diag(covariance))
    fit = PressFit(one, [], 1, True)
    for found in (joint_estimate(problem, [one]), median_estimate(problem, [fit])):
        assert found.high - found.point == pytest.approx(half, rel=1e-3)
        assert found.point - found.low == pytest.approx(half, rel=1e-3)
    # Nor have presses that agree to the bit an interval of no width.
    covariance = np.linalg.inv(3.0 * jacobian.T @ jacobian + np.diag(problem.precision()))
    half = 1.96 * np.sqrt(np.diag(covariance))
    for found in (joint_estimate(problem, [one] * 3), median_estimate(problem, [fit] * 3)):
        assert found.high - found.low == pytest.approx(2.0 * half, rel=1e-3)


def test_forces_show_the_modulus_that_scales_them():
    problem = problem_of("E")
    simulated = np.array([0.5, 1.0, 2.0])
    residual = {FORCE: simulated - 3.0 * simulated}
    press = linear_press({FORCE: simulated[:, None]}, residual, problem.centre())
    start_pa = problem.start.youngs_modulus_pa
    assert shown_modulus_pa(problem, [press, press]) == pytest.approx(3.0 * start_pa)
    assert shown_modulus_pa(problem_of("nu"), [press]) is None
    assert shown_modulus_pa(problem, [replace(press, loss={SKIN: 0.0})]) is None


@pytest.mark.fault("calibrate", "a fit that ends at a Young's modulus that no gel has")
@pytest.mark.parametrize("modulus_pa", [1717.0, 2.9e7])
def test_a_modulus_that_no_gel_has_is_refused(modulus_pa, answered):
    with pytest.raises(ValueError, match=r"expected 2e\+03 to 2e\+07 Pa, as gels have") as refused:
        check_modulus(modulus_pa, "the fit ends at")
    answered(refused.value, what=f"a fit that ends at {modulus_pa:.4g} Pa")
    check_modulus(2.0e5, "the fit ends at")


def test_a_value_at_the_end_of_what_is_searched_is_no_estimate():
    (nu,) = chosen_parameters(["nu"])
    assert nu.bound_of(0.4999) == 0.4999
    assert nu.bound_of(0.47) is None
    at_bound = calibration()
    index = at_bound.asked.index("nu")
    point = at_bound.joint.point.copy()
    point[index] -= 100.0
    low, high = point.copy(), point.copy()
    at_bound = replace(at_bound, joint=Combination(point, low, high))
    shown = figures(at_bound, seed=0)["parameters"]["nu"]["joint"]
    assert shown["at_bound"]
    assert shown["low"] == shown["high"]
    text = "\n".join(summary_lines(at_bound))
    assert "nu (joint): 0.4999, the end of what is searched and no estimate\n" in text


DEEP, SHALLOW = 0.0130, 0.0152


def observed_press(
    height_m: float, *, slide_m: float = 0.0, force_n: float | None = 2.0, has_skin: bool = True
) -> Observation:
    poses = [
        Pose(np.array([0.0, 0.0, 0.0160])),
        Pose(np.array([0.0, 0.0, height_m])),
        Pose(np.array([slide_m, 0.0, height_m])),
    ]
    load = None if force_n is None else np.array([[0.0, 0.0, 0.0], *[[0.0, 0.0, force_n]] * 2])
    skin = np.repeat(SKIN_MESH.rest_position_m[None], 3, axis=0) if has_skin else None
    return Observation(Press("a", "ball", poses, np.arange(3.0), skin, load), sphere(0.004))


@pytest.mark.fault("calibrate", "data that do not identify what is asked for")
def test_each_reason_why_data_identify_nothing_has_its_own_words(answered):
    deep, both = observed_press(DEEP), (POINTS, FORCE)
    cases = {
        "E without force": ("E", observed_press(DEEP, force_n=None), both, "--wrench-topic"),
        "E with --loss points": ("E", deep, (POINTS,), "--loss leaves out"),
        "E with forces of noise": ("E", observed_press(SHALLOW, force_n=0.02), both, "hardly more"),
        "E with a force of large error": ("E", deep, both, "error of the force"),
        "E with a start that is far away": ("E", deep, both, r"some 4e\+03 Pa, and the fit begins"),
        "nu with shallow presses": ("nu", observed_press(SHALLOW), both, r"goes 0\.\d+ mm into"),
        "friction without a slide": ("friction", deep, both, r"slides more than 0\.00 mm"),
        "c20 without a skin": ("c20", observed_press(DEEP, has_skin=False), both, "in the skin"),
        "friction with too few slides": (
            *("friction", observed_press(DEEP, slide_m=2e-3)),
            *(both, "1 presses with the stated"),
        ),
    }
    said = set()
    for what, (name, observation, losses, words) in cases.items():
        found = why_not_identified(
            problem_of(name),
            [name],
            [observation],
            SKIN_MESH,
            losses=losses,
            topics=Topics(),
            shown_pa=4.0e3 if "far" in what else 2.0e5,
        )[name]
        assert re.search(words, found), what
        said.add(found)
        answered(f"{name}: {found}", what=what)
    assert len(said) == len(cases)
    # A press next to the middle of a pad goes no way along its skin, unless it slides there.
    pad = pad_skin((0.02, 0.016, 0.004), 1e-3)
    for slide_m, words in ((0.0, "no press slides more than 0.00 mm"), (1e-3, "leave it open")):
        places = ((7e-3, 4.2e-3), (7e-3, 2.0e-3), (7e-3 + slide_m, 2.0e-3))
        way = [Pose(np.array([x, 5e-3, z])) for x, z in places]
        measured = np.repeat(pad.rest_position_m[None], 3, axis=0)
        press = Observation(Press("a", "ball", way, np.arange(3.0), measured), sphere(0.004))
        given = {"losses": (POINTS,), "topics": Topics()}
        found = why_not_identified(problem_of("friction"), ["friction"], [press], pad, **given)
        assert words in found["friction"]


def test_a_joint_step_ends_at_the_bounds_and_the_others_go_where_that_leaves_them():
    problem = problem_of("E", "c20", "c30")
    random = np.random.default_rng(4)
    here = problem.centre()
    truth = here + np.array([0.3, 0.1, -0.2])
    presses = []
    for _ in range(5):
        # Each parameter makes the same force stiffer: what one may not do the others take over.
        jacobian = 20.0 * (random.normal(size=(30, 1)) + 0.3 * random.normal(size=(30, 3)))
        residual = jacobian @ (here - truth) + random.normal(size=30)
        presses.append(linear_press({FORCE: jacobian}, {FORCE: residual}, here))
    low, high = coordinate_bounds(problem.parameters)
    information = sum(press.total()[0] for press in presses)
    gradient = sum(press.total()[1] for press in presses)
    root = np.linalg.cholesky(information + np.diag(problem.precision())).T
    target = -np.linalg.solve(root.T, gradient)
    expected = lsq_linear(root, target, bounds=(low - here, high - here), tol=1e-14).x

    step = joint_step(problem, presses)
    assert step == pytest.approx(expected, rel=1e-6)
    found = joint_estimate(problem, presses, replicates=200)
    assert found.point[2] == -0.1
    assert found.point == pytest.approx(here + expected, rel=1e-6)
    assert np.all((found.low < found.point) & (found.point < found.high))


def test_quadratics_about_different_points_combine_as_about_one():
    problem = problem_of("E", "nu")
    random = np.random.default_rng(5)
    here = problem.centre()
    together, apart = [], []
    for _ in range(6):
        jacobian, residual = random.normal(size=(12, 2)) * [4.0, 2.0], random.normal(size=12)
        together.append(linear_press({FORCE: jacobian}, {FORCE: residual}, here))
        away = 0.1 * random.normal(size=2)
        apart.append(
            linear_press({FORCE: jacobian}, {FORCE: residual + jacobian @ away}, here + away)
        )
    expected = joint_estimate(problem, together, replicates=200)
    found = joint_estimate(problem, apart, replicates=200)
    assert found.point == pytest.approx(expected.point, rel=1e-9)
    assert found.low == pytest.approx(expected.low, rel=1e-9)
