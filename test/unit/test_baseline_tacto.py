# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tacto: clipped by the indenter and nowhere inside it, at rest without contact, stiffness told."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros.data.presses import Press
from dotsim_ros.geometry.indenter import Indenter, box, cone, flat_punch, sphere, torus
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin
from studies.rivals import tacto
from studies.rivals.clipping import clip_depths, clipped_skin
from studies.rivals.penalty_force import penetration_vectors

RADIUS_M = 0.01575
TURNED = np.array([np.sin(0.2), 0.0, 0.0, np.cos(0.2)])


@pytest.fixture(scope="module")
def skin() -> SkinMesh:
    return dome_skin(RADIUS_M, 8.0e-4)


def press_to(*depths_m: float) -> Press:
    poses = [Pose(np.array([0.0, 0.0, RADIUS_M - depth])) for depth in depths_m]
    return Press("press", "indenter", poses, np.arange(len(poses), dtype=float))


@pytest.mark.parametrize(
    "indenter",
    [
        sphere(0.004),
        flat_punch(0.003, 0.01, 0.0003),
        cone(0.7, 0.008, 0.0005),
        torus(0.004, 0.0015),
        box((0.004, 0.006, 0.01)),
    ],
    ids=lambda indenter: indenter.name,
)
def test_no_vertex_stays_inside(indenter: Indenter, skin: SkinMesh) -> None:
    pose = Pose(np.array([0.001, -0.002, RADIUS_M - 0.003]), TURNED)
    depth = clip_depths(skin, [pose], indenter)
    moved = clipped_skin(skin, depth)[0]
    distance = indenter.signed_distance((moved - pose.position_m) @ pose.rotation())
    touched = depth[0] > 0.0
    assert touched.sum() > 5
    assert distance.min() >= -1.0e-12
    # On the surface, not beyond it: 24 nm along the normal at most.
    assert distance[touched].max() < 3.0e-8
    assert np.array_equal(moved[~touched], skin.rest_position_m[~touched])


def test_the_force_of_a_straight_press_is_its_depth_times_the_stiffness(skin: SkinMesh) -> None:
    press = press_to(0.0005, 0.001, 0.002)
    force = tacto.Tacto(1500.0).predict(press, sphere(0.004), skin).force_n
    assert force is not None
    assert force[:, 2] == pytest.approx([0.75, 1.5, 3.0], rel=1e-4)
    assert np.abs(force[:, :2]).max() < 0.01 * force[-1, 2]


def test_a_known_stiffness_is_told_from_noisy_forces(skin: SkinMesh) -> None:
    truth = tacto.Tacto(1234.0)
    press = press_to(*np.linspace(0.0002, 0.003, 8))
    seen = truth.predict(press, sphere(0.004), skin)
    assert seen.force_n is not None
    noise = np.random.default_rng(3).normal(scale=0.015, size=seen.force_n.shape)
    measured = Press(
        "press",
        "ball",
        press.poses,
        press.stamp_s,
        seen.skin_position_m,
        seen.force_n + noise,
    )
    fitted = tacto.fit([measured], {"ball": sphere(0.004)}, skin)
    assert fitted.stiffness_n_m == pytest.approx(1234.0, rel=5e-3)


def test_a_tilted_press_is_answered_along_its_own_normal(skin: SkinMesh) -> None:
    turn = Pose(np.zeros(3), TURNED)
    pose = Pose(turn.apply([0.0, 0.0, RADIUS_M - 0.002]), TURNED)
    depth = clip_depths(skin, [pose], sphere(0.004))
    vector = penetration_vectors(skin, depth)[0]
    along = turn.rotation()[:, 2]
    assert vector @ along == pytest.approx(0.002, abs=2e-5)
    assert np.linalg.norm(vector - (vector @ along) * along) < 4e-5
