# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The launch files under the service of `ros2 launch`: all nodes get ready, and end as they should.

For launch_testing, which comes with a ROS installation, and the package in a sourced workspace, as
`colcon test` has it; skipped elsewhere. test/unit/test_packaging.py and
test/ros/test_launched_parameters.py read the same files anywhere.
"""

from __future__ import annotations

import time
import unittest
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("launch_testing", reason="launch_testing comes with a ROS installation only")

import launch_testing
import launch_testing.actions
import launch_testing.asserts
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from harness import START_PATIENCE_S, Client
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from sensor_msgs.msg import CameraInfo


@pytest.mark.launch_test
@launch_testing.parametrize(
    "name, node_count", [("tactile_sim.launch.py", 1), ("gripper.launch.py", 2)]
)
def generate_test_description(name: str, node_count: int) -> LaunchDescription:
    """Return what is launched; the tests are given the same arguments."""
    try:
        share = Path(get_package_share_directory("dotsim_ros"))
    except PackageNotFoundError:
        raise unittest.SkipTest("the package is in no sourced workspace: colcon build") from None
    source = PythonLaunchDescriptionSource(str(share / "launch" / name))
    return LaunchDescription(
        [IncludeLaunchDescription(source), launch_testing.actions.ReadyToTest()]
    )


class TestRunning(unittest.TestCase):
    """While the nodes run."""

    def test_every_node_gets_ready(self, proc_output: Any, node_count: int) -> None:
        end_s = time.monotonic() + START_PATIENCE_S
        while (log := b"".join(io.text for io in proc_output)).count(b"]: ready: ") < node_count:
            assert time.monotonic() < end_s, log.decode(errors="replace")
            time.sleep(0.1)

    def test_the_fingers_of_a_gripper_are_told_apart_by_their_frames(self, node_count: int) -> None:
        sides = ("left", "right") if node_count == 2 else ()
        frames: dict[str, str] = {}
        client = Client(topics={})
        try:
            for side in sides:
                client.node.create_subscription(
                    CameraInfo,
                    f"{side}/camera_info",
                    lambda message, side=side: frames.update({side: message.header.frame_id}),
                    5,
                )
            client.wait(lambda: len(frames) == len(sides), "both", patience_s=START_PATIENCE_S)
        finally:
            client.close()
        assert frames == {side: f"{side}_densetact_optical_frame" for side in sides}


@launch_testing.post_shutdown_test()
class TestStopped(unittest.TestCase):
    """After the service has sent SIGINT."""

    def test_every_node_ends_with_status_0(self, proc_info: Any) -> None:
        launch_testing.asserts.assertExitCodes(proc_info)
