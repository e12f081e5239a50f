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


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    params = Path(get_package_share_directory("dotsim_ros")) / "params"
    arguments = [
        DeclareLaunchArgument("namespace", default_value="", description="of all topics"),
        DeclareLaunchArgument(
            "params_file",
            default_value=str(params / "closed_loop.yaml"),
            description="parameters of all nodes, the policy among them; what is given by the "
            "arguments below goes before it",
        ),
        DeclareLaunchArgument(
            "policy",
            default_value="",
            description="the policy: a folder, or a name below params/policies; empty: as the "
            "parameters say",
        ),
        DeclareLaunchArgument(
            "path",
            default_value="",
            description="which of the policy's paths to follow; empty: as the parameters "
            "say, else the first",
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
            "yours; empty: as the parameters say, else the shipped one",
        ),
        DeclareLaunchArgument(
            "speed",
            default_value="",
            description="simulated seconds for each real one, 0 for as many as the machine "
            "gives; empty: as the parameters say, else 0",
        ),
        DeclareLaunchArgument(
            "one_process",
            default_value="false",
            choices=["true", "false"],
            description="sensor, arm and policy in one process; both are simulated then",
        ),
        *sensor_arguments(),
    ]
    return description(
        arguments,
        OpaqueFunction(function=nodes),
    )


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes, with what is given here."""
    namespace, is_simulated = (
        text_of(context, "namespace"),
        text_of(context, "clock") == "simulated",
    )
    time = {"use_sim_time": is_simulated, "stepped": is_simulated, **given(context, TIME)}
    if is_simulated and not time["use_sim_time"]:
        raise ValueError(
            "clock is simulated and use_sim_time is false: give one of the two, or both alike"
        )
    given_here = given_file(
        namespace,
        {
            "tactile_sim": {**time, **given(context, SENSOR)},
            "xarm_sim": time,
            "tactile_policy": {**time, **given(context, {"policy": str, "path": str})},
            "tactile_record": time,
            # It makes the time that the others go by, for whom a file may set this.
            "time_stepper": {
                "use_sim_time": False,
                **given(context, {"participants": str, "speed": float}),
            },
        },
    )
    parameters = [text_of(context, "params_file"), given_here]
    one_process = LaunchConfiguration("one_process")
    is_apart = NotSubstitution(one_process)
    return [
        Node(
            package="dotsim_ros",
            executable="tactile_sim",
            namespace=namespace,
            parameters=parameters,
            condition=IfCondition(
                AndSubstitution(LaunchConfiguration("simulate_sensor"), is_apart)
            ),
            output="screen",
        ),
        Node(
            package="dotsim_ros",
            executable="xarm_sim",
            namespace=namespace,
            parameters=parameters,
            condition=IfCondition(AndSubstitution(LaunchConfiguration("simulate_arm"), is_apart)),
            output="screen",
        ),
        Node(
            package="dotsim_ros",
            executable="dotsim_closed_loop",
            namespace=namespace,
            parameters=parameters,
            remappings=[("tactile_policy:~/cmd_vel", "cmd_vel")],
            condition=IfCondition(one_process),
            output="screen",
        ),
        Node(
            package="dotsim_ros",
            executable="tactile_policy",
            namespace=namespace,
            parameters=parameters,
            remappings=[("~/cmd_vel", "cmd_vel")],
            condition=UnlessCondition(one_process),
            output="screen",
        ),
        recorder(namespace, parameters),
        Node(
            package="dotsim_ros",
            executable="time_stepper",
            namespace=namespace,
            parameters=parameters,
            condition=IfCondition(EqualsSubstitution(LaunchConfiguration("clock"), "simulated")),
            output="screen",
        ),
    ]
