# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The environments for learning: Gymnasium's rules, repeatable episodes, and bad actions."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import dotsim_ros.control.environments  # noqa: F401
from dotsim_ros.control.environments.ball import (
    LARGEST_SPEED_M_S,
    FollowEnvironment,
    PressEnvironment,
)
from dotsim_ros.control.environments.box_yaw import MOVES, BoxYawEnvironment, BoxYawTask
from dotsim_ros.control.policy.paths import Expert
from dotsim_ros.specification import load_sensor


@pytest.fixture(scope="module")
def environment() -> BoxYawEnvironment:
    return BoxYawEnvironment(observation="depth", image_size_px=(32, 24), render_mode="rgb_array")


def tangential(environment: BoxYawEnvironment) -> np.int64:
    """Return the move that best follows a circle around the box, to the left."""
    x, y = environment.data.mocap_pos[0, :2]
    lengths = np.maximum(np.linalg.norm(MOVES, axis=1), 0.1)
    return np.int64(np.argmax(MOVES @ np.array([-y, x]) / lengths))


@pytest.mark.parametrize("name", ["DenseTactPress-v0", "DenseTactBoxYaw-v0"])
def test_gymnasium_finds_nothing_wrong(name: str) -> None:
    made = gymnasium.make(name, observation="image", image_size_px=(32, 32))
    check_env(made.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("kind", ["image", "depth", "skin", "wrench"])
def test_every_observation_is_in_its_space(kind: str) -> None:
    environment = BoxYawEnvironment(observation=kind, image_size_px=(48, 48))
    seen, _ = environment.reset(seed=0)
    touched, *_ = environment.step(np.int64(3))
    for found in (seen, touched):
        assert environment.observation_space.contains(found)
    assert not np.array_equal(seen, touched)


def test_the_box_turns_where_the_finger_goes_around_it(environment: BoxYawEnvironment) -> None:
    environment.reset(seed=1)
    total, there, ended = 0.0, False, False
    while not ended:
        _, reward, there, late, info = environment.step(tangential(environment))
        total, ended = total + reward, there or late
    assert there
    assert info["is_success"]
    assert info["yaw_deg"] == pytest.approx(10.0, abs=2.0)
    assert total > 1.5


def test_staying_costs_and_turns_nothing(environment: BoxYawEnvironment) -> None:
    _, before = environment.reset(seed=1)
    rewards = [environment.step(np.int64(0))[1] for _ in range(4)]
    assert np.mean(rewards) == pytest.approx(-environment.task.idle_penalty, abs=0.02)
    assert abs(np.rad2deg(environment.yaw_rad) - before["yaw_deg"]) < 0.5


def test_the_side_decides_which_way_turns_the_box(environment: BoxYawEnvironment) -> None:
    yaws = {}
    for seed in range(4):
        environment.reset(seed=seed)
        side = float(np.sign(environment.data.mocap_pos[0, 0]))
        before_rad = environment.yaw_rad
        for _ in range(3):
            environment.step(np.int64(3))
        yaws.setdefault(side, []).append(environment.yaw_rad - before_rad)
    assert min(yaws[1.0]) > 0.02
    assert max(yaws[-1.0]) < -0.02


def test_an_episode_that_cannot_be_won_is_given_up(environment: BoxYawEnvironment) -> None:
    environment.reset(seed=0)
    outward = np.int64(2 if environment.data.mocap_pos[0, 0] > 0.0 else 1)
    late = False
    while not late:
        _, _, there, late, info = environment.step(outward)
        assert not there
    assert info["reason"] == "the sensor has left the box"


def test_one_seed_gives_one_episode(environment: BoxYawEnvironment) -> None:
    episodes = []
    for seed in (3, 3, 4):
        seen = [environment.reset(seed=seed)[0]]
        seen += [environment.step(np.int64(action))[0] for action in (1, 6, 4)]
        episodes.append(np.stack(seen))
    assert np.array_equal(episodes[0], episodes[1])
    assert not np.array_equal(episodes[0], episodes[2])


def test_an_impossible_action_moves_nothing(environment: BoxYawEnvironment) -> None:
    environment.reset(seed=0)
    before = environment.data.qpos.copy(), environment.data.mocap_pos.copy()
    for action in (np.nan, 9, -1, np.array([0.5])):
        with pytest.raises(ValueError, match="expected a whole number from 0 to 8"):
            environment.step(action)  # type: ignore[arg-type]
    assert np.array_equal(environment.data.qpos, before[0])
    assert np.array_equal(environment.data.mocap_pos, before[1])


def test_a_box_pushed_through_the_gel_ends_the_episode_with_the_reason() -> None:
    environment = BoxYawEnvironment(observation="wrench", task=BoxYawTask(speed_m_s=0.0))
    environment.reset(seed=0)
    environment.data.mocap_pos[0, 2] -= 12.0e-3
    _, _, there, truncated, info = environment.step(np.int64(0))
    assert truncated
    assert not there
    assert "press less deep" in info["reason"]
    environment.reset(seed=0)


def test_what_an_environment_cannot_do_is_refused() -> None:
    with pytest.raises(gymnasium.error.ResetNeeded):
        BoxYawEnvironment(observation="wrench").step(np.int64(0))
    for wrong, reason in (
        ({"observation": "touch"}, "expected one of image, depth, skin, wrench"),
        ({"image_size_px": (8, 64)}, "at least 16 pixels"),
        ({"force_n": 0.0}, "less than 10 N"),
        ({"duration_s": 0.01}, "expected at least 0.04 s"),
    ):
        with pytest.raises(ValueError, match=reason):
            PressEnvironment(**wrong)


@pytest.mark.parametrize("sensor", ["densetact2", "digit"])
def test_the_expert_follows_its_path(sensor: str) -> None:
    environment = FollowEnvironment(observation="wrench", duration_s=1.2, sensor=sensor)
    expert = Expert(environment.path, look_ahead_s=0.0)
    environment.reset(seed=0)
    ended, total = False, 0.0
    while not ended:
        velocity = expert.relative_velocity_m_s(environment.position_m)
        _, reward, fell, late, info = environment.step(
            (velocity / LARGEST_SPEED_M_S).astype(np.float32)
        )
        total, ended = total + reward, fell or late
    assert not fell
    assert info["distance_m"] < 0.2e-3
    assert info["laps"] > 0.09
    assert total > 12.0


def test_a_ball_that_is_sent_nowhere_stays() -> None:
    environment = PressEnvironment(observation="wrench")
    environment.reset(seed=0)
    before = environment.position_m.copy()
    wrong: list[Any] = [
        np.full(3, np.nan),
        np.zeros(2),
        np.zeros((1, 3)),
        np.float32([1.5, 0, -3]),
        [0.0, -1.0 - 1e-5, 0.0],
        {"velocity": 1.0},
    ]
    for action in wrong:
        with pytest.raises(ValueError, match="expected three finite numbers from -1 to 1"):
            environment.step(action)
    assert np.array_equal(environment.position_m, before)
    # Rounding is no fault: it is the largest speed.
    environment.step(np.array([1.0 + 1e-7, 0.0, 0.0]))
    assert environment.position_m - before == pytest.approx([0.32e-3, 0.0, 0.0], abs=1e-12)


@pytest.mark.fault("environments", "an action of 1.5 in one of two worlds")
@pytest.mark.parametrize("mode", ["sync", "async"])
def test_worlds_give_the_same_as_one_and_refuse_what_it_refuses(
    mode: str, answered: Callable[..., None]
) -> None:
    options = {"observation": "wrench"}
    together = gymnasium.make_vec(
        "DenseTactPress-v0", num_envs=2, vectorization_mode=mode, **options
    )
    moves = np.float32([[0, 0, -0.5], [0.2, 0, -0.5]])
    try:
        first, _ = together.reset(seed=[5, 6])
        second, *_ = together.step(moves)
        with pytest.raises(ValueError, match="expected three finite numbers from -1") as refused:
            together.step(np.float32([[0, 0, 0], [0, 0, 1.5]]))
    finally:
        together.close()
    answered(str(refused.value))
    alone = gymnasium.make("DenseTactPress-v0", **options)
    for index, seed in enumerate((5, 6)):
        assert np.array_equal(alone.reset(seed=seed)[0], first[index])
        assert np.array_equal(alone.step(moves[index])[0], second[index])


@pytest.mark.parametrize("sensor", ["densetact2", "gelsight_mini"])
def test_a_press_begins_half_a_millimetre_above_the_skin_and_reaches_its_force(sensor: str) -> None:
    environment = PressEnvironment(observation="wrench", sensor=sensor)
    for seed in range(3):
        environment.reset(seed=seed)
        skin_m = environment.gel.skin_position_m - environment.position_m  # type: ignore[union-attr]
        above_m = environment.sensor.indenter.signed_distance(skin_m).min()
        assert above_m == pytest.approx(0.5e-3, abs=0.03e-3)
    there, late, total = False, False, 0.0
    while not (there or late):
        lacking = 1.0 - environment.force_n()
        _, reward, there, late, info = environment.step(np.array([0.0, 0.0, -0.5 * lacking]))
        total += reward
    assert there
    assert info["is_success"]
    assert info["force_n"] == pytest.approx(1.0, rel=0.1)
    assert total == pytest.approx(2.0, abs=0.15)


def test_a_pad_comes_down_on_the_box_and_turns_it() -> None:
    environment = BoxYawEnvironment(observation="wrench", sensor="digit")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        environment.reset(seed=0)
    apex_m = float(environment.data.mocap_pos[0, 2] - environment.sensor.skin.apex_m[2])
    depth_m = 2.0 * environment.task.half_height_m - apex_m
    least_m, largest_m = environment.task.depth_m
    assert least_m <= depth_m <= largest_m
    ended = False
    while not ended:
        _, _, there, late, info = environment.step(tangential(environment))
        ended = there or late
    assert there
    assert info["yaw_deg"] == pytest.approx(10.0, abs=2.0)


def test_a_path_that_is_too_deep_for_a_thin_pad_is_refused() -> None:
    pad = load_sensor("digit")
    gel = replace(
        pad.gel, shape="flat_pad", face_radius_m=(0.0, 0.0), pad_size_m=(0.012, 0.012, 0.002)
    )
    thin = replace(pad, gel=gel, solver=replace(pad.solver, grid_spacing_m=0.001, refined=False))
    with pytest.raises(ValueError, match="path 'line' is too deep for the gel of 'digit'"):
        FollowEnvironment(observation="wrench", sensor=thin, path="line")


def test_a_ball_pushed_through_the_gel_ends_the_episode_with_the_reason() -> None:
    environment = PressEnvironment(observation="wrench", duration_s=10.0)
    environment.reset(seed=0)
    inward = -environment.position_m / np.linalg.norm(environment.position_m)
    truncated = False
    while not truncated:
        _, _, _, truncated, info = environment.step(inward.astype(np.float32))
    assert "press less deep" in info["reason"]


def test_many_presses_at_once_are_those_of_one_world_each():
    pytest.importorskip("torch")
    from dotsim_ros.control.environments.press_array import PressArray

    solver = load_sensor("densetact2").solver
    together = PressArray(2, force_n=0.3, duration_s=0.2)
    alone = PressEnvironment(observation="depth", force_n=0.3, duration_s=0.2, solver=solver)
    seen, _ = together.reset(seed=3)
    assert seen.shape == (2, 64, 64, 4)
    assert together.observation_space.contains(seen)
    alone.reset(seed=4)
    down = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, -1.0]], dtype=np.float32)
    for number in range(5):
        seen, reward, terminated, truncated, info = together.step(down)
        _, right, _, late, told = alone.step(down[1])
        assert info["force_n"][1] == pytest.approx(told["force_n"], rel=0.05, abs=0.01)
        assert reward[1] == pytest.approx(right, abs=0.05)
        assert truncated.tolist() == [late, late] == [number == 4] * 2
    assert info["force_n"][0] == 0.0
    assert info["force_n"][1] > 0.3
    # The next step begins new episodes, whatever the action, with gels at rest.
    _, reward, terminated, truncated, info = together.step(down)
    assert not (terminated | truncated | reward.astype(bool) | info["force_n"].astype(bool)).any()
    with pytest.raises(ValueError, match=r"expected \(2, 3\) finite numbers"):
        together.step(np.full((2, 3), np.nan, dtype=np.float32))
