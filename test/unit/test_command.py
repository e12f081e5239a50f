# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands: axes, limits, interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dotsim_ros.control.arm.command import (
    ANGULAR,
    LINEAR,
    CommandInterpolator,
    CommandPredictor,
    ToolLimits,
    in_base_axes,
    shortened,
    turn_between,
)
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame, advance

TILTED = Pose((0.3, -0.1, 0.2), (0.5, -0.5, 0.1, np.sqrt(0.49)))
numbers = st.floats(-1.0, 1.0)
twists = st.lists(numbers, min_size=6, max_size=6).map(np.array)


@settings(deadline=None, max_examples=30)
@given(twists)
def test_a_command_along_either_axes_moves_the_tool_alike(twist):
    base = in_base_axes(twist, TILTED)
    none = np.zeros(3)
    own = advance(TILTED, twist[LINEAR], none, duration_s=0.1, along=TwistFrame.OWN)
    parent = advance(TILTED, base[LINEAR], none, duration_s=0.1, along=TwistFrame.PARENT)
    np.testing.assert_allclose(own.position_m, parent.position_m, atol=1e-12)
    own = advance(TILTED, none, twist[ANGULAR], duration_s=0.1, along=TwistFrame.OWN)
    parent = advance(TILTED, none, base[ANGULAR], duration_s=0.1, along=TwistFrame.PARENT)
    assert abs(own.quaternion_xyzw @ parent.quaternion_xyzw) == pytest.approx(1.0, abs=1e-9)


def test_the_righting_rate_turns_the_tool_back():
    wanted = Pose()
    pose = advance(wanted, (0, 0, 0), (0.1, -0.2, 0.05), duration_s=1.0)
    assert np.linalg.norm(turn_between(pose, wanted)) == pytest.approx(0.2291, abs=1e-4)
    for _ in range(400):
        rate = shortened(2.0 * turn_between(pose, wanted), 0.1)
        assert np.linalg.norm(rate) <= 0.1 + 1e-12
        pose = advance(pose, (0, 0, 0), rate, duration_s=0.01, along=TwistFrame.OWN)
    assert np.linalg.norm(turn_between(pose, wanted)) < 1e-3


@settings(deadline=None, max_examples=50)
@given(twists, twists, st.floats(0.01, 2.0), st.floats(0.01, 2.0), st.floats(0.0, 0.1))
def test_a_command_keeps_its_limits_and_its_direction(twist, present, linear, angular, duration):
    limits = ToolLimits(linear, angular, linear_m_s2=2.0, angular_rad_s2=20.0)
    limited = limits.within_speed(twist)
    assert np.linalg.norm(limited[LINEAR]) <= linear * (1 + 1e-12)
    assert np.linalg.norm(limited[ANGULAR]) <= angular * (1 + 1e-12)
    np.testing.assert_allclose(np.cross(limited[LINEAR], twist[LINEAR]), 0.0, atol=1e-12)
    assert limited[LINEAR] @ twist[LINEAR] >= 0.0
    step = limits.approached(present, twist, duration) - present
    assert np.linalg.norm(step[LINEAR]) <= 2.0 * duration + 1e-12
    assert np.linalg.norm(step[ANGULAR]) <= 20.0 * duration + 1e-12
    np.testing.assert_allclose(limits.approached(present, twist, 10.0), twist, atol=1e-12)


def test_the_brake_time_is_that_of_the_slower_half():
    command = np.array([0.03, 0.04, 0.0, 0.0, 0.0, 1.0])
    assert ToolLimits(linear_m_s2=2.5).brake_time_s(command) == pytest.approx(0.02)
    limits = ToolLimits(linear_m_s2=2.5, angular_rad_s2=25.0)
    assert limits.brake_time_s(command) == pytest.approx(0.04)
    assert not limits.approached(command, np.zeros(6), 0.04 + 1e-9).any()


def test_interpolated_commands_go_straight_from_where_the_line_is():
    line = CommandInterpolator(0.04)
    line.put(np.full(6, 1.0), 0.0)
    values = [line.at(0.01 * tick)[0] for tick in range(6)]
    np.testing.assert_allclose(values, [0.0, 0.25, 0.5, 0.75, 1.0, 1.0])
    line.put(np.full(6, -1.0), 1.0)
    line.put(np.full(6, 1.0), 1.02)
    values = [line.at(1.02 + 0.02 * tick)[0] for tick in range(3)]
    np.testing.assert_allclose(values, [0.0, 0.5, 1.0], atol=1e-12)
    line.reset()
    assert not line.at(3.0).any()


def turning(angle_rad):
    """Return a command of 5 mm/s in a direction."""
    return np.array([5e-3 * np.cos(angle_rad), 5e-3 * np.sin(angle_rad), 0, 0, 0, 0])


def test_a_predicted_command_points_where_the_policy_will_later():
    predictor = CommandPredictor(0.08, 0.04)
    # Images that arrive unevenly; the policy turns by 0.1 rad from one to the next.
    for number, late_s in enumerate([0.0, 0.008, -0.006, 0.004, 0.0, 0.007, -0.005, 0.0]):
        command = predictor.put(turning(0.1 * number), 0.04 * number + late_s)
    angle_rad = np.arctan2(command[1], command[0])
    assert angle_rad == pytest.approx(0.1 * number + 0.2, abs=0.03)
    assert np.linalg.norm(command) <= 5e-3 * (1 + 1e-12)


def circle_error_m(lead_s, delay_s=0.08, radius_m=2e-3):
    """Return how far from a circle a tool ends up whose policy sees it late."""
    predictor = CommandPredictor(lead_s, 0.04)
    way = [np.array([radius_m, 0.0])] * 9
    for cycle in range(100):
        seen = way[-1 - round(delay_s / 0.01)]
        outward = seen / np.linalg.norm(seen)
        along = np.array([-outward[1], outward[0]])
        wanted = 5e-3 * along + 3.0 * (radius_m - np.linalg.norm(seen)) * outward
        command = predictor.put(np.append(wanted, np.zeros(4)), 0.04 * cycle)
        way += [way[-1] + 0.01 * (tick + 1) * command[:2] for tick in range(4)]
    return abs(np.linalg.norm(way[-1]) - radius_m)


def test_prediction_keeps_a_late_tool_on_a_circle():
    assert circle_error_m(0.1) < 0.3 * circle_error_m(0.0)


def test_nothing_is_predicted_over_a_gap_without_a_lead_or_of_old_images():
    predictor = CommandPredictor(0.08, 0.04)
    predictor.put(turning(0.0), 0.0)
    for image_s in (0.3, 0.3, 0.2):
        np.testing.assert_array_equal(predictor.put(turning(0.5), image_s), turning(0.5))
    as_they_are = CommandPredictor(0.0, 0.04)
    for number in range(3):
        np.testing.assert_array_equal(
            as_they_are.put(turning(number), 0.04 * number), turning(number)
        )
