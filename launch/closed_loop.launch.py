# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up the closed loop: tactile_sim, tactile_policy, xarm_sim, and on request the recorder.

ros2 launch dotsim_ros closed_loop.launch.py path:=figure_eight record:=true
ros2 service call /tactile_policy/calibrate_idle std_srvs/srv/Trigger
ros2 service call /tactile_policy/set_enabled std_srvs/srv/SetBool "{data: true}"

The arm stays until the last line; docs/closed_loop.md says what to check before it. With
clock:=simulated all nodes go on in the steps of time_stepper: docs/simulated_time.md.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import (
    AndSubstitution,
    EqualsSubstitution,
    LaunchConfiguration,
    NotSubstitution,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from dotsim_ros.nodes.common.parameter_file import check_params_file


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    params = Path(get_package_share_directory("dotsim_ros")) / "params"
    namespace = LaunchConfiguration("namespace")
    params_file = LaunchConfiguration("params_file")
    one_process = LaunchConfiguration("one_process")
    is_apart = NotSubstitution(one_process)
    simulate_sensor = AndSubstitution(LaunchConfiguration("simulate_sensor"), is_apart)
    simulate_arm = AndSubstitution(LaunchConfiguration("simulate_arm"), is_apart)
    is_simulated = EqualsSubstitution(LaunchConfiguration("clock"), "simulated")
    time = {"use_sim_time": is_simulated, "stepped": is_simulated}
    policy = {
        "policy": ParameterValue(LaunchConfiguration("policy"), value_type=str),
        "path": ParameterValue(LaunchConfiguration("path"), value_type=str),
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="of all topics"),
            DeclareLaunchArgument(
                "params_file",
                default_value=str(params / "closed_loop.yaml"),
                description="parameters of all nodes",
            ),
            DeclareLaunchArgument(
                "policy",
                default_value="densetact2_sphere",
                description="the policy: a folder, or a name below params/policies",
            ),
            DeclareLaunchArgument(
                "path",
                default_value="",
                description="which of the policy's paths to follow; empty: the first",
            ),
            DeclareLaunchArgument(
                "simulate_sensor",
                default_value="true",
                choices=["true", "false"],
                description="false: the real sensor's driver publishes the images",
            ),
            DeclareLaunchArgument(
                "simulate_arm",
                default_value="true",
                choices=["true", "false"],
                description="false: the real arm's adapter is started on its own",
            ),
            DeclareLaunchArgument(
                "record",
                default_value="false",
                choices=["true", "false"],
                description="record a bag in the working directory",
            ),
            DeclareLaunchArgument(
                "clock",
                default_value="realtime",
                choices=["realtime", "simulated"],
                description="simulated: in steps that all nodes take together, by time_stepper",
            ),
            DeclareLaunchArgument(
                "participants",
                default_value="",
                description="file of those whom simulated time waits for, of these nodes and of "
                "yours; empty: the shipped one",
            ),
            DeclareLaunchArgument(
                "speed",
                default_value="0",
                description="simulated seconds for each real one; 0: as many as the machine gives",
            ),
            DeclareLaunchArgument(
                "one_process",
                default_value="false",
                choices=["true", "false"],
                description="sensor, arm and policy in one process; both are simulated then",
            ),
            OpaqueFunction(function=find_file),
            Node(
                package="dotsim_ros",
                executable="closed_loop",
                namespace=namespace,
                parameters=[params_file, time, policy],
                remappings=[("tactile_policy:~/cmd_vel", "cmd_vel")],
                condition=IfCondition(one_process),
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="tactile_sim",
                namespace=namespace,
                parameters=[params_file, time],
                condition=IfCondition(simulate_sensor),
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="xarm_sim",
                namespace=namespace,
                parameters=[params_file, time],
                condition=IfCondition(simulate_arm),
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="tactile_policy",
                namespace=namespace,
                parameters=[params_file, time, policy],
                remappings=[("~/cmd_vel", "cmd_vel")],
                condition=UnlessCondition(one_process),
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="tactile_record",
                namespace=namespace,
                parameters=[params_file, time],
                condition=IfCondition(LaunchConfiguration("record")),
                # The bag appears once all that waits is written: the usual 5 s could lose it.
                sigterm_timeout="60",
                output="screen",
            ),
            Node(
                package="dotsim_ros",
                executable="time_stepper",
                namespace=namespace,
                parameters=[
                    {
                        "participants": ParameterValue(
                            LaunchConfiguration("participants"), value_type=str
                        ),
                        "speed": ParameterValue(LaunchConfiguration("speed"), value_type=float),
                        # A first start compiles the gel's kernels and computes its tables.
                        "patience_s": 600.0,
                    }
                ],
                condition=IfCondition(is_simulated),
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
