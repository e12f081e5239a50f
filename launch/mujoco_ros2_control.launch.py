# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up tactile_sim next to a running mujoco_ros2_control.

ros2 launch dotsim_ros mujoco_ros2_control.launch.py peg_x:=0.4 peg_z:=0.1
ros2 launch dotsim_ros mujoco_ros2_control.launch.py source:=free_body indenter_frame:=ball

source:=arm: an arm presses the sensor on a fixed peg. robot_state_publisher makes /tf of the joint
states, with the sensor's base as the frame densetact_base of its URDF; the peg's tip stands in
`world`, at the place given here.

source:=free_body: a free body presses a sensor at the world's origin. The hardware interface
publishes nav_msgs/Odometry of the joint `odom_free_joint_name` on `odom_topic`, in the frame
`odom`, with the body's name as child_frame_id. docs/simulators.md says how the force goes back.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import OpaqueFunction
from launch_ros.actions import Node

from dotsim_ros.nodes.common.launch_arguments import (
    SENSOR,
    TIME,
    argument,
    description,
    given,
    given_file,
    own_node,
    parameter_file_argument,
    sensor_arguments,
    static_transform,
    text_of,
)


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    arguments = [
        argument(
            "source",
            "what moves: the arm with the sensor, or the body that presses",
            "arm",
            choices=["arm", "free_body"],
        ),
        argument(
            "indenter_frame",
            "frame of the peg's tip, +z away from the gel; or name of the body",
            "peg",
        ),
        argument("peg_x", "of the tip (m)", "0.0"),
        argument("peg_y", "of the tip (m)", "0.0"),
        argument("peg_z", "of the tip (m)", "0.0"),
        argument("peg_roll", "of the tip (rad)", "3.14159265"),
        argument(
            "odom_topic", "topic of the free body's odometry", "/simulator/floating_base_state"
        ),
        parameter_file_argument(
            "simulators/mujoco_ros2_control.yaml",
            "parameters of tactile_sim; what is given by the other arguments goes before it",
        ),
        *sensor_arguments(),
    ]
    return description(arguments, OpaqueFunction(function=nodes))


def nodes(context: LaunchContext) -> list[Node]:
    """Return the sensor, with what is given here, and the place of the peg where an arm moves."""
    source: dict[str, str] = {"pose_source": "odometry", "base_frame": "odom"}
    found = []
    if text_of(context, "source") == "arm":
        source = {"pose_source": "tf"}
        place = {axis: text_of(context, f"peg_{axis}") for axis in ("x", "y", "z", "roll")}
        found = [static_transform("world", text_of(context, "indenter_frame"), place)]
    given_here = {**source, **given(context, {"indenter_frame": str, **SENSOR, **TIME})}
    files = [text_of(context, "params_file"), given_file("", {"tactile_sim": given_here})]
    return [
        *found,
        own_node(
            "tactile_sim",
            parameters=files,
            remappings=[("indenter/odometry", text_of(context, "odom_topic"))],
        ),
    ]
