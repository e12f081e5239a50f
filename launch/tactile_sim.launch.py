# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up tactile_sim, and on request the player of presses and the recorder.

ros2 launch dotsim_ros tactile_sim.launch.py params_file:=MINE.yaml namespace:=left play:=true
ros2 launch dotsim_ros tactile_sim.launch.py params_file:=drivers/run_camera.yaml
ros2 launch dotsim_ros tactile_sim.launch.py effects:=report/effects_overlay.yaml
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import EqualsSubstitution, IfElseSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from dotsim_ros.nodes.common.parameter_file import check_params_file


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    params = Path(get_package_share_directory("dotsim_ros")) / "params"
    namespace = LaunchConfiguration("namespace")
    record = LaunchConfiguration("record")
    params_file = LaunchConfiguration("params_file")
    effects = LaunchConfiguration("effects")
    # Not given, it must leave the effects of the file alone.
    is_plain = EqualsSubstitution(effects, "")
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="of all topics"),
            DeclareLaunchArgument(
                "params_file",
                default_value=str(params / "tactile_sim.yaml"),
                description="parameters of tactile_sim",
            ),
            DeclareLaunchArgument(
                "effects",
                default_value="",
                description="overlay of effects that find_gap wrote; empty: as the parameters say",
            ),
            DeclareLaunchArgument(
                "play",
                default_value="false",
                choices=["true", "false"],
                description="move the indenter",
            ),
            DeclareLaunchArgument(
                "source",
                default_value="presses",
                choices=["press", "slide", "twist", "presses"],
                description="how: a scripted motion, or the recorded real presses",
            ),
            DeclareLaunchArgument(
                "record",
                default_value="false",
                choices=["true", "false"],
                description="record a bag in the working directory",
            ),
            OpaqueFunction(function=find_file),
            Node(
                package="dotsim_ros",
                executable="tactile_sim",
                namespace=namespace,
                parameters=[params_file],
                condition=IfCondition(is_plain),
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="tactile_sim",
                namespace=namespace,
                parameters=[params_file, {"effects": ParameterValue(effects, value_type=str)}],
                condition=UnlessCondition(is_plain),
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="indenter_player",
                namespace=namespace,
                parameters=[
                    {
                        "source": LaunchConfiguration("source"),
                        # The sensor reads poses once its kernels are compiled and its tables
                        # computed: the recorder alone is no reason to begin.
                        "subscriber_count": IfElseSubstitution(
                            record, if_value="2", else_value="1"
                        ),
                        "wait_for_subscriber_s": 600.0,
                    }
                ],
                condition=IfCondition(LaunchConfiguration("play")),
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="tactile_record",
                namespace=namespace,
                condition=IfCondition(record),
                # The bag appears once all that waits is written: the usual 5 s could lose it.
                sigterm_timeout="60",
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
