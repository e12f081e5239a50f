# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up two simulated sensors, the fingers of a gripper, in the namespaces left and right.

ros2 launch dotsim_ros gripper.launch.py sensor:=gelsight_mini
ros2 launch dotsim_ros gripper.launch.py params_file:=drivers/dual_compressed.yaml

Frames begin with left_ and right_, so that both sensors are in one tree.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch_ros.actions import Node

from dotsim_ros.nodes.common.launch_arguments import (
    SENSOR,
    TIME,
    description,
    given,
    given_file,
    own_node,
    parameter_file_argument,
    sensor_arguments,
    text_of,
)
from dotsim_ros.nodes.common.parameter_file import named_parameters


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    arguments = [
        parameter_file_argument(
            "tactile_sim.yaml",
            "parameters of both; /left/tactile_sim and /right/tactile_sim in it "
            "are those of one, and only there frame_prefix counts",
        ),
        *sensor_arguments(),
    ]
    return description(
        arguments,
        OpaqueFunction(function=finger, args=["left"]),
        OpaqueFunction(function=finger, args=["right"]),
    )


def finger(context: LaunchContext, side: str) -> list[Node]:
    """Return the sensor of one side."""
    params_file = text_of(context, "params_file")
    own = named_parameters(params_file, f"/{side}/tactile_sim")
    prefix = {} if "frame_prefix" in own else {"frame_prefix": f"{side}_"}
    given_here = {**prefix, **given(context, {**SENSOR, **TIME})}
    return [
        own_node(
            "tactile_sim",
            namespace=side,
            parameters=[params_file, given_file(side, {"tactile_sim": given_here})],
        )
    ]
