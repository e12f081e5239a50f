# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a node's user gives it before it runs: the command line, what DDS is set to, and where logs
are written.

ROS and DDS themselves ignore much of what is wrong here. Needs no ROS.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from dotsim_ros.io.documents import value_text
from dotsim_ros.io.files import expanded, usable_folder
from dotsim_ros.nodes.common.parameter_file import (
    check_parameter_file,
    found_parameter_file,
    named_parameters,
)
from dotsim_ros.nodes.common.reasons import HOW
from dotsim_ros.nodes.common.transport import PROFILE_FILES

LARGEST_DOMAIN = 232
PARAMS_FILE = "--params-file"
PARAMETER = ("-p", "--param")


def check_start(arguments: Sequence[str]) -> None:
    """Refuse a command line or an environment that ROS would misread or ignore.

    Args:
        arguments: without the program's name.

    Raises:
        ValueError: an argument that is none of ROS's, one that is no text, a file of parameters
            that holds none, a domain that does not exist, or a profile of Fast DDS that is not
            there.
        OSError: a file cannot be read.
    """
    for argument in arguments:
        if any("\ud800" <= character <= "\udfff" for character in argument):
            raise ValueError(
                f"the argument {value_text(argument)} is no text in UTF-8: write it again"
            )
    for argument in _foreign(arguments):
        raise ValueError(f"the argument {value_text(argument)} is none that nodes take: {HOW}")
    for path in _parameter_files(arguments):
        check_parameter_file(path)
    _check_domain(os.environ.get("ROS_DOMAIN_ID") or "0")
    for name in PROFILE_FILES:
        profile = os.environ.get(name)
        if profile and not Path(profile).is_file():
            raise ValueError(
                f"{name} names {profile}, which is no file, so that DDS would use its defaults: "
                "correct or unset it"
            )


def prepare_log_folder() -> None:
    """Choose a folder that can be written for the logs of ROS, which does not start without one, by
    its own rules where they give one; call it before `rclpy.init`."""
    home = os.environ.get("ROS_HOME")
    try:
        below = expanded(home) if home else Path.home() / ".ros"
    except RuntimeError:  # a user without a home
        below = None
    os.environ["ROS_LOG_DIR"] = str(usable_folder("ROS_LOG_DIR", below and below / "log"))


def _check_domain(text: str) -> None:
    # DDS ends the process where the ports of a domain would be none.
    if not re.fullmatch("[0-9]{1,9}", text) or int(text) > LARGEST_DOMAIN:
        raise ValueError(
            f"ROS_DOMAIN_ID is {value_text(text)}, expected a whole number from 0 to "
            f"{LARGEST_DOMAIN}"
        )


def _foreign(arguments: Sequence[str]) -> Iterator[str]:
    """Yield the arguments that are not between `--ros-args` and `--`."""
    is_ros = False
    for argument in arguments:
        if is_ros:
            is_ros = argument != "--"
        elif argument == "--ros-args":
            is_ros = True
        else:
            yield argument


def with_found_files(arguments: Sequence[str]) -> list[str]:
    """Return a command line with the paths of the shipped files of parameters that it names."""
    flags = ["", *arguments]
    return [
        found_parameter_file(value) if flag == PARAMS_FILE else value
        for flag, value in zip(flags, arguments, strict=False)
    ]


def _parameter_files(arguments: Sequence[str]) -> Iterator[str]:
    for flag, value in pairwise(arguments):
        if flag == PARAMS_FILE:
            yield value


def typed_names(arguments: Sequence[str]) -> set[str]:
    """Return the names of the parameters that a command line itself gives, for whichever node."""
    rules = (value for flag, value in pairwise(arguments) if flag in PARAMETER)
    return {rule.partition(":=")[0].rpartition(":")[2] for rule in rules}


def names_for(arguments: Sequence[str], node: str) -> set[str]:
    """Return the names of the parameters that the files of a command line give to a node by its
    name, not in a section for nodes of any name."""
    found = (_flat(named_parameters(path, node)) for path in _parameter_files(arguments))
    return {name for names in found for name in names}


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"
