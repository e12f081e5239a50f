# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated arm: late, lagging and limited, whoever looks at it and whenever."""

import numpy as np
import pytest

from dotsim_ros.control.arm.command import ToolLimits
from dotsim_ros.control.arm.kinematics import ArmKinematics
from dotsim_ros.control.arm.simulated import STEP_S, ArmFaults, ArmResponse, SimulatedArm
from dotsim_ros.geometry.pose import Pose

START_S = 1000.0
DOWN = np.array([1.0, 0.0, 0.0, 0.0])
START_POSE = Pose(np.array([0.35, 0.0, 0.3]), DOWN)
QUIET = ArmResponse(jitter_s=0.0)


START_JOINTS_RAD = ArmKinematics().joints_at(START_POSE)


def new_arm(*, limits=None, response=QUIET, seed=0):
    kinematics = ArmKinematics()
    joints = kinematics.posture_rad = START_JOINTS_RAD
    return SimulatedArm(
        kinematics,
        joints,
        limits=limits or ToolLimits(1.0, 3.14, 50.0, 20.0),
        response=response,
        start_s=START_S,
        seed=seed,
    )


def along(x=0.0, y=0.0, z=0.0, turn=0.0):
    return np.array([x, y, z, 0.0, 0.0, turn])


def record(arm, duration_s, command=None, *, begin_s=START_S, period_s=0.01, along_tool=False):
    """Return the states of each step while a command of the time since the start is repeated."""
    states, next_s = [arm.advance(begin_s)], begin_s
    for index in range(1, round(duration_s / STEP_S) + 1):
        now_s = begin_s + index * STEP_S
        if command is not None and now_s >= next_s:
            arm.command(np.array(command(now_s - begin_s)), now_s, along_tool=along_tool)
            next_s += period_s
        states.append(arm.advance(now_s))
    return states


def positions(states):
    return np.array([state.pose.position_m for state in states])


def speeds(states):
    return np.linalg.norm(np.diff(positions(states), axis=0), axis=1) / STEP_S


def test_a_velocity_is_followed_after_latency_and_lag():
    arm = new_arm()
    arm.command(along(x=0.05), START_S, along_tool=False)
    states = record(arm, 0.19)
    times = np.array([state.time_s for state in states]) - START_S
    speed = np.array([state.twist[0] for state in states])
    assert (speed[times < 0.01] == 0.0).all()
    # First order from the latency on, by the grid: 63 % after one time constant.
    expected = 0.05 * (1.0 - np.exp(-(times - 0.01) / 0.02))
    late = times > 0.011
    np.testing.assert_allclose(speed[late], expected[late], atol=1e-9)
    np.testing.assert_allclose(positions(states)[:, 1:] - [0.0, 0.3], 0.0, atol=1e-6)


def test_a_velocity_along_the_tool_turns_with_it():
    arm = new_arm()
    # The tool points down: its +z is the base's -z, its +y the base's -y.
    states = record(arm, 1.0, lambda _: along(y=0.05, z=0.02, turn=1.0), along_tool=True)
    moved = states[-1].pose.position_m - START_POSE.position_m
    assert moved[2] == pytest.approx(-0.02 * 0.97, rel=0.05)
    base = new_arm()
    others = record(base, 1.0, lambda _: along(y=-0.05, z=-0.02, turn=-1.0))
    assert others[-1].pose.position_m[2] == pytest.approx(states[-1].pose.position_m[2], abs=1e-6)
    # It turned by one radian: the way bends.
    assert abs(moved[0]) > 0.01
    assert others[-1].pose.position_m[0] == pytest.approx(START_POSE.position_m[0], abs=1e-6)
    np.testing.assert_allclose(others[-1].pose.rotation(), states[-1].pose.rotation(), atol=1e-6)


def test_the_motion_does_not_depend_on_who_looks_and_when():
    def moved(looks_s):
        arm = new_arm(response=ArmResponse(), seed=3)
        looks = list(looks_s)
        for index in range(100):
            now_s = START_S + 0.0137 * index
            while looks and looks[0] <= now_s:
                arm.advance(looks.pop(0))
            arm.command(along(0.1 * np.cos(index), 0.1 * np.sin(index)), now_s, along_tool=True)
        return arm.advance(START_S + 2.0)

    regular = moved(START_S + 0.01 * np.arange(200))
    late = moved(START_S + np.cumsum(np.random.default_rng(1).uniform(0.0, 0.2, 20)))
    blind = moved([])
    for other in (late, blind):
        assert (other.joints_rad == regular.joints_rad).all()
        assert (other.twist == regular.twist).all()
    assert np.linalg.norm(regular.pose.position_m - START_POSE.position_m) > 1e-3


