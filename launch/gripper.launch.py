# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up two simulated sensors, the fingers of a gripper, in the namespaces left and right.

ros2 launch dotsim_ros gripper.launch.py
ros2 launch dotsim_ros gripper.launch.py params_file:=drivers/dual_compressed.yaml

Frames begin with left_ and right_, so that both sensors are in one tree.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from dotsim_ros.nodes.common.parameter_file import check_params_file


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    params = Path(get_package_share_directory("dotsim_ros")) / "params"
    params_file = LaunchConfiguration("params_file")
    # Last, so that a file of the defaults does not undo it; and first, which gives what is said for
    # any node its place before what the file says of one.
    left = {"frame_prefix": "left_"}
    right = {"frame_prefix": "right_"}
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file",
                default_value=str(params / "tactile_sim.yaml"),
                description="parameters of both; /left/tactile_sim and /right/tactile_sim in it "
                "are those of one, and only there frame_prefix counts",
            ),
            OpaqueFunction(function=find_file),
            Node(
                package="dotsim_ros",
                executable="tactile_sim",
                namespace="left",
                parameters=[left, params_file, left],
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="tactile_sim",
                namespace="right",
                parameters=[right, params_file, right],
                output="screen",
            ),
        ]
    )


def find_file(context: LaunchContext) -> None:
    """Make params_file a path, that of a shipped file where it names one.

    A wrong one raises a ValueError, which ends the launch before a node starts.
    """
    given = LaunchConfiguration("params_file").perform(context)
    context.launch_configurations["params_file"] = check_params_file(given)
