# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""An indenter's depth that follows a force: gels of a known law."""

import numpy as np
import pytest

from dotsim_ros.twin.force_following import CLEAR_M, ForceFollower, is_met

TRAVEL_M = 0.6e-3


def follow(follower, law, asked_n):
    """Return the forces and depths of the frames of a course of forces."""
    forces, depths = [], []
    for force_n in asked_n:
        depth_m = follower.next_m(force_n)
        found_n = law(depth_m) if depth_m > 0.0 else 0.0
        follower.answer(depth_m, found_n)
        forces.append(found_n)
        depths.append(depth_m)
    return np.array(forces), np.array(depths)


@pytest.mark.parametrize("power", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("asked_n", [0.02, 0.5, 3.0])
def test_a_step_of_force_is_met_in_a_few_frames_and_left_alone(power, asked_n):
    follower = ForceFollower(travel_m=TRAVEL_M)
    forces, depths = follow(follower, lambda d: 2.0 * (d / 1e-3) ** power, [asked_n] * 8)
    assert [is_met(force_n, asked_n) for force_n in forces[5:]] == [True] * 3
    assert depths[6] == depths[7]


def test_no_frame_moves_farther_than_it_may_in_the_gel():
    follower = ForceFollower(travel_m=TRAVEL_M)
    _, depths = follow(follower, lambda d: 1e-3 * d / 1e-3, [50.0] * 20 + [0.0] * 30)
    assert np.abs(np.diff(depths)).max() <= TRAVEL_M + CLEAR_M
    assert depths[19] > 19 * TRAVEL_M
    assert depths[-1] == -CLEAR_M


def test_a_contact_that_is_lost_is_found_again():
    follower = ForceFollower(travel_m=TRAVEL_M)
    follow(follower, lambda d: 2.0 * d / 1e-3, [0.5] * 6)
    shifted = 0.5e-3
    forces, _ = follow(follower, lambda d: max(0.0, 2.0 * (d - shifted) / 1e-3), [0.5] * 20)
    assert forces[0] == 0.0
    assert is_met(forces[-1], 0.5)


def test_a_force_that_jumps_with_depth_and_one_that_never_comes_do_no_harm():
    follower = ForceFollower(travel_m=TRAVEL_M)
    _, depths = follow(follower, lambda d: 0.0 if d < 0.3e-3 else 1.0, [0.5] * 40)
    assert np.isfinite(depths).all()
    assert np.abs(depths).max() < 2e-3
    follower.forget()
    _, depths = follow(follower, lambda d: 0.0, [0.5] * 10)
    assert (np.diff(depths) > 0.0).all()
