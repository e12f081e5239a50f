# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a launch file starts, with which ROS arguments, where the library `launch` is not installed.

It comes with a ROS installation only. What launch files of this package use of it stands in here,
and a node's parameters come in the order and under the names that launch_ros writes them.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]


class Context:
    """The arguments of a launch, by name."""

    def __init__(self, given: Mapping[str, str]) -> None:
        self.launch_configurations = dict(given)


@dataclass(frozen=True)
class Substitution:
    """A text that is known when the launch runs."""

    perform: Callable[[Context], str]


@dataclass(frozen=True)
class ParameterValue:
    """A parameter of a type."""

    value: Any
    value_type: type


@dataclass(frozen=True)
class Node:
    """A node to be started, if its condition holds."""

    package: str
    executable: str
    name: str = ""
    namespace: Any = ""
    arguments: list[Any] = field(default_factory=list)
    parameters: list[Any] = field(default_factory=list)
    remappings: list[Any] = field(default_factory=list)
    condition: Callable[[Context], bool] = lambda _: True
    output: str = ""
    sigterm_timeout: str = ""


@dataclass(frozen=True)
class Started:
    """A node that is started.

    Attributes:
        executable: its program.
        arguments: all of it, from `--ros-args` on.
    """

    executable: str
    arguments: list[str]


def started(name: str, folder: Path, **given: str) -> list[Started]:
    """Return the nodes of this package that a launch file starts.

    Args:
        name: of the file below launch.
        folder: for files of parameters.
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
        nodes = [node for entity in entities for node in _visited(entity, context)]
    return [
        Started(node.executable, _arguments(node, context, folder))
        for node in nodes
        if node.package == "dotsim_ros" and node.condition(context)
    ]


def _visited(entity: Any, context: Context) -> list[Node]:
    if isinstance(entity, Node):
        return [entity]
    if isinstance(entity, tuple):
        argument, default = entity
        context.launch_configurations.setdefault(argument, default)
        return []
    return entity(context) or []


def _arguments(node: Node, context: Context, folder: Path) -> list[str]:
    namespace = "/" + _text(node.namespace, context).strip("/")
    arguments = ["--ros-args", "-r", f"__ns:={namespace}"]
    if node.name:
        arguments += ["-r", f"__node:={node.name}"]
    for entry in node.parameters:
        path = _text(entry, context) if isinstance(entry, Substitution) else ""
        if not path:
            values = {name: _value(value, context) for name, value in entry.items()}
            # Of a node whose name launch does not know they are for any.
            section = f"{namespace.rstrip('/')}/{node.name}" if node.name else "/**"
            path = str(folder / f"launch_params_{len(list(folder.iterdir()))}.yaml")
            Path(path).write_text(yaml.dump({section: {"ros__parameters": values}}))
        arguments += ["--params-file", path]
    for old, new in node.remappings:
        arguments += ["-r", f"{old}:={new}"]
    return arguments


def _text(value: Any, context: Context) -> str:
    return value.perform(context) if isinstance(value, Substitution) else str(value)


def _value(value: Any, context: Context) -> Any:
    if isinstance(value, ParameterValue):
        return value.value_type(_text(value.value, context))
    if isinstance(value, str | Substitution):
        return yaml.safe_load(_text(value, context))
    return value


def _is_true(value: Any, context: Context) -> bool:
    return _text(value, context) == "true"


def _word(is_so: bool) -> str:
    return "true" if is_so else "false"


@contextmanager
def _stand_in() -> Iterator[None]:
    """Let launch files import what they use in the block."""
    conditions = {
        "IfCondition": lambda value: lambda context: _is_true(value, context),
        "UnlessCondition": lambda value: lambda context: not _is_true(value, context),
    }
    substitutions = {
        "LaunchConfiguration": lambda name: Substitution(
            lambda context: context.launch_configurations[name]
        ),
        "EqualsSubstitution": lambda one, other: Substitution(
            lambda context: _word(_text(one, context) == _text(other, context))
        ),
        "NotSubstitution": lambda value: Substitution(
            lambda context: _word(not _is_true(value, context))
        ),
        "AndSubstitution": lambda one, other: Substitution(
            lambda context: _word(_is_true(one, context) and _is_true(other, context))
        ),
    }
    actions = {
        "DeclareLaunchArgument": lambda name, default_value, **_: (name, default_value),
        "OpaqueFunction": lambda function: function,
    }
    modules = {
        "launch": {"LaunchContext": Context, "LaunchDescription": list},
        "launch.actions": actions,
        "launch.conditions": conditions,
        "launch.substitutions": substitutions,
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
        "launch_ros.parameter_descriptions": {"ParameterValue": ParameterValue},
        "ament_index_python": {},
        "ament_index_python.packages": {"get_package_share_directory": lambda _: str(ROOT)},
    }
    kept = {name: sys.modules.get(name) for name in modules}
    for name, members in modules.items():
        module = ModuleType(name)
        module.__dict__.update(members)
        sys.modules[name] = module
    try:
        yield
    finally:
        for name, module in kept.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
