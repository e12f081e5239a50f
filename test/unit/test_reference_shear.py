# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Work and errors of motions, as the shear study judges them, on forces that are known."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dotsim_ros.data.trajectory import PoseChannel
from dotsim_ros.gel.make import skin_of
from dotsim_ros.io.arrays import FloatArray
from studies.reference.results import stamps_ns

pytest.importorskip("torch")

from studies.reference.shear import COARSE, MOTIONS, SENSOR, Run, deck_of, score

APEX_M = SENSOR.gel.outer_radius_m
SKIN = skin_of(SENSOR.gel)


def run_of_motion(motion: str) -> Run:
    """Return a motion with a force that depends on the depth alone."""
    poses = deck_of(motion, COARSE, SKIN).frame_poses()
    pose = PoseChannel.of(stamps_ns(poses), poses)
    depth_m = np.clip(APEX_M - pose.position_m[:, 2], 0.0, None)
    force_n = np.zeros((len(poses), 3))
    force_n[:, 2] = 1.1 * (depth_m / 1e-3) ** 1.5
    torque_nm = np.cross(pose.position_m, force_n)
    return Run(pose.position_m, pose.quaternion_xyzw, force_n, torque_nm)


def sliding(elastic: Run, friction: float) -> Run:
    """Return a run in which Coulomb's force points against the way to each frame."""
    force_n = elastic.force_n.copy()
    way = np.diff(elastic.position_m[:, :2], axis=0, prepend=elastic.position_m[:1, :2])
    length = np.linalg.norm(way, axis=1, keepdims=True)
    force_n[:, :2] = -friction * force_n[:, 2:] * way / np.maximum(length, 1e-12)
    return replace(elastic, force_n=force_n, torque_nm=np.cross(elastic.position_m, force_n))


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_press_without_friction_dissipates_nothing(motion: str) -> None:
    run = run_of_motion(motion)
    assert abs(run.dissipated_j()) < 1e-9 * 1.1e-3
    assert not run.force_n[0].any()
    assert run.force_n.max() == pytest.approx(1.1)


def test_friction_dissipates_its_force_times_the_way_around_a_square() -> None:
    elastic = run_of_motion("square")
    run = sliding(elastic, 0.3)
    # The first move of each side begins with the force of another direction, or with none.
    expected_j = 0.3 * 1.1 * (4e-3 - 4 * 0.5 * 1e-3 / 3)
    assert run.dissipated_j() == pytest.approx(expected_j, rel=1e-9)


def test_a_twist_dissipates_its_torque_times_the_angle_wherever_the_base_is() -> None:
    elastic = run_of_motion("twist")
    spin_nm = np.zeros((len(elastic.force_n), 3))
    spin_nm[4:8, 2], spin_nm[8:12, 2] = -2e-4, 2e-4
    # Off the base frame's origin the force has a torque of its own.
    aside = elastic.position_m + np.array([2e-3, -1e-3, 0.0])
    force_n = elastic.force_n + np.array([0.05, 0.02, 0.0])
    run = Run(aside, elastic.quaternion_xyzw, force_n, np.cross(aside, force_n) + spin_nm)
    np.testing.assert_allclose(run.held()[:, 0], spin_nm[:, 2], atol=1e-12)
    # Of eight moves the first has half of the torque, and the one after the turn has none.
    assert run.dissipated_j() == pytest.approx(2e-4 * np.radians(20.0) / 4 * 6.5, rel=1e-9)


def test_errors_are_shares_of_the_references_own_values() -> None:
    true = sliding(run_of_motion("square"), 0.3)
    scale = np.array([1.1, 1.1, 0.98])
    found = score(replace(true, force_n=scale * true.force_n), true)
    assert list(found["held"].values()) == pytest.approx(3 * [0.1])
    assert list(found["normal"].values()) == pytest.approx(3 * [0.02])
    # Of friction alone, whatever the size of the press.
    assert found["energy_error"] == pytest.approx(0.1)
    # One bad frame of twelve is the worst, and does not move the median.
    force_n: FloatArray = true.force_n.copy()
    force_n[8] *= 1.5
    found = score(replace(true, force_n=force_n), true)
    assert found["held"]["median"] == 0.0
    assert found["held"]["worst"] == pytest.approx(0.5)


@pytest.mark.parametrize("motion", MOTIONS)
def test_no_increment_moves_the_ball_far_across_its_axis(motion: str) -> None:
    # CalculiX looks for the opposite faces once an increment, and a ball's pressure leans after it.
    deck = deck_of(motion, COARSE, SKIN)
    ways = list(pairwise(deck.poses))
    across_m = np.array([np.linalg.norm((b.position_m - a.position_m)[:2]) for a, b in ways])
    cosine = [0.5 * (np.trace(b.rotation() @ a.rotation().T) - 1.0) for a, b in ways]
    turn_rad = np.arccos(np.clip(cosine, -1.0, 1.0))
    largest = np.array([control.largest for control in deck.controls])
    assert (largest * across_m <= 50e-6 * (1.0 + 1e-9)).all()
    assert (largest * turn_rad <= np.radians(3.0)).all()
    assert (largest[(across_m == 0.0) & (turn_rad == 0.0)] == COARSE.control.largest).all()
    assert all(control.first <= control.largest for control in deck.controls)


def test_frames_are_printed_where_the_indenter_is_then() -> None:
    deck = deck_of("drag", COARSE, SKIN)
    x_mm = 1e3 * np.array([pose.position_m[0] for pose in deck.frame_poses()])
    slide = [-0.5 + 0.25 * k for k in range(1, 6)] + [0.75 - 0.25 * k for k in range(1, 5)]
    np.testing.assert_allclose(x_mm, [-0.5] * 4 + slide, atol=1e-9)
    lines = deck.text().splitlines()
    for step, count in enumerate((3, 5, 4)):
        first = lines.index(f"*TIME POINTS, NAME=FRAMES{step}") + 1
        times = [float(line) for line in lines[first : first + count]]
        assert times == pytest.approx([k / count for k in range(1, count + 1)])
    assert lines.count("*NODE PRINT, NSET=SKIN, TIME POINTS=FRAMES2") == 1
