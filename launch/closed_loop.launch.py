# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Brings up the closed loop: tactile_sim, tactile_policy, xarm_sim, and on request the recorder.

ros2 launch dotsim_ros closed_loop.launch.py path:=figure_eight record:=true
ros2 service call /tactile_policy/calibrate_idle std_srvs/srv/Trigger
ros2 service call /tactile_policy/set_enabled std_srvs/srv/SetBool "{data: true}"

The arm stays until the last line; docs/closed_loop.md says what to check before it. With
clock:=simulated all nodes go on in the steps of time_stepper: docs/simulated_time.md.
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


def generate_launch_description() -> LaunchDescription:
    """Return the description that `ros2 launch` runs."""
    arguments = [
        argument("namespace", "of all topics"),
        parameter_file_argument(
            "closed_loop.yaml",
            "parameters of all nodes, the policy among them; what is given by the "
            "arguments below goes before it",
        ),
        argument(
            "policy",
            "the policy: a folder, or a name below params/policies; empty: as the parameters say",
        ),
        argument(
            "path",
            "which of the policy's paths to follow; empty: as the parameters say, else the first",
        ),
        argument(
            "simulate_sensor",
            "false: the real sensor's driver publishes the images",
            "true",
            choices=SWITCH,
        ),
        argument(
            "simulate_arm",
            "false: the real arm's adapter is started on its own",
            "true",
            choices=SWITCH,
        ),
        argument("record", "record a bag in the working directory", "false", choices=SWITCH),
        argument(
            "clock",
            "simulated: in steps that all nodes take together, by time_stepper",
            "realtime",
            choices=["realtime", "simulated"],
        ),
        argument(
            "participants",
            "file of those whom simulated time waits for, of these nodes and of "
            "yours; empty: as the parameters say, else the shipped one",
        ),
        argument(
            "speed",
            "simulated seconds for each real one, 0 for as many as the machine "
            "gives; empty: as the parameters say, else 0",
        ),
        argument(
            "one_process",
            "sensor, arm and policy in one process; both are simulated then",
            "false",
            choices=SWITCH,
        ),
        *sensor_arguments(),
    ]
    return description(arguments, OpaqueFunction(function=nodes))


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes, with what is given here."""
    namespace = text_of(context, "namespace")
    is_simulated = text_of(context, "clock") == "simulated"
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
    start = partial(own_node, namespace=namespace, parameters=parameters)
    if is_on(context, "one_process"):
        found = [start("dotsim_closed_loop", remappings=[("tactile_policy:~/cmd_vel", "cmd_vel")])]
    else:
        found = [start("tactile_policy", remappings=[("~/cmd_vel", "cmd_vel")])]
        found += [start("tactile_sim")] if is_on(context, "simulate_sensor") else []
        found += [start("xarm_sim")] if is_on(context, "simulate_arm") else []
    found += [recorder(namespace, parameters)] if is_on(context, "record") else []
    return found + ([start("time_stepper")] if is_simulated else [])
