# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a launch file starts, with which ROS arguments, where the library `launch` is not installed.

It comes with a ROS installation only. What launch files of this package use of it stands in here.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).parents[2]
SHARED = "dotsim_ros.nodes.common.launch_arguments"


class Configurations(dict[str, str]):
    """Arguments of a launch, and which of them were read."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.read: set[str] = set()

    def __getitem__(self, name: str) -> str:
        self.read.add(name)
        return super().__getitem__(name)


class Context:
    """The arguments of a launch, by name."""

    def __init__(self, given: Mapping[str, str]) -> None:
        self.launch_configurations = Configurations(given)


@dataclass(frozen=True)
class Argument:
    """An argument of a launch file."""

    name: str
    default_value: str


@dataclass(frozen=True)
class Log:
    """A line of the log."""

    msg: str


@dataclass(frozen=True)
class Node:
    """A node to be started."""

    package: str
    executable: str
    name: str = ""
    namespace: str = ""
    arguments: list[str] = field(default_factory=list)
    parameters: list[Any] = field(default_factory=list)
    remappings: list[Any] = field(default_factory=list)
    output: str = ""
    sigterm_timeout: str = ""


@dataclass(frozen=True)
class Started:
    """A node that is started.

    Attributes:
        package: that it comes from.
        executable: its program.
        arguments: all of it, with those after `--ros-args`.
    """

    package: str
    executable: str
    arguments: list[str]


@dataclass(frozen=True)
class Launched:
    """What became of a launch file.

    Attributes:
        nodes: that are started.
        log: its lines.
        declared: names of its arguments.
        read: names of those that were read.
    """

    nodes: list[Started]
    log: list[str]
    declared: set[str]
    read: set[str]


def launched(name: str, **given: str) -> Launched:
    """Return what a launch file starts.

    Args:
        name: of the file below launch.
        given: arguments of the launch.
    """
    with _stand_in():
        path = ROOT / "launch" / name
        specification = importlib.util.spec_from_file_location("launched_file", path)
        assert specification is not None
        assert specification.loader is not None
        module = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(module)
        entities = module.generate_launch_description()
        context = Context(given)
        visited = [found for entity in entities for found in _visited(entity, context)]
    nodes = [node for node in visited if isinstance(node, Node)]
    return Launched(
        [Started(node.package, node.executable, _arguments(node)) for node in nodes],
        [line.msg for line in visited if isinstance(line, Log)],
        {entity.name for entity in entities if isinstance(entity, Argument)},
        context.launch_configurations.read,
    )


def started(name: str, **given: str) -> list[Started]:
    """Return the nodes of this package that a launch file starts; as `launched`."""
    return [node for node in launched(name, **given).nodes if node.package == "dotsim_ros"]


def _visited(entity: Any, context: Context) -> list[Node | Log]:
    if isinstance(entity, Node):
        # It may name a shipped file, or none: the launch ends then before any node starts.
        assert "params_file" in context.launch_configurations.read
        return [entity]
    if isinstance(entity, Log):
        return [entity]
    if isinstance(entity, Argument):
        context.launch_configurations.setdefault(entity.name, entity.default_value)
        return []
    return [found for each in entity(context) or () for found in _visited(each, context)]


def _arguments(node: Node) -> list[str]:
    arguments = [*node.arguments, "--ros-args", "-r", f"__ns:=/{node.namespace.strip('/')}"]
    for path in node.parameters:
        arguments += ["--params-file", path]
    for old, new in node.remappings:
        arguments += ["-r", f"{old}:={new}"]
    return arguments


@contextmanager
def _stand_in() -> Iterator[None]:
    """Let launch files import what they use in the block: names and keywords as the reference of
    ROS 2 Jazzy documents them, and no others."""

    def declared(
        name: str, *, default_value: str, description: str, choices: list[str] | None = None
    ) -> Argument:
        return Argument(name, default_value)

    actions = {
        "DeclareLaunchArgument": declared,
        "LogInfo": Log,
        "OpaqueFunction": lambda function, args=(): lambda context: function(context, *args),
    }
    modules = {
        "launch": {"LaunchContext": Context, "LaunchDescription": list},
        "launch.actions": actions,
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
        "ament_index_python": {},
        "ament_index_python.packages": {"get_package_share_directory": lambda _: str(ROOT)},
    }
    # What launch files share uses the library too.
    kept = {name: sys.modules.pop(name, None) for name in (*modules, SHARED)}
    for name, members in modules.items():
        module = ModuleType(name)
        module.__dict__.update(members)
        sys.modules[name] = module
    try:
        yield
    finally:
        for name, module in kept.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module
