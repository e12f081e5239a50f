"""Commands: axes, limits, interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame, advance
from dotsim_ros.tasks.arm.command import (
    ANGULAR,
    LINEAR,
    CommandInterpolator,
    approached,
    brake_time_s,
    in_base_axes,
    righting_rate,
    turn_between,
    within_speed,
    zero_twist,
)

TILTED = Pose((0.3, -0.1, 0.2), (0.5, -0.5, 0.1, np.sqrt(0.49)))
numbers = st.floats(-1.0, 1.0)
twists = st.lists(numbers, min_size=6, max_size=6).map(np.array)


@given(twists)
def test_a_command_along_other_axes_is_as_fast(twist):
    base = in_base_axes(twist, TILTED)
    # Squares below a double's smallest numbers are lost, and with them lengths below 1e-154.
    np.testing.assert_allclose(
        np.linalg.norm(base.reshape(2, 3), axis=1),
        np.linalg.norm(twist.reshape(2, 3), axis=1),
        atol=1e-150,
    )


def test_a_command_along_either_axes_moves_the_tool_alike():
    twist = np.array([0.01, -0.02, 0.03, 0.0, 0.0, 0.0])
    base = in_base_axes(twist, TILTED)
    own = advance(TILTED, twist[LINEAR], twist[ANGULAR], duration_s=0.1, along=TwistFrame.OWN)
    parent = advance(TILTED, base[LINEAR], base[ANGULAR], duration_s=0.1, along=TwistFrame.PARENT)
    np.testing.assert_allclose(own.position_m, parent.position_m, atol=1e-12)


def test_a_tool_down_on_the_base_goes_down_along_its_own_z():
    upside_down = Pose((0.0, 0.0, 0.3), (1.0, 0.0, 0.0, 0.0))
    down = in_base_axes(np.array([0.0, 0.0, 0.01, 0.0, 0.0, 0.0]), upside_down)
    np.testing.assert_allclose(down[LINEAR], (0.0, 0.0, -0.01), atol=1e-15)


def test_the_righting_rate_turns_the_tool_back():
    wanted = Pose()
    pose = advance(wanted, (0, 0, 0), (0.1, -0.2, 0.05), duration_s=1.0)
    assert np.linalg.norm(turn_between(pose, wanted)) == pytest.approx(0.2291, abs=1e-4)
    for _ in range(400):
        rate = righting_rate(pose, wanted, gain_per_s=2.0, limit_rad_s=0.1)
        assert np.linalg.norm(rate) <= 0.1 + 1e-12
        pose = advance(pose, (0, 0, 0), rate, duration_s=0.01, along=TwistFrame.OWN)
    assert np.linalg.norm(turn_between(pose, wanted)) < 1e-3


@given(twists, st.floats(0.01, 2.0), st.floats(0.01, 2.0))
def test_speeds_are_limited_and_directions_kept(twist, linear, angular):
    limited = within_speed(twist, linear_m_s=linear, angular_rad_s=angular)
    assert np.linalg.norm(limited[LINEAR]) <= linear * (1 + 1e-12)
    assert np.linalg.norm(limited[ANGULAR]) <= angular * (1 + 1e-12)
    np.testing.assert_allclose(np.cross(limited[LINEAR], twist[LINEAR]), 0.0, atol=1e-12)
    assert limited[LINEAR] @ twist[LINEAR] >= 0.0


@given(twists, twists, st.floats(0.0, 0.1))
def test_a_command_changes_no_faster_than_it_may_and_gets_there(present, target, duration):
    rates = {"linear_m_s2": 2.0, "angular_rad_s2": 20.0}
    step = approached(present, target, duration, **rates) - present
    assert np.linalg.norm(step[LINEAR]) <= 2.0 * duration + 1e-12
    assert np.linalg.norm(step[ANGULAR]) <= 20.0 * duration + 1e-12
    np.testing.assert_allclose(approached(present, target, 10.0, **rates), target, atol=1e-12)


def test_the_brake_time_is_that_of_the_slower_half():
    command = np.array([0.03, 0.04, 0.0, 0.0, 0.0, 1.0])
    assert brake_time_s(command, linear_m_s2=2.5, angular_rad_s2=1000.0) == pytest.approx(0.02)
    assert brake_time_s(command, linear_m_s2=2.5, angular_rad_s2=25.0) == pytest.approx(0.04)
    rates = {"linear_m_s2": 2.5, "angular_rad_s2": 25.0}
    assert not approached(command, zero_twist(), 0.04 + 1e-9, **rates).any()


def test_interpolated_commands_go_straight_and_end_at_each_one():
    line = CommandInterpolator(0.04)
    first, second = np.full(6, 1.0), np.full(6, -1.0)
    line.put(first, 0.0)
    values = [line.at(0.01 * tick)[0] for tick in range(5)]
    np.testing.assert_allclose(values, [0.0, 0.25, 0.5, 0.75, 1.0])
    assert line.at(0.5)[0] == 1.0
    line.put(second, 1.0)
    np.testing.assert_allclose(
        [line.at(1.0 + 0.01 * tick)[0] for tick in range(6)],
        [1.0, 0.5, 0.0, -0.5, -1.0, -1.0],
        atol=1e-12,
    )


def test_an_early_command_is_gone_to_from_where_the_line_is():
    line = CommandInterpolator(0.04)
    line.put(np.full(6, 1.0), 0.0)
    line.put(np.zeros(6), 0.02)
    np.testing.assert_allclose(
        [line.at(0.02)[0], line.at(0.04)[0], line.at(0.06)[0]], [0.5, 0.25, 0], atol=1e-12
    )


def test_a_reset_line_begins_at_rest():
    line = CommandInterpolator(0.04)
    line.put(np.full(6, 1.0), 0.0)
    line.reset()
    assert not line.at(1.0).any()
