# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a file of ROS parameters must be, for nodes and launch files.

Needs neither ROS nor more than NumPy and PyYAML: `ros2 launch` runs in an interpreter of its own,
which may lack what the nodes need.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any

from dotsim_ros.io.documents import read_yaml, value_text
from dotsim_ros.io.files import expanded, parameter_path
from dotsim_ros.nodes.common.reasons import EXPECTED, reason_of

PARAMETERS_KEY = "ros__parameters"
SHARED = "params/"


def found_parameter_file(name: str) -> str:
    """Return the path of a file of parameters: as given, or else below `params/` of the package.

    So the shipped files are found from any folder: `drivers/run_camera.yaml`, and as documents of
    the repository call it `params/drivers/run_camera.yaml`. What is nowhere is returned as given.
    """
    if not name or expanded(name).exists():
        return name and str(expanded(name))
    try:
        found = parameter_path(name.removeprefix(SHARED))
    except FileNotFoundError:
        return name
    return str(found) if found.is_file() else name


def check_parameter_file(path: str) -> None:
    """Refuse a file that holds no parameters of any node.

    Raises:
        FileNotFoundError: no such file.
        OSError: it cannot be opened.
        ValueError: it is no YAML, or names no parameters.
    """
    content = read_yaml(path)
    if not (isinstance(content, dict) and any(_sections(content))):
        raise ValueError(f"{path} holds no parameters; expected {EXPECTED['params file']}")


def check_params_file(name: str) -> str:
    """Return the path of what a launch file was given as `params_file`, or refuse it.

    launch itself warns of a file that is not there and starts the nodes without it, so that all of
    their parameters, limits among them, are the defaults.

    Raises:
        ValueError: the file is not there, cannot be read, or holds no parameters.
    """
    if not name:
        raise ValueError(f"params_file is empty, expected {EXPECTED['params file']}")
    path = found_parameter_file(name)
    try:
        check_parameter_file(path)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"params_file {value_text(path)} is refused and no node is started: {reason_of(error)}"
        ) from error
    return path


def parameters_of(path: str, node: str) -> dict[str, Any]:
    """Return the parameters that a file holds for a node, as ROS reads it: of all sections that
    mean the node the later one counts.

    Args:
        path: of the file, checked.
        node: its name behind its namespace.
    """
    return _merged(_sections_of(path, node))


def named_parameters(path: str, node: str) -> dict[str, Any]:
    """Return the parameters of `parameters_of` without those of sections for nodes of any name,
    which may have another node in mind."""
    return _merged(one for one in _sections_of(path, node) if not one[0].endswith("*"))


def _merged(sections: Iterable[tuple[str, dict[str, Any]]]) -> dict[str, Any]:
    return {name: value for _, values in sections for name, value in values.items()}


def _sections_of(path: str, node: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the sections of a file that mean a node, in order."""
    return [one for one in _sections(read_yaml(path)) if _means(one[0], node)]


def _sections(content: Any, name: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Return the names, which may hold wildcards, and the parameters of the nodes of a file."""
    for key, value in content.items():
        if key == PARAMETERS_KEY and isinstance(value, dict):
            yield name, value
        elif isinstance(value, dict):
            yield from _sections(value, f"{name}/{str(key).strip('/')}")


def _means(section: str, node: str) -> bool:
    """Return whether the name of a section is that of a node: `*` is any part, `**` any number."""
    wildcards = {"*": r"/\w+", "**": r"(/\w+)*"}
    parts = (wildcards.get(part, f"/{re.escape(part)}") for part in _parts(section))
    return re.fullmatch("".join(parts), "".join(f"/{part}" for part in _parts(node))) is not None


def _parts(name: str) -> list[str]:
    return [part for part in name.split("/") if part]
