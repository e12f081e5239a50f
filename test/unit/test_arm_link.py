# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a real arm is told and when it is left alone; the units of its driver. Without ROS."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dotsim_ros.control.arm.command import check_plausible
from dotsim_ros.nodes.xarm_adapter.link import Hindrance, VelocityLink
from dotsim_ros.nodes.xarm_adapter.parameters import XarmAdapterParameters
from msg_adapters import decode_robot_state, encode_move_velocity


def robot_message(**changes):
    """Return an object with the public fields of xarm_msgs/RobotMsg."""
    fields = {
        "state": 2,
        "mode": 5,
        "err": 0,
        "warn": 0,
        "angle": np.zeros(7, dtype=np.float32),
        "pose": np.array([206.0, 0.0, 120.5, np.pi, 0.0, 0.0], dtype=np.float32),
    }
    return SimpleNamespace(**{**fields, **changes})


def ready_link(now_s=0.0, **limits):
    link = VelocityLink(XarmAdapterParameters(**limits))
    link.hear(decode_robot_state(robot_message()), now_s)
    return link


def velocity(x=0.0):
    return np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_millimetres_and_roll_pitch_yaw_become_a_pose():
    robot = decode_robot_state(
        robot_message(pose=[350.0, -20.0, 300.0, 3.0, 0.2, -1.1], angle=[0.1] * 7, err=3, warn=4)
    )
    np.testing.assert_allclose(robot.position_m, [0.35, -0.02, 0.3])
    # Fixed axes x, y, z: the capital letters of SciPy turn with the body.
    expected = Rotation.from_euler("xyz", [3.0, 0.2, -1.1])
    found = Rotation.from_quat(robot.quaternion_xyzw)
    assert (found * expected.inv()).magnitude() == pytest.approx(0.0, abs=1e-9)
    assert (robot.error, robot.warning, robot.mode, robot.state) == (3, 4, 5, 2)
    np.testing.assert_allclose(robot.joints_rad, 0.1)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"pose": [0.0, 0.0, np.nan, 0.0, 0.0, 0.0]}, "pose of the arm holds"),
        ({"pose": [0.0] * 5}, "pose of the arm needs 6"),
        ({"angle": [np.inf] * 7}, "joint angles of the arm"),
    ],
)
def test_a_broken_state_is_refused(changes, reason):
    with pytest.raises(ValueError, match=reason):
        decode_robot_state(robot_message(**changes))


@pytest.mark.parametrize("duration_s", [0.0, -1.0, np.nan, np.inf])
def test_a_velocity_without_an_end_is_refused(duration_s):
    with pytest.raises(ValueError, match="expected more than 0"):
        encode_move_velocity(np.zeros(3), np.zeros(3), along_tool=False, duration_s=duration_s)


def test_a_command_is_called_and_shortened_to_the_limits():
    link = ready_link(speed_limit_m_s=0.1, angular_speed_limit_rad_s=0.5)
    link.command(np.array([3.0, 4.0, 0.0, 0.0, 0.0, 2.0]), 0.0, along_tool=True)
    call = link.next_call(0.01, has_service=True)
    np.testing.assert_allclose(call.twist, [0.06, 0.08, 0.0, 0.0, 0.0, 0.5])
    assert call.along_tool


def test_one_call_is_under_way_at_most_and_the_newest_command_follows():
    link = ready_link()
    link.command(velocity(0.01), 0.0, along_tool=False)
    assert link.next_call(0.01, has_service=True).twist[0] == 0.01
    for index, speed in enumerate((0.02, 0.03)):
        link.command(velocity(speed), 0.02 + 0.01 * index, along_tool=False)
        assert link.next_call(0.025 + 0.01 * index, has_service=True) is None
    link.answered(0, "")
    assert link.next_call(0.05, has_service=True).twist[0] == 0.03
    assert link.counts["held_back"] == 2