def test_jitter_is_of_its_seed_and_keeps_the_order():
    def way(seed):
        arm = new_arm(response=ArmResponse(jitter_s=0.02), seed=seed)
        return positions(record(arm, 0.5, lambda t: along(x=0.1 * np.sin(20.0 * t))))

    assert (way(1) == way(1)).all()
    assert (way(1) != way(2)).any()
    arm = new_arm(response=ArmResponse(jitter_s=0.02), seed=1)
    for index in range(40):
        now_s = START_S + 0.001 * index
        arm.command(along(x=0.05 if index < 39 else 0.0), now_s, along_tool=False)
    # The last one said to stand; had one overtaken it, the arm would go on until it is stale.
    states = record(arm, 0.2)
    assert speeds(states)[-1] < 1e-3


def accelerations(states):
    velocity = np.diff(positions(states), axis=0) / STEP_S
    return np.linalg.norm(np.diff(velocity, axis=0), axis=1) / STEP_S


@pytest.mark.parametrize(("asked_m_s", "turn_rad_s"), [(0.5, 0.5), (30.0, 0.0)])
def test_speed_and_acceleration_keep_their_limits_on_the_recorded_motion(asked_m_s, turn_rad_s):
    limits = ToolLimits(0.25, 0.5, 2.0, 4.0)
    arm = new_arm(limits=limits)
    generator = np.random.default_rng(7)

    def wild(_):
        return np.append(
            asked_m_s * generator.normal(size=3), turn_rad_s * generator.normal(size=3)
        )

    states = record(arm, 1.5, wild, period_s=0.04)
    assert speeds(states).max() <= 0.25 * (1.0 + 1e-3)
    assert accelerations(states).max() <= 2.0 * 1.01
    assert accelerations(states).max() > 1.5
    angular = np.array([state.twist[3:] for state in states])
    assert np.linalg.norm(angular, axis=1).max() <= 0.5 * (1.0 + 1e-6)
    turned = np.linalg.norm(np.diff(angular, axis=0), axis=1) / STEP_S
    assert turned.max() <= 4.0 * 1.01


def test_speeds_hold_where_joints_and_singularities_hinder():
    # Wild turns and a drift outwards: joints at their limits and the arm stretched.
    limits = ToolLimits(0.25, 1.0, 2.0, 5.0)
    arm = new_arm(limits=limits)
    generator = np.random.default_rng(0)
    ways = np.repeat(generator.normal(size=(10, 6)), 100, axis=0)
    ways[:, 0] += 1.0
    states = record(arm, 9.9, lambda t: ways[int(100 * t)])
    assert speeds(states).max() <= 0.25 * 1.005
    angular = np.array([state.twist[3:] for state in states])
    assert np.linalg.norm(angular, axis=1).max() <= 1.0 + 1e-9
    assert np.abs([state.motion.rates_rad_s for state in states]).max() <= 4.0 + 1e-9
    assert any(state.motion.at_limit or state.motion.smallest_m < 0.04 for state in states)
    # Only there does the arm brake harder than it may, and hardly ever.
    assert (accelerations(states) > 2.0 * 1.02).mean() < 0.03


def test_at_full_stretch_the_arm_slows_down_and_keeps_every_limit():
    limits = ToolLimits(0.5, 3.14, 5.0, 20.0)
    arm = new_arm(limits=limits)
    states = record(arm, 3.0, lambda _: along(x=0.5, y=0.1))
    assert speeds(states)[60:120].max() > 0.4
    assert speeds(states)[-1] < 0.02
    assert states[-1].motion.smallest_m < 1e-3
    assert (accelerations(states) > 5.0 * 1.02).mean() < 0.01
    assert np.abs([state.motion.rates_rad_s for state in states]).max() <= 4.0 + 1e-9


