# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""An indenter on the path of its commanded poses, frame by frame, without a gel that is solved."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dotsim_ros.data.motion import pose_along
from dotsim_ros.gel.body import Dome, Pad
from dotsim_ros.gel.rest_depth import RestDepth
from dotsim_ros.geometry.indenter import box, cone, sphere, way_m
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.tactile_sim.pursuit import SPACING_M, TOUCH_M, CommandedPath

RADIUS_M, BALL_M, LIMIT_M = 0.01575, 0.004, 0.6e-3
BALL = sphere(BALL_M)
DOME = Dome(RADIUS_M, 0.006)


def on_dome(tilt_rad, depth_m, azimuth_rad=0.0):
    """Return the pose of a ball whose tip is so deep below the dome's skin."""
    direction = np.array(
        [
            np.sin(tilt_rad) * np.cos(azimuth_rad),
            np.sin(tilt_rad) * np.sin(azimuth_rad),
            np.cos(tilt_rad),
        ]
    )
    return pose_along((RADIUS_M - depth_m) * direction, direction)


def depth_of(pose):
    """Return the depth of a ball in the dome, by itself."""
    return RADIUS_M + BALL_M - np.linalg.norm(pose.apply((0.0, 0.0, BALL_M)))


def new_path(*poses):
    path = CommandedPath(
        way_m=lambda start, end: way_m(start, end, BALL), depth_m=RestDepth(DOME, BALL)
    )
    for pose in poses:
        path.add(pose)
        path.advance(LIMIT_M)
    return path


def distance_to_path_m(pose, poses):
    """Return how far a pose is from the straight ways between poses."""
    nearest_m = np.inf
    for start, end in pairwise([poses[0], *poses]):
        way, offset = end.position_m - start.position_m, pose.position_m - start.position_m
        share = np.clip(offset @ way / max(way @ way, 1e-30), 0.0, 1.0)
        nearest_m = min(nearest_m, float(np.linalg.norm(offset - share * way)))
    return nearest_m


@st.composite
def motions(draw):
    """Draw poses of a ball over and in the dome, near to each other, and how many a frame has."""
    count = draw(st.integers(3, 40))
    steps = st.floats(-0.15, 0.15)
    tilt, azimuth = draw(st.floats(0.0, 0.8)), draw(st.floats(-3.0, 3.0))
    depth_m = draw(st.floats(-2e-3, 1e-3))
    poses = [on_dome(tilt, -3e-3, azimuth)]
    for _ in range(count):
        tilt = float(np.clip(tilt + draw(steps), 0.0, 1.0))
        azimuth += draw(steps)
        depth_m = float(np.clip(depth_m + draw(st.floats(-2e-3, 2e-3)), -3e-3, 4e-3))
        poses.append(on_dome(tilt, depth_m, azimuth))
    return poses, draw(st.lists(st.integers(0, 12), min_size=1, max_size=12))


@settings(max_examples=60, deadline=None)
@given(motions())
def test_no_frame_is_deeper_than_any_pose_since_the_last_one(drawn):
    poses, per_frame = drawn
    path, sent, frame = new_path(), 0, 0
    while sent < len(poses) or not path.is_reached:
        new = poses[sent : sent + per_frame[frame % len(per_frame)]]
        # A frame without a pose at the end only: nothing else may keep it from the newest.
        new = new or poses[sent : sent + 1]
        sent, frame = sent + len(new), frame + 1
        for pose in new:
            path.add(pose)
        before = path.here
        move = path.advance(LIMIT_M)
        allowed_m = max(depth_of(pose) for pose in new or poses[-1:])
        assert depth_of(move.pose) <= max(allowed_m, -TOUCH_M) + 1e-9
        # Where it was commanded to be, but for the arc of a dome over a straight way.
        assert distance_to_path_m(move.pose, poses[:sent]) < 0.35e-3
        if depth_of(poses[sent - 1]) < -TOUCH_M:
            assert np.array_equal(move.pose.position_m, poses[sent - 1].position_m)
        if move.start is not None:
            assert depth_of(move.start) < -0.9 * TOUCH_M
        elif before is not None:
            assert way_m(before, move.pose, BALL) <= LIMIT_M + SPACING_M + 1e-9
        assert frame < 400
    assert np.array_equal(path.here.position_m, poses[-1].position_m)


