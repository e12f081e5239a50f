# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up tactile_sim on the links of a running Gazebo, the bridge between them, and two frames.

ros2 launch dotsim_ros gazebo.launch.py world:=WORLD sensor_model:=arm sensor_link:=arm::tool

Needs ros_gz_bridge and tf2_ros; docs/simulators.md says what the world's models and systems must
publish and take. Topics and types are those of Gazebo's systems PosePublisher (gz.msgs.Pose_V on
/model/NAME/pose) and ApplyLinkWrench (gz.msgs.EntityWrench on /world/NAME/wrench), and of the table
of types of ros_gz_bridge.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from dotsim_ros.nodes.common.launch_arguments import (
    SENSOR,
    TIME,
    description,
    given,
    given_file,
    sensor_arguments,
    text_of,
)


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    params = Path(get_package_share_directory("dotsim_ros")) / "params"
    world = LaunchConfiguration("world")
    sensor_link = LaunchConfiguration("sensor_link")
    indenter_link = LaunchConfiguration("indenter_link")
    sensor_poses = ["/model/", LaunchConfiguration("sensor_model"), "/pose"]
    indenter_poses = ["/model/", LaunchConfiguration("indenter_model"), "/pose"]
    wrenches = ["/world/", world, "/wrench"]
    arguments = [
        DeclareLaunchArgument("world", default_value="default", description="Gazebo's world"),
        DeclareLaunchArgument(
            "sensor_model", default_value="arm", description="model that carries the sensor"
        ),
        DeclareLaunchArgument(
            "sensor_link", default_value="arm::tool", description="link that carries it"
        ),
        DeclareLaunchArgument(
            "base_z", default_value="0.05", description="of the sensor's base on that link (m)"
        ),
        DeclareLaunchArgument(
            "sensor_centre_m",
            default_value="[0.0, 0.0, -0.05]",
            description="centre of mass of that link, in the frame of the sensor's base",
        ),
        DeclareLaunchArgument(
            "indenter_model", default_value="peg", description="model that presses"
        ),
        DeclareLaunchArgument(
            "indenter_link", default_value="peg::link", description="link that presses"
        ),
        DeclareLaunchArgument(
            "tip_z",
            default_value="0.02",
            description="of the tip on that link (m); the link's +z is towards the gel",
        ),
        DeclareLaunchArgument(
            "indenter_centre_m",
            default_value="[0.0, 0.0, 0.02]",
            description="centre of mass of that link, in the frame of the tip",
        ),
        DeclareLaunchArgument(
            "params_file",
            default_value=str(params / "simulators/gazebo.yaml"),
            description="parameters of tactile_sim; what is given by the other arguments goes "
            "before it",
        ),
        *sensor_arguments(),
    ]
    return description(
        arguments,
        Node(
            package="ros_gz_bridge",
            executable="parameter_bridge",
            arguments=[
                [*sensor_poses, "@tf2_msgs/msg/TFMessage[gz.msgs.Pose_V"],
                [*indenter_poses, "@tf2_msgs/msg/TFMessage[gz.msgs.Pose_V"],
                "/clock@rosgraph_msgs/msg/Clock[gz.msgs.Clock",
                [*wrenches, "@ros_gz_interfaces/msg/EntityWrench]gz.msgs.EntityWrench"],
            ],
            remappings=[(sensor_poses, "/tf"), (indenter_poses, "/tf")],
            output="screen",
        ),
        Node(
            package="tf2_ros",
            executable="static_transform_publisher",
            name="sensor_base",
            arguments=[
                "--z",
                LaunchConfiguration("base_z"),
                "--frame-id",
                sensor_link,
                "--child-frame-id",
                "densetact_base",
            ],
        ),
        Node(
            package="tf2_ros",
            executable="static_transform_publisher",
            name="indenter_tip",
            arguments=[
                "--z",
                LaunchConfiguration("tip_z"),
                "--roll",
                "3.14159265",
                "--frame-id",
                indenter_link,
                "--child-frame-id",
                "indenter",
            ],
        ),
        OpaqueFunction(function=sensor),
    )


def sensor(context: LaunchContext) -> list[Node]:
    """Return the sensor, with what is given here."""
    links = given(
        context,
        {
            "world": str,
            "sensor_link": str,
            "sensor_centre_m": list,
            "indenter_link": str,
            "indenter_centre_m": list,
        },
    )
    names = {
        "world": "world_frame",
        "sensor_link": "entity_sensor",
        "sensor_centre_m": "entity_sensor_centre_m",
        "indenter_link": "entity_indenter",
        "indenter_centre_m": "entity_indenter_centre_m",
    }
    given_here = {
        **{names[name]: value for name, value in links.items()},
        **given(context, {**SENSOR, **TIME}),
    }
    return [
        Node(
            package="dotsim_ros",
            executable="tactile_sim",
            parameters=[
                text_of(context, "params_file"),
                given_file("", {"tactile_sim": given_here}),
            ],
            remappings=[("entity_wrench", f"/world/{text_of(context, 'world')}/wrench")],
            output="screen",
        )
    ]