def test_no_joint_leaves_its_limits():
    arm = new_arm()
    kinematics = ArmKinematics()
    states = record(arm, 6.0, lambda _: np.array([0.0, 0.0, 0.0, 0.0, 0.0, 3.0]))
    states += record(arm, 4.0, lambda _: along(x=-0.5, z=-0.3), begin_s=states[-1].time_s + STEP_S)
    joints = np.array([state.joints_rad for state in states])
    assert (joints >= kinematics.lower_rad - 1e-12).all()
    assert (joints <= kinematics.upper_rad + 1e-12).all()
    assert any(state.motion.at_limit for state in states)
    assert np.abs([state.motion.rates_rad_s for state in states]).max() <= 4.0 + 1e-9


def test_a_command_that_is_not_repeated_is_stale_after_a_fifth_of_a_second():
    arm = new_arm()
    arm.command(along(x=0.1), START_S, along_tool=False)
    states = record(arm, 0.5)
    times = np.array([state.time_s for state in states[1:]]) - START_S
    moving = speeds(states) > 0.09
    assert moving[(times > 0.1) & (times < 0.21)].all()
    # Latency, 0.2 s, then the lag.
    assert (speeds(states)[times > 0.21 + 0.1] < 1e-3).all()
    assert arm.is_stale()
    assert states[-1].twist.any() == np.False_


@pytest.mark.parametrize("is_emergency", [True, False])
def test_a_stop_brakes_without_lag_and_holds_until_it_is_taken_back(is_emergency):
    arm = new_arm(limits=ToolLimits(1.0, 3.14, 5.0, 20.0))
    stop_s = record(arm, 0.5, lambda _: along(x=0.2))[-1].time_s
    if is_emergency:
        arm.emergency_stop(stop_s)
    else:
        arm.fail(ArmFaults(fail_stop=True), stop_s)
    after = record(arm, 0.5, lambda _: along(x=0.2), begin_s=stop_s)
    times = np.array([state.time_s for state in after[1:]]) - stop_s
    # 0.2 m/s at 5 m/s^2: 40 ms, and one step of the grid.
    assert (speeds(after)[times > 0.04 + 2 * STEP_S] == 0.0).all()
    assert arm.is_emergency == is_emergency
    assert arm.feedback(after[-1].time_s) is not None
    if is_emergency:
        arm.reset(after[-1].time_s)
        np.testing.assert_allclose(arm.state.pose.position_m, START_POSE.position_m, atol=1e-5)
    else:
        arm.fail(ArmFaults(), after[-1].time_s)
    again = record(arm, 0.3, lambda _: along(x=0.2), begin_s=after[-1].time_s)
    assert speeds(again)[-1] == pytest.approx(0.2, rel=1e-2)


def test_a_velocity_that_is_no_number_stops_the_arm():
    arm = new_arm()
    states = record(arm, 0.3, lambda _: along(x=0.1))
    now_s = states[-1].time_s
    with pytest.raises(ValueError, match="not finite"):
        arm.command(along(x=np.nan), now_s, along_tool=False)
    after = record(arm, 0.15, begin_s=now_s)
    assert speeds(after)[-1] < 1e-3
    assert np.isfinite(positions(after)).all()


def test_dropped_feedback_is_none_and_the_arm_moves_on():
    arm = new_arm()
    states = record(arm, 0.2, lambda _: along(x=0.1))
    now_s = states[-1].time_s
    arm.fail(ArmFaults(fail_drop_feedback=True), now_s)
    assert arm.feedback(now_s + 0.1) is None
    arm.fail(ArmFaults(), now_s + 0.1)
    heard = arm.feedback(now_s + 0.1)
    assert heard.time_s == pytest.approx(now_s + 0.1)
    assert heard.pose.position_m[0] > states[-1].pose.position_m[0] + 0.005


def test_a_delay_holds_commands_and_feedback_back():
    arm = new_arm()
    record(arm, 0.2)
    arm.fail(ArmFaults(fail_delay_s=0.15), START_S + 0.2)
    arm.command(along(x=0.1), START_S + 0.2, along_tool=False)
    heard = [arm.feedback(START_S + 0.2 + 0.01 * index) for index in range(1, 60)]
    ages = [START_S + 0.2 + 0.01 * (i + 1) - state.time_s for i, state in enumerate(heard)]
    assert np.allclose(ages, 0.15, atol=STEP_S + 1e-9)
    x = np.array([state.pose.position_m[0] for state in heard])
    # 150 ms until it acts, 10 ms of latency, 150 ms until it is heard of.
    assert (x[:30] == x[0]).all()
    assert x[36] > x[0]
