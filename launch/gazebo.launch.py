# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up tactile_sim on the links of a running Gazebo, the bridge between them, and two frames.

ros2 launch dotsim_ros gazebo.launch.py world:=WORLD sensor_model:=arm sensor_link:=arm::tool

Needs ros_gz_bridge and tf2_ros; docs/simulators.md says what the world's models and systems must
publish and take. Topics and types are those of Gazebo's systems PosePublisher (gz.msgs.Pose_V on
/model/NAME/pose) and ApplyLinkWrench (gz.msgs.EntityWrench on /world/NAME/wrench), and of the table
of types of ros_gz_bridge.
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
        argument("world", "Gazebo's world", "default"),
        argument("sensor_model", "model that carries the sensor", "arm"),
        argument("sensor_link", "link that carries it", "arm::tool"),
        argument("base_z", "of the sensor's base on that link (m)", "0.05"),
        argument(
            "sensor_centre_m",
            "centre of mass of that link, in the frame of the sensor's base",
            "[0.0, 0.0, -0.05]",
        ),
        argument("indenter_model", "model that presses", "peg"),
        argument("indenter_link", "link that presses", "peg::link"),
        argument("tip_z", "of the tip on that link (m); the link's +z is towards the gel", "0.02"),
        argument(
            "indenter_centre_m",
            "centre of mass of that link, in the frame of the tip",
            "[0.0, 0.0, 0.02]",
        ),
        parameter_file_argument(
            "simulators/gazebo.yaml",
            "parameters of tactile_sim; what is given by the other arguments goes before it",
        ),
        *sensor_arguments(),
    ]
    return description(arguments, OpaqueFunction(function=nodes))


def nodes(context: LaunchContext) -> list[Node]:
    """Return the bridge, the frames, and the sensor, with what is given here."""
    sensor_poses = f"/model/{text_of(context, 'sensor_model')}/pose"
    indenter_poses = f"/model/{text_of(context, 'indenter_model')}/pose"
    wrenches = f"/world/{text_of(context, 'world')}/wrench"
    tip = {"z": text_of(context, "tip_z"), "roll": "3.14159265"}
    links = {
        "world": ("world_frame", str),
        "sensor_link": ("entity_sensor", str),
        "sensor_centre_m": ("entity_sensor_centre_m", list),
        "indenter_link": ("entity_indenter", str),
        "indenter_centre_m": ("entity_indenter_centre_m", list),
    }
    linked = given(context, {name: kind for name, (_, kind) in links.items()})
    given_here = {
        **{links[name][0]: value for name, value in linked.items()},
        **given(context, {**SENSOR, **TIME}),
    }
    files = [text_of(context, "params_file"), given_file("", {"tactile_sim": given_here})]
    return [
        Node(
            package="ros_gz_bridge",
            executable="parameter_bridge",
            arguments=[
                f"{sensor_poses}@tf2_msgs/msg/TFMessage[gz.msgs.Pose_V",
                f"{indenter_poses}@tf2_msgs/msg/TFMessage[gz.msgs.Pose_V",
                "/clock@rosgraph_msgs/msg/Clock[gz.msgs.Clock",
                f"{wrenches}@ros_gz_interfaces/msg/EntityWrench]gz.msgs.EntityWrench",
            ],
            remappings=[(sensor_poses, "/tf"), (indenter_poses, "/tf")],
            output="screen",
        ),
        static_transform(
            text_of(context, "sensor_link"),
            "densetact_base",
            {"z": text_of(context, "base_z")},
            name="sensor_base",
        ),
        static_transform(text_of(context, "indenter_link"), "indenter", tip, name="indenter_tip"),
        own_node("tactile_sim", parameters=files, remappings=[("entity_wrench", wrenches)]),
    ]
