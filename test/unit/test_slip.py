# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What slips, and that it is learnt from features without units."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs the extra learning")

from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.learning.slip import SkinTouch, SlipDetector

STEP_M, RADIUS_M = 3e-4, 2e-3


def touch(follows: float, size: float = 1.0) -> SkinTouch:
    """A ball that moves along a cap of skin, which clings to it and follows a share of its way."""
    random = np.random.default_rng(1)
    direction = random.normal(size=(400, 3)) * [0.1, 0.1, 0.0] + [0.0, 0.0, 1.0]
    rest_m = 0.02 * size * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    poses = [Pose(size * np.array([k * STEP_M, 0.0, 0.02 - 5e-4])) for k in range(4)]
    ball, moved = sphere(size * RADIUS_M), []
    for k, pose in enumerate(poses):
        moved_m = np.tile([follows * size * k * STEP_M, 0.0, 0.0], (len(rest_m), 1))
        centre_m = pose.position_m + np.array([0.0, 0.0, size * RADIUS_M])
        off = rest_m + moved_m - centre_m
        length = np.linalg.norm(off, axis=1, keepdims=True)
        distance = ball.distance_from(rest_m + moved_m, pose)[:, None]
        moved.append(moved_m - np.minimum(distance, 0.0) * off / length)
    force_n = np.outer(np.full(4, size**2), [0.3 if follows > 0.5 else 0.5, 0.0, 1.0])
    return SkinTouch(rest_m, np.stack(moved), force_n, poses, ball)


def test_a_frame_slips_where_the_skin_follows_less_than_half() -> None:
    assert touch(0.2).slips().tolist() == [True] * 3
    assert touch(0.8).slips().tolist() == [False] * 3
    assert touch(0.2).judged().all()


def test_features_have_no_units() -> None:
    small, large = touch(0.4).features(), touch(0.4, 1.5).features()
    assert small.shape == (3, 9)
    np.testing.assert_allclose(large[:, :4], small[:, :4], atol=1e-9)
    # But for the least radius of a patch.
    np.testing.assert_allclose(large[:, 4:], small[:, 4:], rtol=0.1, atol=1e-9)


def test_what_differs_is_learnt() -> None:
    random = np.random.default_rng(0)
    features = random.normal(size=(400, 9))
    slips = features[:, 0] + features[:, 3] > 1.5
    detector = SlipDetector(features, slips)
    fresh = random.normal(size=(400, 9))
    truth = fresh[:, 0] + fresh[:, 3] > 1.5
    found = detector(fresh)
    assert (found & truth).sum() > 0.9 * truth.sum()
    assert (~found & ~truth).sum() > 0.9 * (~truth).sum()
