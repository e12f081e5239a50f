# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Poses in poses: chains of frames and the way back."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dotsim_ros.geometry.pose import Pose, compose, inverse, quaternion_product


@pytest.fixture
def poses():
    random = np.random.default_rng(5)
    return [
        Pose(random.normal(size=3), Rotation.random(random_state=seed).as_quat())
        for seed in range(3)
    ]


def test_a_chain_maps_points_as_its_links_do(poses):
    points = np.random.default_rng(6).normal(size=(4, 3))
    chained = compose(poses[0], compose(poses[1], poses[2]))
    expected = poses[0].apply(poses[1].apply(poses[2].apply(points)))
    np.testing.assert_allclose(chained.apply(points), expected, atol=1e-12)


def test_there_and_back_is_where_it_began(poses):
    for back_and_forth in (
        compose(poses[0], inverse(poses[0])),
        compose(inverse(poses[1]), poses[1]),
    ):
        np.testing.assert_allclose(back_and_forth.position_m, 0.0, atol=1e-12)
        np.testing.assert_allclose(back_and_forth.rotation(), np.eye(3), atol=1e-12)


def test_the_product_of_quaternions_is_the_product_of_rotations(poses):
    first, second = poses[0].quaternion_xyzw, poses[1].quaternion_xyzw
    expected = (Rotation.from_quat(first) * Rotation.from_quat(second)).as_matrix()
    product = Pose(np.zeros(3), quaternion_product(first, second))
    np.testing.assert_allclose(product.rotation(), expected, atol=1e-12)
