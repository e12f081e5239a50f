# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reference paths, and the expert that follows them."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros.control.policy.paths import PATHS, SPEED_M_S, DomeContact, Expert, reference_path
from dotsim_ros.control.policy.rollout import APPROACH_S, Arm, follow
from dotsim_ros.geometry.pose import Pose

CONTACT = DomeContact()
NO_IMAGE = np.zeros((2, 2, 3), dtype=np.uint8)
each_path = pytest.mark.parametrize("name", PATHS)


def test_a_contact_is_where_ball_and_dome_overlap():
    position = CONTACT.position_m([0.3, -0.2], 1.2e-3)
    centre = position + np.array([0.0, 0.0, CONTACT.ball_radius_m])
    overlap = CONTACT.dome_radius_m + CONTACT.ball_radius_m - np.linalg.norm(centre)
    assert overlap == pytest.approx(1.2e-3)
    assert np.arccos(centre[2] / np.linalg.norm(centre)) == pytest.approx(np.hypot(0.3, 0.2))
    assert centre[1] / centre[0] == pytest.approx(-2.0 / 3.0)


def test_tilt_and_depth_are_the_inverse_of_position():
    random = np.random.default_rng(1)
    tilt = random.uniform(-0.4, 0.4, (50, 2))
    tilt[0] = 0.0
    depth = random.uniform(-0.3e-3, 2.5e-3, 50)
    found_tilt, found_depth = CONTACT.tilt_and_depth(CONTACT.position_m(tilt, depth))
    np.testing.assert_allclose(found_tilt, tilt, atol=1e-12)
    np.testing.assert_allclose(found_depth, depth, atol=1e-12)


@each_path
def test_a_path_is_closed_even_and_near_the_apex(name):
    path = reference_path(name)
    steps = np.linalg.norm(np.roll(path.position_m, -1, axis=0) - path.position_m, axis=1)
    np.testing.assert_allclose(steps, path.spacing_m, rtol=0.02)
    tilt, depth = CONTACT.tilt_and_depth(path.position_m)
    assert np.degrees(np.linalg.norm(tilt, axis=1)).max() < 30.0
    assert depth.min() > 0.6e-3
    assert depth.max() < 2.2e-3
    assert path.speed_m_s.max() <= SPEED_M_S * (1.0 + 1e-9)


@each_path
def test_parts_of_a_path_keep_apart(name):
    """Places more than 1.6 mm from each other along the path are 0.75 mm apart in space: that is
    what touch has to tell."""
    path = reference_path(name)
    distance = np.linalg.norm(path.position_m[:, None] - path.position_m[None], axis=-1)
    arc = path.spacing_m * np.arange(len(path.position_m))
    along = np.abs(arc[:, None] - arc[None])
    along = np.minimum(along, path.length_m - along)
    assert distance[along > 1.6e-3].min() > 0.75e-3


@each_path
def test_nearest_measures_distance_across_and_place_along(name):
    path = reference_path(name)
    arc = 0.37 * path.length_m
    place, tangent, _ = path.at(arc)
    across = np.cross(tangent, place / np.linalg.norm(place))
    across *= 0.2e-3 / np.linalg.norm(across)
    distance, found = path.nearest(place + across)
    assert distance == pytest.approx(0.2e-3, abs=3e-6)
    assert found == pytest.approx(arc, abs=2e-5)


def test_laps_count_forwards_and_backwards():
    path = reference_path("arc")
    assert path.laps(path.position_m[::10]) == pytest.approx(1.0, abs=0.01)
    assert path.laps(path.position_m[::-10]) == pytest.approx(-1.0, abs=0.01)
    assert path.laps(np.tile(path.position_m[0], (20, 1))) == 0.0


def test_the_sensor_moves_against_the_relative_motion_and_never_too_fast():
    expert = Expert(reference_path("press"))
    place = CONTACT.position_m([0.0, 0.0], 0.2e-3)
    command = expert.command(place)
    # Too shallow: the ball must sink towards the base, so the sensor rises towards the ball.
    assert expert.relative_velocity_m_s(place)[2] < 0.0
    assert command[2] > 0.0
    assert np.all(command[3:] == 0.0)
    places = np.random.default_rng(2).uniform(-0.03, 0.03, (200, 3))
    speed = np.linalg.norm(expert.relative_velocity_m_s(places), axis=1)
    assert speed.max() <= expert.largest_speed_m_s * (1.0 + 1e-9)


def test_an_unknown_path_is_refused_with_the_known_ones():
    with pytest.raises(ValueError, match="figure_eight"):
        reference_path("spiral")


def test_the_arm_follows_late_and_slowly():
    arm = Arm(Pose(), latency_s=0.05, time_constant_s=0.05)
    arm.command(np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert arm.move(0.05).position_m[0] == 0.0
    # Then x(t) = -v (t - tau (1 - exp(-t / tau))): the sensor leaves the ball behind.
    expected = -0.01 * (0.5 - 0.05)
    assert arm.move(0.5).position_m[0] == pytest.approx(expected, rel=0.02)


def test_a_turning_sensor_sees_the_indenter_turn_the_other_way():
    start = Pose(np.array([0.002, 0.0, 0.015]))
    arm = Arm(start, latency_s=0.0, time_constant_s=0.001)
    arm.command(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    seen = arm.move(0.5)
    angle = -0.5
    expected = np.array([0.002 * np.cos(angle), 0.002 * np.sin(angle), 0.015])
    np.testing.assert_allclose(seen.position_m, expected, atol=5e-5)
    assert 2.0 * np.arcsin(seen.quaternion_xyzw[2]) == pytest.approx(angle, abs=0.02)


@pytest.mark.parametrize("name", ["figure_eight", "press"])
def test_the_expert_follows_its_path_through_the_arm(name):
    """The loop with its delays, the images replaced by the truth."""
    path = reference_path(name)
    expert = Expert(path)
    seen: list[Pose] = []

    def press(pose: Pose) -> np.ndarray:
        seen.append(pose)
        return NO_IMAGE

    places, ended = follow(
        lambda image, idle: expert.command(seen[-1].position_m),
        press,
        NO_IMAGE,
        Pose(path.position_m[0] + np.array([0.0005, 0.0, 0.0])),
        frame_count=300,
        rate_hz=25.0,
    )
    assert not ended
    judged = places[round(25.0 * APPROACH_S) :]
    assert path.nearest(judged)[0].mean() < 0.2e-3
    assert path.laps(judged) == pytest.approx((len(judged) - 1) / 25.0 / path.lap_s, rel=0.15)


def test_a_roll_out_that_the_gel_refuses_says_so():
    def press(pose: Pose) -> np.ndarray:
        raise ValueError("too deep")

    places, ended = follow(
        lambda image, idle: np.zeros(6), press, NO_IMAGE, Pose(), frame_count=5, rate_hz=25.0
    )
    assert (places.shape, ended) == ((0, 3), "too deep")
