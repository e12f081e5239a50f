# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What may fail for a controller under test does fail, at its time, and takes away no more."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from dotsim_ros.nodes.loop.closed_loop import POSE_DELAY_S, LoopFault, TimedFault
from dotsim_ros.nodes.loop.controller_run import Controller, ControllerLoop, ControllerRun

CODE = """
import rclpy
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import Image

rclpy.init()
node = rclpy.create_node("sideways")
commands = node.create_publisher(TwistStamped, "cmd_vel", 5)

def answer(image):
    command = TwistStamped()
    command.header.stamp, command.header.frame_id = image.header.stamp, "link_tcp"
    command.twist.linear.x = 0.002
    commands.publish(command)

node.create_subscription(Image, "image_raw", answer, 5)
node.create_subscription(PoseStamped, "ee_pose", lambda pose: None, 5)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
"""Goes sideways as long as images come."""
SECONDS = 1.0
STEP_S, FRAME_S = 0.01, 0.04


@pytest.fixture(scope="module")
def loop() -> Iterator[ControllerLoop]:
    controller = Controller("sideways", [sys.executable, "-c", CODE])
    # What the skin does is not asked here; a coarse grid is made and solved sooner.
    with ControllerLoop(controller, sensor_parameters={"grid_spacing_m": 0.0048}) as loop:
        yield loop


def test_a_sensor_on_which_no_path_lies_is_refused() -> None:
    controller = Controller("sideways", [sys.executable, "-c", CODE])
    with pytest.raises(ValueError, match=r"'digit' has the shape .* paths are for a dome"):
        ControllerLoop(controller, sensor="digit")


def led(loop: ControllerLoop, **faults_s: float) -> tuple[ControllerRun, dict[str, float]]:
    """Return a run with faults at times, and when the last message of each kind was stamped."""
    faults = [TimedFault(at_s, LoopFault[name]) for name, at_s in faults_s.items()]
    run = loop.run(SECONDS, faults=faults)
    heard = run.recording
    stamps = {
        "pose": heard.pose_s,
        "frame": heard.frame_s,
        "command": heard.command_s,
        "place": run.time_s,
    }
    return run, {name: float(each[-1]) - run.begun_s for name, each in stamps.items()}


def test_arm_images_and_pose_fail_one_after_the_other(loop: ControllerLoop) -> None:
    run, last_s = led(loop, ARM_STOPPED=0.3, IMAGES_CUT=0.5, POSE_CUT=0.7)
    # The arm stands although commands go on, the force comes without the image, and where the
    # indenter is becomes known without the arm's pose.
    assert run.stops_s == pytest.approx([0.3], abs=2 * STEP_S)
    assert run.stands_from_s == run.stops_s[0]
    # An image comes some time after the stamp that its command repeats.
    assert 0.3 < last_s["command"] < 0.5
    assert last_s["frame"] > SECONDS - 3 * FRAME_S
    assert last_s["pose"] == pytest.approx(0.7, abs=2 * STEP_S)
    assert last_s["place"] > SECONDS - 2 * STEP_S


def test_delay_emergency_stop_and_a_dead_sensor_do_too_once_all_is_healed(
    loop: ControllerLoop,
) -> None:
    run, last_s = led(loop, POSE_DELAYED=0.2, EMERGENCY_STOP=0.7, SENSOR_STOPPED=0.85)
    # No command arrives for 0.3 s, of which the last one holds for 0.2 s; then they go on.
    gap_s, stop_s = run.stops_s
    assert gap_s == pytest.approx(0.2 + 0.2, abs=0.1)
    assert stop_s == pytest.approx(0.7, abs=2 * STEP_S)
    assert run.stands_from_s == stop_s
    assert last_s["pose"] == pytest.approx(SECONDS - POSE_DELAY_S, abs=2 * STEP_S)
    assert 0.7 < last_s["frame"] < 0.85
    assert 0.7 < last_s["command"] < 0.85
    assert last_s["place"] > SECONDS - 2 * STEP_S
