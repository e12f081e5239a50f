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

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
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
    is_arm = EqualsSubstitution(LaunchConfiguration("source"), "arm")
    arguments = [
        DeclareLaunchArgument(
            "source",
            default_value="arm",
            choices=["arm", "free_body"],
            description="what moves: the arm with the sensor, or the body that presses",
        ),
        DeclareLaunchArgument(
            "indenter_frame",
            default_value="peg",
            description="frame of the peg's tip, +z away from the gel; or name of the body",
        ),
        DeclareLaunchArgument("peg_x", default_value="0.0", description="of the tip (m)"),
        DeclareLaunchArgument("peg_y", default_value="0.0", description="of the tip (m)"),
        DeclareLaunchArgument("peg_z", default_value="0.0", description="of the tip (m)"),
        DeclareLaunchArgument(
            "peg_roll", default_value="3.14159265", description="of the tip (rad)"
        ),
        DeclareLaunchArgument(
            "odom_topic",
            default_value="/simulator/floating_base_state",
            description="topic of the free body's odometry",
        ),
        DeclareLaunchArgument(
            "params_file",
            default_value=str(params / "simulators/mujoco_ros2_control.yaml"),
            description="parameters of tactile_sim; what is given by the other arguments goes "
            "before it",
        ),
        *sensor_arguments(),
    ]
    return description(
        arguments,
        Node(
            package="tf2_ros",
            executable="static_transform_publisher",
            arguments=[
                "--x",
                LaunchConfiguration("peg_x"),
                "--y",
                LaunchConfiguration("peg_y"),
                "--z",
                LaunchConfiguration("peg_z"),
                "--roll",
                LaunchConfiguration("peg_roll"),
                "--frame-id",
                "world",
                "--child-frame-id",
                LaunchConfiguration("indenter_frame"),
            ],
            condition=IfCondition(is_arm),
        ),
        OpaqueFunction(function=sensor),
    )


def sensor(context: LaunchContext) -> list[Node]:
    """Return the sensor, with what is given here."""
    if text_of(context, "source") == "arm":
        source = {"pose_source": "tf"}
    else:
        source = {"pose_source": "odometry", "base_frame": "odom"}
    given_here = {**source, **given(context, {"indenter_frame": str, **SENSOR, **TIME})}
    return [
        Node(
            package="dotsim_ros",
            executable="tactile_sim",
            parameters=[
                text_of(context, "params_file"),
                given_file("", {"tactile_sim": given_here}),
            ],
            remappings=[("indenter/odometry", text_of(context, "odom_topic"))],
            output="screen",
        )
    ]
