# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the launch files of this package share: their arguments, as parameters of nodes.

For launch files alone, since it needs the library `launch`; it needs no more of the package than
`parameter_file` does, for the same reason.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch_ros.actions import Node

from dotsim_ros.io.documents import is_number, parse_yaml, value_text
from dotsim_ros.nodes.common.parameter_file import PARAMETERS_KEY, check_params_file
from dotsim_ros.nodes.common.reasons import nearest

SENSOR = {"sensor": str, "indenter": str, "profile": str, "rate_hz": float}
"""Parameters of `tactile_sim` that every launch file takes as arguments, and their types."""
TIME = {"use_sim_time": bool}
"""The one that all nodes of a launch file get."""
_DESCRIBED = {
    "sensor": "sensor to simulate: a name below params/sensors, or a YAML file",
    "indenter": "what presses: a name below params/indenters, a mesh, or a definition",
    "profile": "how accurately the gel is solved: exact, realtime, fast or auto",
    "rate_hz": "frames per second",
    "use_sim_time": "true: the nodes go by /clock",
}
_EXPECTED = {
    float: "a number",
    bool: "true or false",
    list: "a list of numbers, such as [0.0, 0.0, 0.05]",
}
SWITCH = ("true", "false")


def argument(
    name: str, description: str, default: str = "", choices: Sequence[str] | None = None
) -> DeclareLaunchArgument:
    """Return an argument of a launch file."""
    return DeclareLaunchArgument(
        name, default_value=default, description=description, choices=choices
    )


def parameter_file_argument(default: str, description: str) -> DeclareLaunchArgument:
    """Return the argument `params_file`, by default a file below `params/` of the package."""
    params = Path(get_package_share_directory("dotsim_ros")) / "params"
    return argument("params_file", description, str(params / default))


def sensor_arguments() -> list[DeclareLaunchArgument]:
    """Return the arguments `SENSOR` and `TIME`; those that are not given leave the file alone."""
    return [
        argument(name, f"{described}; empty: as the parameters say")
        for name, described in _DESCRIBED.items()
    ]


def description(arguments: Sequence[DeclareLaunchArgument], *actions: Any) -> LaunchDescription:
    """Return the description of a launch file: its arguments, their check, and what it starts."""
    check = OpaqueFunction(function=check_arguments, args=[arguments])
    return LaunchDescription([*arguments, check, *actions])


def own_node(executable: str, **options: Any) -> Node:
    """Return a node of this package; `options` as of `launch_ros.actions.Node`."""
    return Node(package="dotsim_ros", executable=executable, output="screen", **options)


def static_transform(parent: str, child: str, place: Mapping[str, str], **options: Any) -> Node:
    """Return what publishes the place of a child frame in its parent: x, y, z (m) and roll (rad),
    by name. Needs tf2_ros."""
    arguments = [each for axis, value in place.items() for each in (f"--{axis}", value)]
    return Node(
        package="tf2_ros",
        executable="static_transform_publisher",
        arguments=[*arguments, "--frame-id", parent, "--child-frame-id", child],
        **options,
    )


def recorder(namespace: str, parameters: Sequence[str]) -> Node:
    """Return the recorder."""
    return own_node(
        "tactile_record",
        namespace=namespace,
        parameters=parameters,
        # The bag appears once all that waits is written: the usual 5 s could lose it.
        sigterm_timeout="60",
    )


def check_arguments(
    context: LaunchContext, declared: Sequence[DeclareLaunchArgument]
) -> list[LogInfo]:
    """Make `params_file` a path, that of a shipped file where it names one, and name arguments that
    are nearly one of a launch file's: launch ignores what no file declares.

    Raises:
        ValueError: the file is refused, which ends the launch before a node starts.
    """
    given = context.launch_configurations
    given["params_file"] = check_params_file(given["params_file"])
    known = [argument.name for argument in declared]
    # Others may belong to a launch file that includes this one.
    meant = {name: nearest(name, known) for name in given if name not in known}
    return [
        LogInfo(msg=f"the launch argument {name} is not known and has no effect: is it {other}?")
        for name, other in meant.items()
        if other
    ]


def text_of(context: LaunchContext, name: str) -> str:
    """Return an argument as it was given, or its default."""
    return str(context.launch_configurations[name])


def is_on(context: LaunchContext, name: str) -> bool:
    """Return whether an argument of the choices `SWITCH` is true."""
    return text_of(context, name) == "true"


def given(context: LaunchContext, kinds: Mapping[str, type]) -> dict[str, Any]:
    """Return the arguments that are not empty, as values of their types: str, float, bool, or list
    of numbers.

    Raises:
        ValueError: one is of another type.
    """
    texts = {name: text_of(context, name) for name in kinds}
    return {name: _value(name, text, kinds[name]) for name, text in texts.items() if text}


def given_file(namespace: str, parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the path of a new file of parameters, which goes before the files that are named
    before it: each node has a section of its own.

    launch_ros writes such a file too, of what a launch file gives as a dictionary: that is for all
    nodes of a process, and a user's file that names the node goes before it.

    Args:
        namespace: of the nodes.
        parameters: of each node, by its name.
    """
    place = f"/{namespace.strip('/')}".rstrip("/")
    content = {
        f"{place}/{node}": {PARAMETERS_KEY: dict(values)} for node, values in parameters.items()
    }
    with tempfile.NamedTemporaryFile(
        "w", prefix="dotsim_ros_launch_", suffix=".yaml", delete=False, encoding="utf-8"
    ) as stream:
        # YAML in which every text is in quotes, one that looks like a number too.
        json.dump(content, stream, ensure_ascii=False)
    return stream.name


def _value(name: str, text: str, kind: type) -> Any:
    if kind is str:
        return text
    value = parse_yaml(text, f"the launch argument {name}")
    if kind is bool and isinstance(value, bool):
        return value
    if kind is float and is_number(value):
        return float(value)
    if kind is list and isinstance(value, list) and all(map(is_number, value)):
        return [float(number) for number in value]
    raise ValueError(
        f"the launch argument {name} is {value_text(text)}, expected {_EXPECTED[kind]}"
    )
