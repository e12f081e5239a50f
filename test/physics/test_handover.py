# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A profile is changed during a slide: the skin goes on from where it is."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dotsim_ros.gel.implicit.handover import SkinJumpError
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.tactile_sim.active_profile import (
    ActiveProfile,
    ProfileKeeper,
    Rung,
    ladder_of,
    make_active_profile,
)
from dotsim_ros.nodes.tactile_sim.motion import MotionOrder
from dotsim_ros.nodes.tactile_sim.profiles import FAST, REALTIME, solver_of
from dotsim_ros.nodes.tactile_sim.session import SensorSession
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import load_sensor

DEPTH_M, STEP_M = 1.2e-3, 0.3e-3


def slide_poses(top_m: float) -> list[Pose]:
    down = [(0.0, depth) for depth in np.arange(STEP_M, DEPTH_M + 1e-6, STEP_M)]
    along = [(x, DEPTH_M) for x in np.arange(STEP_M, 8.5 * STEP_M, STEP_M)]
    return [Pose(np.array([x, 0.0, top_m - depth])) for x, depth in (*down, *along)]


@pytest.fixture(scope="module")
def sensor() -> TactileSensor:
    specification = load_sensor("densetact2")
    made = TactileSensor(
        replace(specification, solver=solver_of(REALTIME, specification)),
        indenter=load_indenter("sphere_4mm"),
    )
    made.prepare_solver(solver_of(FAST, specification))
    return made


@pytest.fixture
def rungs(sensor: TactileSensor) -> dict[str, Rung]:
    own = load_sensor("densetact2")
    sensor.reset()
    sensor.set_solver(solver_of(REALTIME, own))
    return {rung.profile.name: rung for rung in ladder_of("auto", own)}


def test_a_change_in_a_slide_moves_the_skin_less_than_is_documented(
    sensor: TactileSensor, rungs: dict[str, Rung]
) -> None:
    poses = slide_poses(float(sensor.skin.apex_m[2]))
    names = ["fast", "realtime"]
    for pose in poses:
        before_m = sensor.press(pose).skin_position_m
        name = names[0]
        names.reverse()
        told_m = sensor.set_solver(rungs[name].solver)
        after = sensor.press(pose)
        jump_m = np.linalg.norm(after.skin_position_m - before_m, axis=1).max()
        assert told_m < FAST.skin_error_m
        assert jump_m < FAST.skin_error_m


def test_the_friction_of_a_slide_is_carried_not_lost(
    sensor: TactileSensor, rungs: dict[str, Rung]
) -> None:
    poses = slide_poses(float(sensor.skin.apex_m[2]))
    for pose in poses:
        before = sensor.press(pose)
    told_m = sensor.set_solver(rungs["fast"].solver)
    after = sensor.press(poses[-1])
    sensor.reset()
    again = sensor.press(poses[-1])
    anew_m = np.linalg.norm(again.skin_position_m - before.skin_position_m, axis=1).max()
    assert told_m < 0.3 * anew_m
    # Along the slide the gel pulls the indenter back.
    assert before.wrench.force_n[0] < -0.1
    assert after.wrench.force_n[0] == pytest.approx(before.wrench.force_n[0], rel=0.15)


def test_a_jump_that_is_too_far_is_refused_and_the_slide_goes_on_as_without_it(
    sensor: TactileSensor, rungs: dict[str, Rung]
) -> None:
    poses = slide_poses(float(sensor.skin.apex_m[2]))
    undisturbed = [sensor.press(pose).skin_position_m for pose in poses]
    sensor.reset()
    for pose, expected_m in zip(poses, undisturbed, strict=True):
        assert np.array_equal(sensor.press(pose).skin_position_m, expected_m)
        if pose is poses[5]:
            with pytest.raises(SkinJumpError, match="expected at most 0"):
                sensor.set_solver(rungs["fast"].solver, largest_jump_m=1e-9)


