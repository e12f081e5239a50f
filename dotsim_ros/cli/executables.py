# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Verbs of `dotsim_ros` as ROS executables: `ros2 run dotsim_ros find_gap` and its like.

They need no graph: arguments that ROS adds are dropped, the rest is the verb's.
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


def _run(verb: str) -> int:
    return main([verb, *remove_ros_args(sys.argv)[1:]])
