# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up tactile_sim, and on request the player of presses and the recorder.

ros2 launch dotsim_ros tactile_sim.launch.py sensor:=digit play:=true source:=press
ros2 launch dotsim_ros tactile_sim.launch.py params_file:=MINE.yaml namespace:=left record:=true
ros2 launch dotsim_ros tactile_sim.launch.py params_file:=drivers/run_camera.yaml
ros2 launch dotsim_ros tactile_sim.launch.py effects:=report/effects_overlay.yaml
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from dotsim_ros.nodes.common.launch_arguments import (
    SENSOR,
    TIME,
    description,
    given,
    given_file,
    recorder,
    sensor_arguments,
    text_of,
)
from dotsim_ros.nodes.indenter_player.launched import player_parameters


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    params = Path(get_package_share_directory("dotsim_ros")) / "params"
    arguments = [
        DeclareLaunchArgument("namespace", default_value="", description="of all topics"),
        DeclareLaunchArgument(
            "params_file",
            default_value=str(params / "tactile_sim.yaml"),
            description="parameters of tactile_sim, or of all nodes; those of the player and "
            "the recorder alone stand below /**/indenter_player and /**/tactile_record",
        ),
        *sensor_arguments(),
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
    ]
    return description(
        arguments,
        OpaqueFunction(function=nodes),
    )


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes, with what is given here."""
    namespace, params_file = text_of(context, "namespace"), text_of(context, "params_file")
    time = given(context, TIME)
    player = player_parameters(
        params_file,
        namespace=namespace,
        given=given(context, {"source": str, "sensor": str}),
        is_recorded=text_of(context, "record") == "true",
    )
    given_here = given_file(
        namespace,
        {
            "tactile_sim": {**given(context, {**SENSOR, "effects": str}), **time},
            "indenter_player": {**player, **time},
            "tactile_record": time,
        },
    )
    parameters = [params_file, given_here]
    return [
        Node(
            package="dotsim_ros",
            executable="tactile_sim",
            namespace=namespace,
            parameters=parameters,
            output="screen",
        ),
        Node(
            package="dotsim_ros",
            executable="indenter_player",
            namespace=namespace,
            parameters=parameters,
            condition=IfCondition(LaunchConfiguration("play")),
            output="screen",
        ),
        recorder(namespace, parameters),
    ]
