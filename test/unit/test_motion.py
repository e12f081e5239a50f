# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Motions of the indenter: scripted presses, real presses, and how they are sampled."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dotsim_ros.data.motion import (
    Motion,
    at_speed,
    held,
    joined,
    pose_along,
    reversed_motion,
    rotation_angle,
)
from dotsim_ros.data.scripted import (
    Site,
    in_sequence,
    press_hold_release,
    slide,
    travel,
    turned,
    twist,
)
from dotsim_ros.data.shipped_presses import DOME_CENTRE_MM, FIRST_CONTACT_RADIUS_M, read_presses
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.files import parameter_path

RADIUS_M = 0.01575
ALL_PRESSES = Path(__file__).parents[3] / "shared" / "real" / "densetact" / "presses.npz"
SHIPPED_PRESSES = parameter_path("presses/densetact_presses.npz")

quick = settings(max_examples=20, deadline=None)
sites = st.builds(
    Site,
    tilt_rad=st.floats(0.0, 1.2),
    azimuth_rad=st.floats(-np.pi, np.pi),
    spin_rad=st.floats(-np.pi, np.pi),
)
depths = st.floats(1e-4, 6e-3)


def radii(motion):
    return np.array([np.linalg.norm(pose.position_m) for _, pose in motion.sampled(200.0)])


def speeds(motion, rate_hz=200.0):
    points = np.array([pose.position_m for _, pose in motion.sampled(rate_hz)])
    return np.linalg.norm(np.diff(points, axis=0), axis=1) * rate_hz


@quick
@given(
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 1e-3), st.floats(-3, 3)
)
@example((0.0, 1.2e-7, -1.0), 0.0)
@example((3e-160, 0.0, -1.0), 1.0)
def test_pose_points_along_its_axis_by_the_smallest_rotation_and_a_spin(axis, spin):
    pose, plain = (pose_along((1.0, 2.0, 3.0), axis, spin_rad=angle) for angle in (spin, 0.0))
    direction = np.array(axis) / np.linalg.norm(axis)
    assert np.allclose(pose.rotation()[:, 2], direction, atol=1e-9)
    tilt = np.arctan2(np.hypot(*direction[:2]), direction[2])
    assert rotation_angle(Pose(), plain) == pytest.approx(tilt, abs=1e-7)
    assert rotation_angle(plain, pose) == pytest.approx(abs(spin), abs=1e-7)


@quick
@given(sites, depths)
def test_press_goes_straight_in_and_out(site, depth_m):
    motion = press_hold_release(site, depth_m=depth_m, hold_s=0.3, speed_m_s=0.005)
    along = np.array([pose.position_m @ site.direction() for _, pose in motion.sampled(200.0)])
    assert np.allclose(radii(motion), along, atol=1e-12)
    assert along[0] == pytest.approx(RADIUS_M + site.clearance_m)
    assert along.min() == pytest.approx(RADIUS_M - depth_m)
    assert along[-1] == pytest.approx(along[0])
    assert motion.duration_s == pytest.approx(2 * (depth_m + site.clearance_m) / 0.005 + 0.3)
    assert speeds(motion).max() < 0.005 * (1 + 1e-6)
    outward = [pose.rotation()[:, 2] for pose in motion.poses]
    assert np.allclose(outward, site.direction(), atol=1e-9)


@quick
@given(st.floats(0.0, 0.6), st.floats(-3, 3), st.floats(-3, 3), st.floats(1e-4, 3e-3))
def test_slide_keeps_its_depth_its_length_and_its_heading(tilt, azimuth, heading, depth_m):
    site = Site(tilt_rad=tilt, azimuth_rad=azimuth)
    motion = slide(
        site, depth_m=depth_m, distance_m=0.008, heading_rad=heading, slide_speed_m_s=0.01
    )
    at_depth = np.isclose(
        [np.linalg.norm(pose.position_m) for pose in motion.poses], RADIUS_M - depth_m, atol=1e-9
    )
    ends = [motion.poses[index] for index in np.flatnonzero(at_depth)[[0, -1]]]
    first, last = (pose.position_m / np.linalg.norm(pose.position_m) for pose in ends)
    angle = 2 * np.arcsin(np.linalg.norm(first - last) / 2)
    assert angle * RADIUS_M == pytest.approx(0.008, rel=1e-6)
    x, y, _ = ends[0].rotation().T @ (last - first)
    assert np.allclose(np.array([x, y]) / np.hypot(x, y), [np.cos(heading), np.sin(heading)])
    # Between two points of the arc the path is a chord: less than a micrometre too deep.
    assert radii(motion).min() > RADIUS_M - depth_m - 1e-6
    for pose, direction in zip(ends, (first, last), strict=True):
        assert np.allclose(pose.rotation()[:, 2], direction, atol=1e-9)


