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
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from dotsim_ros.nodes.common.parameter_file import check_params_file
from dotsim_ros.nodes.indenter_player.launched import player_parameters


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    params = Path(get_package_share_directory("dotsim_ros")) / "params"
    namespace = LaunchConfiguration("namespace")
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
                description="parameters of tactile_sim, or of all nodes; those of the player and "
                "the recorder alone stand below /**/indenter_player and /**/tactile_record",
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
                default_value="",
                choices=["", "press", "slide", "twist", "presses"],
                description="how: a scripted motion, or the recorded real presses, for a dome; "
                "empty: as the parameters say, else presses",
            ),
            DeclareLaunchArgument(
                "record",
                default_value="false",
                choices=["true", "false"],
                description="record a bag in the working directory: the topics that the "
                "parameters name",
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
                # Named, what is given is this node's and wins over what the file says of it.
                name="tactile_sim",
                namespace=namespace,
                parameters=[params_file, {"effects": ParameterValue(effects, value_type=str)}],
                condition=UnlessCondition(is_plain),
                output="screen",
            ),
            OpaqueFunction(function=player),
            Node(
                package="dotsim_ros",
                executable="tactile_record",
                namespace=namespace,
                parameters=[params_file],
                condition=IfCondition(LaunchConfiguration("record")),
                # The bag appears once all that waits is written: the usual 5 s could lose it.
                sigterm_timeout="60",
                output="screen",
            ),
        ]
    )


def player(context: LaunchContext) -> list[Node]:
    """Return the player of presses, which is told of the sensor what the parameters say."""
    params_file = LaunchConfiguration("params_file")
    namespace = LaunchConfiguration("namespace")
    parameters = player_parameters(
        params_file.perform(context),
        namespace=namespace.perform(context),
        source=LaunchConfiguration("source").perform(context),
        is_recorded=LaunchConfiguration("record").perform(context) == "true",
    )
    # Of a text launch would make a number where it can.
    typed = {
        name: ParameterValue(value, value_type=str) if isinstance(value, str) else value
        for name, value in parameters.items()
    }
    return [
        Node(
            package="dotsim_ros",
            executable="indenter_player",
            # Named, as above.
            name="indenter_player",
            namespace=namespace,
            parameters=[params_file, typed],
            condition=IfCondition(LaunchConfiguration("play")),
            output="screen",
        )
    ]


def find_file(context: LaunchContext) -> None:
    """Make params_file a path, that of a shipped file where it names one.

    A wrong one raises a ValueError, which ends the launch before a node starts.
    """
    given = LaunchConfiguration("params_file").perform(context)
    context.launch_configurations["params_file"] = check_params_file(given)
