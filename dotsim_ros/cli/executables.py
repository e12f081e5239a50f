# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Verbs of `dotsim_ros` as ROS executables: `ros2 run dotsim_ros dotsim_find_gap` and its like.

They need no graph: arguments that ROS adds are dropped, the rest is the verb's. A sourced workspace
has them on its path, where a plain `calibrate` would not say whose it is.
"""

from __future__ import annotations

import sys

from rclpy.utilities import remove_ros_args

from dotsim_ros.cli.main import main


def calibrate() -> int:
    """Run `dotsim_ros calibrate`; return its exit status."""
    return _run("calibrate")


def find_gap() -> int:
    """Run `dotsim_ros find-gap`; return its exit status."""
    return _run("find-gap")


def plan_gap() -> int:
    """Run `dotsim_ros plan-gap`; return its exit status."""
    return _run("plan-gap")


def calibrate_by_old_name() -> int:
    """Run `calibrate` by the name that it had in 0.1."""
    return _run("calibrate", old_name="calibrate")


def find_gap_by_old_name() -> int:
    """Run `find_gap` by the name that it had in 0.1."""
    return _run("find-gap", old_name="find_gap")


def plan_gap_by_old_name() -> int:
    """Run `plan_gap` by the name that it had in 0.1."""
    return _run("plan-gap", old_name="plan_gap")


def _run(verb: str, old_name: str = "") -> int:
    if old_name:
        print(f"{old_name} is called dotsim_{old_name} now; this name will go", file=sys.stderr)
    return main([verb, *remove_ros_args(sys.argv)[1:]])
