# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up tactile_sim, and on request the player of presses and the recorder.

ros2 launch dotsim_ros tactile_sim.launch.py sensor:=digit play:=true source:=press
ros2 launch dotsim_ros tactile_sim.launch.py params_file:=MINE.yaml namespace:=left record:=true
ros2 launch dotsim_ros tactile_sim.launch.py params_file:=drivers/run_camera.yaml
ros2 launch dotsim_ros tactile_sim.launch.py effects:=report/effects_overlay.yaml
"""

from functools import partial

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch_ros.actions import Node

from dotsim_ros.nodes.common.launch_arguments import (
    SENSOR,
    SWITCH,
    TIME,
    argument,
    description,
    given,
    given_file,
    is_on,
    own_node,
    parameter_file_argument,
    recorder,
    sensor_arguments,
    text_of,
)
from dotsim_ros.nodes.indenter_player.launched import player_parameters


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    arguments = [
        argument("namespace", "of all topics"),
        parameter_file_argument(
            "tactile_sim.yaml",
            "parameters of tactile_sim, or of all nodes; those of the player and "
            "the recorder alone stand below /**/indenter_player and /**/tactile_record",
        ),
        *sensor_arguments(),
        argument("effects", "overlay of effects that find_gap wrote; empty: as the parameters say"),
        argument("play", "move the indenter", "false", choices=SWITCH),
        argument(
            "source",
            "how: a scripted motion, or the recorded real presses, for a dome; "
            "empty: as the parameters say, else presses",
            choices=["", "press", "slide", "twist", "presses"],
        ),
        argument(
            "record",
            "record a bag in the working directory: the topics that the parameters name",
            "false",
            choices=SWITCH,
        ),
    ]
    return description(arguments, OpaqueFunction(function=nodes))


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes, with what is given here."""
    namespace, params_file = text_of(context, "namespace"), text_of(context, "params_file")
    time = given(context, TIME)
    player = player_parameters(
        params_file,
        namespace=namespace,
        given=given(context, {"source": str, "sensor": str}),
        is_recorded=is_on(context, "record"),
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
    start = partial(own_node, namespace=namespace, parameters=parameters)
    return [
        start("tactile_sim"),
        *([start("indenter_player")] if is_on(context, "play") else []),
        *([recorder(namespace, parameters)] if is_on(context, "record") else []),
    ]