def test_an_indenter_that_lags_leaves_the_gel_with_its_path_and_does_not_cut_through():
    here = on_dome(-0.5, 2.0e-3)
    path = new_path(on_dome(-0.5, -1e-3), *[on_dome(-0.5, 1e-3 * d) for d in (0.4, 0.8, 1.2, 1.6)])
    path.add(here)
    path.advance(LIMIT_M)
    assert np.array_equal(path.here.position_m, here.position_m)
    # Out, over the apex, and into the other side, all since the last frame.
    there = [on_dome(0.1 * i, -1e-3) for i in range(-5, 6)]
    for pose in [on_dome(-0.5, -1e-3), *there, on_dome(0.5, 0.5e-3), on_dome(0.5, 2e-3)]:
        path.add(pose)
    depths_m = []
    while not path.is_reached:
        move = path.advance(LIMIT_M)
        depths_m.append(depth_of(move.pose))
        assert move.pose.position_m[0] > 0.0
    assert depths_m == pytest.approx([0.55e-3, 1.15e-3, 1.75e-3, 2.0e-3], abs=0.05e-3)


def test_the_path_in_contact_is_followed_and_not_the_straight_way():
    path = new_path(on_dome(-0.2, -1e-3), on_dome(-0.2, 0.5e-3))
    for tilt in np.linspace(-0.2, 0.2, 31):
        path.add(on_dome(tilt, 0.5e-3))
    shown = []
    while not path.is_reached:
        move = path.advance(LIMIT_M)
        assert move.start is None
        shown.append(depth_of(move.pose))
    # The straight way is 0.3 mm deeper in its middle.
    assert len(shown) > 10
    assert shown == pytest.approx([0.5e-3] * len(shown), abs=1e-5)


def test_a_press_that_is_over_is_left_at_once_and_one_that_turns_is_met_on_its_way_back():
    path = new_path(on_dome(0.0, -1e-3), on_dome(0.0, 0.5e-3))
    for depth in (1.0, 2.0, 3.0, 2.5):
        path.add(on_dome(0.0, 1e-3 * depth))
    assert depth_of(path.advance(LIMIT_M).pose) == pytest.approx(1.1e-3, abs=1e-6)
    path.add(on_dome(0.0, 1.5e-3))
    assert depth_of(path.advance(LIMIT_M).pose) == pytest.approx(1.5e-3, abs=1e-6)
    assert path.is_reached
    for depth in (3.0, 0.5, -1.0):
        path.add(on_dome(0.0, 1e-3 * depth))
    assert depth_of(path.advance(LIMIT_M).pose) == pytest.approx(-1e-3, abs=1e-6)


def test_an_indenter_that_is_far_behind_leaves_the_path_out_and_comes_from_outside():
    path = new_path(on_dome(0.0, -1e-3), on_dome(0.0, 0.5e-3))
    for tilt in np.linspace(0.0, 0.8, 30):
        path.add(on_dome(tilt, 1e-3))
    move = path.advance(LIMIT_M)
    assert path.is_reached
    assert depth_of(move.start) < 0.0
    assert move.pose.position_m == pytest.approx(on_dome(0.8, 1e-3).position_m)


def test_without_a_limit_the_indenter_is_led_along_the_path_in_one_frame():
    path = new_path(on_dome(-0.3, -1e-3), on_dome(-0.3, 0.1e-3))
    for tilt in np.linspace(-0.3, 0.3, 61):
        path.add(on_dome(tilt, 0.5e-3))
    move = path.advance(np.inf)
    assert path.is_reached
    assert move.start is None
    depths_m = [depth_of(pose) for pose in move.between]
    assert len(depths_m) > 8
    assert depths_m == pytest.approx([0.5e-3] * len(depths_m), abs=1e-9)


def test_a_flood_of_poses_is_kept_in_bounded_memory():
    path = new_path(on_dome(0.0, -1e-3), on_dome(0.0, 0.1e-3))
    for index in range(5000):
        path.add(on_dome(0.0, 0.1e-3 + 1e-9 * index))
    assert len(path._ahead) < 4
    path.advance(LIMIT_M)
    assert path.is_reached


@pytest.mark.parametrize("indenter", [sphere(0.001), cone(0.6, 0.009, 0.001), box([0.004] * 3)])
def test_the_depth_at_rest_grows_with_the_press_also_where_all_of_the_indenter_is_within(indenter):
    for body, apex_m in ((DOME, RADIUS_M), (Pad((0.02, 0.02, 0.01)), 0.01)):
        depth = RestDepth(body, indenter)
        for depth_m in (-0.005, -1e-4, 0.0, 5e-4, 3e-3):
            pose = Pose(np.array([0.0, 0.0, apex_m - depth_m]))
            assert depth(pose) == pytest.approx(depth_m, abs=2e-6)
