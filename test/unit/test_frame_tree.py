# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames in one another, as TF tells them: where they are, when, and what is wrong with them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dotsim_ros.geometry.frame_tree import FrameTree, OutOfOrderError
from dotsim_ros.geometry.pose import Pose

SECOND = 1_000_000_000


def place(x_m=0.0, y_m=0.0, z_m=0.0, turn=(0.0, 0.0, 0.0)):
    return Pose(np.array([x_m, y_m, z_m]), Rotation.from_rotvec(turn).as_quat())


def put(tree, parent, child, stamp_s, pose, *, is_static=False):
    tree.put(parent, child, round(stamp_s * SECOND), lambda: pose, is_static=is_static)


@pytest.fixture
def tree():
    """A world with an arm that carries the sensor, and a peg."""
    tree = FrameTree([("base", "peg")], maximum_step_s=1.0)
    put(tree, "tool", "base", 0, place(z_m=0.1, turn=(0.3, 0.0, 0.0)), is_static=True)
    put(tree, "world", "tool", 1, place(x_m=0.5, turn=(0.0, 1.0, 0.2)))
    put(tree, "world", "peg", 1, place(x_m=0.6, turn=(0.0, 0.0, 2.0)))
    return tree


def test_the_place_is_what_goes_through_the_common_frame(tree):
    pose, stamp_ns = tree.locate("base", "peg")
    assert stamp_ns == SECOND
    base = Rotation.from_rotvec([0.0, 1.0, 0.2]) * Rotation.from_rotvec([0.3, 0.0, 0.0])
    base_m = np.array([0.5, 0.0, 0.0]) + Rotation.from_rotvec([0.0, 1.0, 0.2]).apply(
        [0.0, 0.0, 0.1]
    )
    assert pose.position_m == pytest.approx(base.inv().apply([0.6, 0.0, 0.0] - base_m))
    expected = (base.inv() * Rotation.from_rotvec([0.0, 0.0, 2.0])).as_matrix()
    np.testing.assert_allclose(pose.rotation(), expected, atol=1e-12)


def test_what_moves_is_compared_at_one_time(tree):
    put(tree, "world", "peg", 3, place(x_m=0.8, turn=(0.0, 0.0, 2.0)))
    assert tree.locate("base", "peg")[1] == SECOND
    put(tree, "world", "tool", 2, place(x_m=0.5, turn=(0.0, 1.0, 0.2)))
    pose, stamp_ns = tree.locate("base", "peg")
    assert stamp_ns == 2 * SECOND
    half_way = FrameTree([("base", "peg")], maximum_step_s=1.0)
    put(half_way, "tool", "base", 0, place(z_m=0.1, turn=(0.3, 0.0, 0.0)), is_static=True)
    put(half_way, "world", "tool", 2, place(x_m=0.5, turn=(0.0, 1.0, 0.2)))
    put(half_way, "world", "peg", 2, place(x_m=0.7, turn=(0.0, 0.0, 2.0)))
    np.testing.assert_allclose(
        pose.position_m, half_way.locate("base", "peg")[0].position_m, atol=1e-12
    )


def test_what_is_not_between_the_two_is_not_read(tree):
    def unread():
        raise AssertionError("read")

    tree.put("world", "cup", SECOND, unread, is_static=False)
    assert tree.locate("base", "peg") is not None


@pytest.mark.parametrize(
    ("parent", "child", "said"),
    [
        ("peg", "peg", "in 'peg' itself"),
        ("base", "world", "in 'world' itself"),
        ("", "peg", "two names"),
    ],
)
def test_what_makes_no_tree_is_refused_and_what_was_there_stays(tree, parent, child, said):
    with pytest.raises(ValueError, match=said):
        put(tree, parent, child, 2, place())
    assert tree.locate("base", "peg")[1] == SECOND


def test_a_transform_that_cannot_be_read_changes_nothing(tree):
    def broken():
        raise ValueError("not finite")

    with pytest.raises(ValueError, match="not finite"):
        tree.put("world", "peg", 2 * SECOND, broken, is_static=False)
    put(tree, "world", "tool", 2, place())
    assert tree.locate("base", "peg")[1] == SECOND


def test_a_little_back_is_refused_and_far_back_is_a_new_beginning(tree):
    with pytest.raises(OutOfOrderError, match=r"stamped 0\.5\d* s before"):
        put(tree, "world", "peg", 0.5, place())
    put(tree, "world", "peg", 9, place())
    put(tree, "world", "tool", 9, place())
    put(tree, "world", "peg", 2, place(y_m=0.3))
    assert tree.locate("base", "peg") is None
    put(tree, "world", "tool", 2, place())
    assert tree.locate("base", "peg")[1] == 2 * SECOND


def test_what_is_missing_is_named():
    tree = FrameTree([("base", "peg")], maximum_step_s=1.0)
    assert tree.missing("base", "peg") == "no transform has come"
    put(tree, "world", "peg", 1, place())
    assert tree.missing("base", "peg") == "there is no frame 'base'; known are 'peg', 'world'"
    put(tree, "tool", "base", 1, place(), is_static=True)
    assert "in two trees, below 'tool' and 'world'" in tree.missing("base", "peg")
    put(tree, "world", "tool", 1, place())
    assert tree.missing("base", "peg") == ""


def test_what_moves_is_forgotten_where_time_begins_again():
    tree = FrameTree([("base", "peg")], maximum_step_s=1.0)
    put(tree, "base", "hand", 0, place(), is_static=True)
    put(tree, "hand", "peg", 0.8, place())
    with pytest.raises(OutOfOrderError):
        put(tree, "hand", "peg", 0.1, place())
    tree.forget_motion()
    assert tree.locate("base", "peg") is None
    put(tree, "hand", "peg", 0.1, place())
    assert tree.locate("base", "peg")[1] == SECOND // 10
