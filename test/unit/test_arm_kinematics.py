# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The kinematic model of the xArm 7 against what is published, itself, and its limits."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dotsim_ros.control.arm import kinematics
from dotsim_ros.control.arm.kinematics import (
    COMFORTABLE_JOINTS_RAD,
    XARM7,
    ArmKinematics,
)
from dotsim_ros.geometry.pose import Pose

DOWN = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def arm():
    return ArmKinematics()


def chain(joints_rad):
    """Return the tool's (4, 4) placement by the textbook's product, without Pinocchio."""
    placement = np.eye(4)
    for joint, angle in zip(XARM7, joints_rad, strict=True):
        cos_a, sin_a = np.cos(joint.twist_rad), np.sin(joint.twist_rad)
        cos_t, sin_t = np.cos(angle), np.sin(angle)
        placement = placement @ np.array(
            [
                [cos_t, -sin_t, 0.0, joint.length_m],
                [sin_t * cos_a, cos_t * cos_a, -sin_a, -joint.offset_m * sin_a],
                [sin_t * sin_a, cos_t * sin_a, cos_a, joint.offset_m * cos_a],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return placement


def random_joints(seed):
    arm = ArmKinematics()
    return np.random.default_rng(seed).uniform(arm.lower_rad, arm.upper_rad)


def test_at_zero_joints_the_flange_is_where_the_manual_says(arm):
    # The arm's zero position: x 206 mm, y 0, z 120.5 mm, roll 180 degrees.
    pose = arm.pose(np.zeros(7))
    np.testing.assert_allclose(pose.position_m, [0.206, 0.0, 0.1205], atol=1e-9)
    np.testing.assert_allclose(pose.rotation(), np.diag([1.0, -1.0, -1.0]), atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_pinocchio_gives_the_product_of_the_joints(arm, seed):
    joints = random_joints(seed)
    expected = chain(joints)
    pose = arm.pose(joints)
    np.testing.assert_allclose(pose.position_m, expected[:3, 3], atol=1e-12)
    np.testing.assert_allclose(pose.rotation(), expected[:3, :3], atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_the_jacobian_is_the_derivative(arm, seed):
    joints, step = random_joints(seed), 1e-6
    jacobian = arm.jacobian(joints)
    for index in range(7):
        change = np.zeros(7)
        change[index] = step
        ahead, behind = arm.pose(joints + change), arm.pose(joints - change)
        linear = (ahead.position_m - behind.position_m) / (2.0 * step)
        turn = Rotation.from_quat(ahead.quaternion_xyzw) * (
            Rotation.from_quat(behind.quaternion_xyzw).inv()
        )
        expected = np.concatenate([linear, turn.as_rotvec() / (2.0 * step)])
        np.testing.assert_allclose(jacobian[:, index], expected, atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_inverse_kinematics_comes_back_to_a_pose(arm, seed):
    wanted = arm.pose(0.6 * random_joints(seed))
    found = arm.joints_at(wanted)
    assert (found >= arm.lower_rad).all()
    assert (found <= arm.upper_rad).all()
    reached = arm.pose(found)
    np.testing.assert_allclose(reached.position_m, wanted.position_m, atol=2e-6)
    np.testing.assert_allclose(reached.rotation(), wanted.rotation(), atol=2e-6)


def test_what_cannot_be_reached_is_refused_and_says_how_close_it_came(arm, monkeypatch):
    monkeypatch.setattr(kinematics, "START_COUNT", 3)
    with pytest.raises(ValueError, match=r"does not reach the pose \[1.2, 0.0, 0.3\].* mm"):
        arm.joints_at(Pose(np.array([1.2, 0.0, 0.3]), DOWN))


def test_rates_move_the_tool_as_is_wanted_where_nothing_hinders(arm):
    joints = COMFORTABLE_JOINTS_RAD + 0.1
    jacobian = arm.jacobian(joints)
    wanted = np.array([0.05, -0.02, 0.03, 0.1, 0.2, -0.1])
    motion = arm.motion(joints, jacobian, wanted)
    np.testing.assert_allclose(jacobian @ motion.rates_rad_s, wanted, atol=1e-12)
    assert motion.slowed == 1.0
    assert motion.at_limit == ()


def test_the_elbow_goes_back_to_its_posture_only_while_the_tool_moves(arm):
    joints = COMFORTABLE_JOINTS_RAD.copy()
    _, _, right = np.linalg.svd(arm.jacobian(joints))
    joints += 0.2 * right[-1]
    jacobian = arm.jacobian(joints)
    assert not arm.motion(joints, jacobian, np.zeros(6)).rates_rad_s.any()
    wanted = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    rates = arm.motion(joints, jacobian, wanted).rates_rad_s
    plain = np.linalg.pinv(jacobian) @ wanted
    assert (rates - plain) @ (COMFORTABLE_JOINTS_RAD - joints) > 0.0


def test_no_joint_is_faster_than_it_may_and_the_direction_stays(arm):
    jacobian = arm.jacobian(COMFORTABLE_JOINTS_RAD)
    wanted = np.array([3.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    motion = arm.motion(COMFORTABLE_JOINTS_RAD, jacobian, wanted)
    assert np.abs(motion.rates_rad_s).max() == pytest.approx(4.0)
    np.testing.assert_allclose(jacobian @ motion.rates_rad_s, motion.slowed * wanted, atol=1e-9)


def test_rates_stay_bounded_where_the_arm_is_nearly_singular(arm):
    # At zero joints all of the arm lies in one plane, and the tool cannot turn about some line.
    joints = 0.002 * np.ones(7)
    jacobian = arm.jacobian(joints)
    left, values, _ = np.linalg.svd(jacobian)
    assert 0.0 < values[-1] < 2e-3
    lost = 0.1 * left[:, -1]
    assert np.linalg.norm(np.linalg.pinv(jacobian) @ lost) > 50.0
    assert np.linalg.norm(arm.motion(joints, jacobian, lost).rates_rad_s) < 0.5
    # The other directions stay exact.
    kept = 0.1 * left[:, 0]
    moved = jacobian @ arm.motion(joints, jacobian, kept).rates_rad_s
    assert moved @ kept == pytest.approx(kept @ kept, rel=1e-2)


def test_a_joint_comes_to_rest_at_its_limit_and_the_others_make_up_for_it(arm):
    joints = COMFORTABLE_JOINTS_RAD.copy()
    wanted = np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    pushed = int(np.argmax(arm.motion(joints, arm.jacobian(joints), wanted).rates_rad_s))
    arm.upper_rad = arm.upper_rad.copy()
    arm.upper_rad[pushed] = joints[pushed]
    jacobian = arm.jacobian(joints)
    motion = arm.motion(joints, jacobian, wanted)
    assert motion.at_limit == (pushed,)
    assert motion.rates_rad_s[pushed] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(jacobian @ motion.rates_rad_s, wanted, atol=1e-9)
