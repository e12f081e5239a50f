# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hidden effects know nothing of the library that is to find them."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros.effects.library import load_effects
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import load_sensor
from studies.hidden.laws import LAWS, LawAnswer, LawMotion


def test_the_library_has_the_effects_that_laws_say_it_has() -> None:
    known = load_effects()
    assert {law.library for law in LAWS.values() if law.library} <= set(known)
    assert any(not law.library for law in LAWS.values())


@pytest.mark.parametrize("name", LAWS)
def test_a_law_changes_something(name: str) -> None:
    law, size = LAWS[name], LAWS[name].high
    random = np.random.default_rng(0)
    up = np.array([0.0, 0.0, 1.0])
    rest = random.standard_normal((5, 3)) + 3.0 * up
    moved = np.stack([rest, rest - 0.2 * up, rest - 0.1 * up])
    force = np.array([[0.0, 0.0, 0.0], [0.2, 0.1, 2.0], [0.1, 0.0, 1.0]])
    stamp = np.array([0.0, 0.1, 0.2])
    changed = False
    if law.gel is not None:
        values = values_of(load_sensor("sensor_a"))
        found, relaxation = law.gel(values, size if name != "slippery" else law.low)
        changed |= found != values or relaxation is not None
    if law.motion is not None:
        poses = [Pose(np.array([0.0, 0.0, z])) for z in (0.0, -1e-3, -0.5e-3)]
        ways = law.motion(LawMotion(poses, stamp, force), size, random, random)
        changed |= any(
            not np.allclose(a.position_m, b.position_m, atol=1e-7, rtol=0.0)
            for a, b in zip(ways, poses, strict=True)
        )
    if law.answer is not None:
        skin, load = law.answer(LawAnswer(moved, force, rest, stamp, 0.0), size)
        changed |= not (np.allclose(skin, moved) and np.allclose(load, force))
    assert changed


def test_a_mounting_offset_is_the_unit_s_and_not_each_trajectory_s() -> None:
    motion = LawMotion(
        [Pose(np.zeros(3)), Pose(np.array([1e-3, 0.0, 0.0]))], np.arange(2.0), np.ones((2, 3))
    )
    law = LAWS["mounted_off"].motion
    assert law is not None
    first, second, other = (
        law(motion, 3e-4, np.random.default_rng(unit), np.random.default_rng(trajectory))
        for unit, trajectory in ((5, 0), (5, 1), (6, 0))
    )
    for a, b, c, told in zip(first, second, other, motion.poses, strict=True):
        assert np.linalg.norm(a.position_m - told.position_m) == pytest.approx(3e-4)
        np.testing.assert_array_equal(a.position_m, b.position_m)
        assert np.linalg.norm(a.position_m - c.position_m) > 1e-5