@quick
@given(sites, st.floats(0.05, 3.0))
def test_twist_turns_in_place(site, angle):
    motion = twist(site, depth_m=0.002, angle_rad=angle)
    turn = max(rotation_angle(site.pose(0.002), pose) for pose in motion.poses)
    assert turn == pytest.approx(min(angle, 2 * np.pi - angle), abs=1e-6)
    outward = [pose.rotation()[:, 2] for pose in motion.poses]
    assert np.allclose(outward, site.direction(), atol=1e-9)
    assert rotation_angle(motion.poses[0], motion.poses[-1]) < 1e-6


@quick
@given(sites, sites)
@example(Site(tilt_rad=np.pi / 2), Site(tilt_rad=np.pi / 2, azimuth_rad=np.pi))
def test_way_between_presses_stays_off_the_skin(first, second):
    way = travel(first.pose(-0.002), second.pose(-0.002))
    assert radii(way).min() > RADIUS_M + 0.0015
    assert speeds(way).max(initial=0.0) < 0.04 * (1 + 1e-6)
    # Opposite sides are joined over the apex.
    assert min(pose.position_m[2] for pose in way.poses) > -1e-9


@quick
@given(st.floats(1.0, 500.0))
def test_samples_are_steady_and_reach_the_end(rate_hz):
    motion = press_hold_release(Site(), depth_m=0.001, hold_s=0.1)
    samples = list(motion.sampled(rate_hz))
    times = np.array([time_s for time_s, _ in samples])
    assert np.allclose(times[:-1], np.arange(len(times) - 1) / rate_hz)
    assert times[-1] == motion.duration_s
    assert (np.diff(times) > 0).all()
    assert np.array_equal(samples[-1][1].position_m, motion.poses[-1].position_m)


def test_motion_backwards_joined_and_turned():
    out = at_speed([Site().pose(-0.002), Site().pose(0.001)], speed_m_s=0.01)
    both = joined(out, held(out.poses[-1], 0.0), reversed_motion(out))
    assert both.duration_s == pytest.approx(0.6)
    assert np.allclose(both.at(0.1).position_m, both.at(0.5).position_m)
    assert np.array_equal(both.at(-1.0).position_m, both.at(9.0).position_m)
    turn = turned(Pose(np.array([1.0, 0.0, 0.0])), (0, 0, 2.0), np.pi / 2)
    assert np.allclose(turn.position_m, (0.0, 1.0, 0.0))
    assert np.allclose(turn.apply((1.0, 0.0, 0.0)), (0.0, 2.0, 0.0))


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: press_hold_release(Site(), depth_m=float("nan")), "depth"),
        (lambda: press_hold_release(Site(), depth_m=0.001, speed_m_s=0.0), "positive"),
        (lambda: press_hold_release(Site(), depth_m=0.001, hold_s=-1.0), "negative"),
        (lambda: Site(tilt_rad=2.0), "not on the dome"),
        (lambda: Site(clearance_m=0.0), "positive"),
        (lambda: slide(Site(), depth_m=0.001, distance_m=0.03), "leaves the dome"),
        (lambda: slide(Site(), depth_m=0.001, distance_m=-1.0), "distance"),
        (lambda: twist(Site(), depth_m=0.001, angle_rad=0.0), "angle"),
        (lambda: in_sequence([]), "nothing to play"),
        (lambda: travel(Pose(), Site().pose(-0.002)), "centre"),
        (lambda: at_speed([], speed_m_s=0.01), "at least one"),
        (lambda: Motion(np.array([0.0, 0.0]), (Pose(), Pose())), "increase"),
        (lambda: Motion(np.array([0.0]), ()), "a time for each pose"),
        (lambda: list(held(Pose(), 1.0).sampled(0.0)), "rate"),
        (lambda: joined(held(Pose(), 1.0), held(Pose(np.ones(3)), 1.0)), "apart"),
        (lambda: pose_along((0, 0, 0), (0, 0, 0)), "length"),
    ],
)
def test_impossible_motion_is_refused(make, reason):
    with pytest.raises(ValueError, match=reason):
        make()