def test_an_old_command_becomes_zero_until_zero_is_answered_then_nothing():
    link = ready_link(stale_s=0.1)
    assert link.next_call(0.0, has_service=True) is None
    link.command(velocity(0.05), 0.0, along_tool=True)
    assert link.next_call(0.05, has_service=True).twist.any()
    link.answered(0, "")
    stop = link.next_call(0.101, has_service=True)
    assert not stop.twist.any()
    # A stop that is refused is repeated.
    link.answered(9, "not ready")
    assert not link.next_call(0.12, has_service=True).twist.any()
    assert link.last_refusal == "the driver answers 9: not ready"
    link.answered(0, "")
    assert link.next_call(0.14, has_service=True) is None


def test_an_answer_that_does_not_come_is_given_up():
    link = ready_link(answer_s=0.2, silence_s=10.0)
    link.command(velocity(0.05), 0.0, along_tool=False)
    assert link.next_call(0.0, has_service=True) is not None
    assert link.next_call(0.19, has_service=True) is None
    # By now the command is old: what follows is zero.
    assert not link.next_call(0.21, has_service=True).twist.any()
    assert link.counts["failed"] == 1
    assert "no answer within 0.2 s" in link.last_refusal


@pytest.mark.fault("messages", "`cmd_vel` of 100 m/s")
def test_a_command_that_no_arm_follows_counts_as_zero(answered):
    with pytest.raises(ValueError, match="millimetres") as caught:
        check_plausible(velocity(100.0))
    answered(caught.value)
    for number in (np.nan, np.inf):
        with pytest.raises(ValueError, match="not finite"):
            check_plausible(velocity(number))
    link = ready_link()
    link.command(velocity(0.05), 0.0, along_tool=False)
    link.next_call(0.01, has_service=True)
    link.answered(0, "")
    link.drop()
    assert not link.next_call(0.03, has_service=True).twist.any()


@pytest.mark.fault("messages", "the arm's state says that its tool is 350 m away")
def test_a_state_that_no_arm_is_in_is_not_kept(answered):
    link = ready_link()
    with pytest.raises(ValueError, match="millimetres") as caught:
        link.hear(decode_robot_state(robot_message(pose=[350e3, 0, 0, 0, 0, 0])), 0.1)
    assert link.robot.position_m[0] == pytest.approx(0.206)
    answered(caught.value)


@pytest.mark.parametrize(
    ("changes", "hindrance", "words"),
    [
        ({"err": 24}, Hindrance.ERROR, "error 24"),
        ({"mode": 0}, Hindrance.MODE, "mode 0, expected 5"),
        ({"state": 4}, Hindrance.STATE, "stopped"),
        ({"err": 1, "mode": 0, "state": 4}, Hindrance.ERROR, "error 1"),
    ],
)
def test_an_arm_that_is_not_ready_is_not_commanded_and_why_is_said(changes, hindrance, words):
    link = ready_link()
    link.command(velocity(0.05), 0.0, along_tool=False)
    link.hear(decode_robot_state(robot_message(**changes)), 0.01)
    assert link.next_call(0.02, has_service=True) is None
    assert link.hindrance is hindrance
    assert words in link.detail
    link.hear(decode_robot_state(robot_message()), 0.03)
    assert link.next_call(0.04, has_service=True) is not None
    assert link.hindrance is Hindrance.NONE


def test_an_arm_that_is_not_heard_of_is_not_commanded():
    link = VelocityLink(XarmAdapterParameters(silence_s=0.5))
    link.command(velocity(0.05), 0.0, along_tool=False)
    assert link.next_call(0.0, has_service=True) is None
    assert "has not been received" in link.detail
    link.hear(decode_robot_state(robot_message()), 0.0)
    assert link.next_call(0.05, has_service=True) is not None
    link.answered(0, "")
    link.command(velocity(0.05), 0.51, along_tool=False)
    assert link.next_call(0.52, has_service=True) is None
    assert link.hindrance is Hindrance.SILENT
    link.hear(decode_robot_state(robot_message()), 0.53)
    assert link.next_call(0.54, has_service=False) is None
    assert link.hindrance is Hindrance.NO_SERVICE