def test_a_changed_solver_at_rest_is_that_of_a_fresh_sensor(
    sensor: TactileSensor, rungs: dict[str, Rung]
) -> None:
    pose = slide_poses(float(sensor.skin.apex_m[2]))[3]
    sensor.press(pose)
    # On one grid nothing jumps even in a press.
    assert sensor.set_solver(rungs["exact"].solver) == 0.0
    sensor.press(None)
    assert sensor.set_solver(rungs["fast"].solver) == 0.0
    sensor.reset()
    used = sensor.press(pose)
    fresh = TactileSensor(
        replace(load_sensor("densetact2"), solver=rungs["fast"].solver),
        indenter=load_indenter("sphere_4mm"),
    ).press(pose)
    assert np.array_equal(used.skin_position_m, fresh.skin_position_m)


def test_another_indenter_is_that_of_all_solvers(
    sensor: TactileSensor, rungs: dict[str, Rung]
) -> None:
    ball = sensor.indenter
    try:
        sensor.set_indenter(load_indenter("box_edge"))
        poses = slide_poses(float(sensor.skin.apex_m[2]))
        before = sensor.press(poses[3])
        sensor.set_solver(rungs["fast"].solver)
        after = sensor.press(poses[3])
        assert after.wrench.force_n[2] == pytest.approx(before.wrench.force_n[2], rel=0.2)
    finally:
        sensor.set_indenter(ball)


def test_a_gel_that_relaxes_cannot_change_its_solver() -> None:
    own = load_sensor("densetact2")
    relaxing = replace(
        own,
        material=replace(own.material, prony_shares=(0.2,), prony_times_s=(0.1,)),
        solver=replace(own.solver, grid_spacing_m=0.0048, refined=False),
    )
    sensor = TactileSensor(relaxing, indenter=load_indenter("sphere_4mm"))
    with pytest.raises(ValueError, match="what it remembers would be lost"):
        sensor.set_solver(replace(relaxing.solver, iterations=2))


def test_auto_changes_a_session_and_tells(sensor: TactileSensor, rungs: dict[str, Rung]) -> None:
    said: list[str] = []
    session = SensorSession(sensor, first_dt_s=0.04, limit_m=REALTIME.move_m)
    ladder = [rungs["realtime"], rungs["fast"]]
    keeper = ProfileKeeper({"realtime": 0.02, "fast": 0.01}, period_s=0.04)
    profile = ActiveProfile(ladder, session, keeper=keeper, why="", report=said.append)
    skins = []
    for number, pose in enumerate(slide_poses(float(sensor.skin.apex_m[2]))):
        session.follow(MotionOrder(pose, 40_000_000 * (number + 1), None))
        skins.append(session.moment.gel.skin_position_m)
        # Begun long ago: each frame misses its deadline.
        profile.end_frame(-1e6, period_s=0.04)
    assert profile.name == "fast"
    values = profile.values()
    assert (values["profile"], values["profile_changes"]) == ("fast", "1")
    assert float(values["profile_largest_jump_mm"]) < 1e3 * FAST.skin_error_m
    assert len(said) == 1
    assert said[0].startswith("profile realtime -> fast: 3 of 3 frames took more than 40 ms")
    steps_m = [np.linalg.norm(after - before, axis=1).max() for before, after in pairwise(skins)]
    assert max(steps_m) < FAST.skin_error_m + STEP_M


def test_auto_makes_and_times_its_profiles(sensor: TactileSensor, rungs: dict[str, Rung]) -> None:
    said: list[str] = []
    sensor.set_solver(rungs["exact"].solver)
    session = SensorSession(sensor, first_dt_s=0.04, limit_m=np.inf)
    profile = make_active_profile(
        list(rungs.values()), sensor, session, asked="auto", period_s=10.0, report=said.append
    )
    assert profile.name == "exact"
    assert not session.is_touched()
    assert sensor.specification.solver == rungs["exact"].solver
    assert "made and timed in" in said[0]
    hurried = make_active_profile(
        list(rungs.values()), sensor, session, asked="auto", period_s=1e-6, report=said.append
    )
    assert hurried.name == "fast"
    assert sensor.specification.solver == rungs["fast"].solver