def test_real_presses_meet_the_dome_from_outside_about_its_axis():
    assert len(read_presses(SHIPPED_PRESSES)) == 12
    presses = read_presses(ALL_PRESSES if ALL_PRESSES.is_file() else SHIPPED_PRESSES)
    for press in presses:
        poses = press.poses(outer_radius_m=RADIUS_M, indenter_radius_m=0.004)
        centres = np.array([pose.apply((0.0, 0.0, 0.004)) for pose in poses])
        gap = np.linalg.norm(centres, axis=1) - (RADIUS_M + 0.004)
        # The first points scatter about the sphere that was fitted to them.
        assert -0.5e-3 < gap[0] < 1.4e-3
        assert -6.3e-3 < gap[-1] < -3.5e-3
        depth_m = FIRST_CONTACT_RADIUS_M - np.linalg.norm(press.centre_m[-1])
        assert depth_m == pytest.approx(-gap[-1], abs=0.6e-3)
        assert centres[:, 2].min() > 0.0
        # One straight line, as long as the stage's, tip first.
        steps = np.diff(centres, axis=0)
        inwards = -poses[0].rotation()[:, 2]
        assert np.allclose(np.cross(steps, inwards), 0.0, atol=2e-6)
        assert (steps @ inwards > 0.0).all()
        assert centres[0] @ inwards < 0.0
        assert np.allclose(steps, np.diff(press.centre_m, axis=0))
    first = np.array([press.centre_m[0] for press in presses])
    directions = first / np.linalg.norm(first, axis=1, keepdims=True)
    assert directions[:, 2].min() > 0.3
    assert directions[:, 2].max() > 0.99
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    quadrants = np.floor(azimuth[directions[:, 2] < 0.9] / (np.pi / 2))
    assert set(quadrants) == {-2.0, -1.0, 0.0, 1.0}


def test_motion_of_a_press_turns_at_its_limit():
    presses = read_presses(SHIPPED_PRESSES)
    size = {"outer_radius_m": RADIUS_M, "indenter_radius_m": 0.004}
    how = {**size, "speed_m_s": 0.005, "hold_s": 0.2}
    for press in presses:
        free, limited = press.motion(**how), press.motion(**how, depth_limit_m=0.002)
        for motion, deepest in ((free, 7e-3), (limited, 2e-3)):
            centres = np.array([pose.apply((0.0, 0.0, 0.004)) for pose in motion.poses])
            assert RADIUS_M + 0.004 - np.linalg.norm(centres, axis=1).min() <= deepest
            assert np.array_equal(motion.poses[0].position_m, motion.poses[-1].position_m)
            assert speeds(motion).max() < 0.005 * (1 + 1e-6)
        assert limited.duration_s < free.duration_s
    with pytest.raises(ValueError, match="depth limit"):
        presses[0].motion(**how, depth_limit_m=0.0)


GOOD = {
    "position_mm": np.zeros((4, 3)),
    "offset": np.array([0, 2, 4]),
    "sensor": np.array([next(iter(DOME_CENTRE_MM))] * 2),
}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"position_mm": np.full((4, 3), np.nan)}, "finite"),
        ({"offset": np.array([0, 3, 4])}, "offset"),
        ({"offset": np.array([0.0, 2.0, 4.0])}, "offset"),
        ({"sensor": np.array(["unknown", "unknown"])}, "no centre is known"),
    ],
)
def test_malformed_recording_is_refused(tmp_path, change, reason):
    with pytest.raises(FileNotFoundError, match="no recording"):
        read_presses(tmp_path / "presses.npz")
    np.savez(tmp_path / "presses.npz", **(GOOD | change))
    with pytest.raises(ValueError, match=reason):
        read_presses(tmp_path / "presses.npz")
