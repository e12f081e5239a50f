# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Verbs of `dotsim_ros` as ROS executables: `ros2 run dotsim_ros dotsim_find_gap` and its like.

They need no ROS: arguments that it adds are dropped, the rest is the verb's. A sourced workspace
has them on its path, where a plain `calibrate` would not say whose it is.
"""

from __future__ import annotations

import sys
from functools import partial

from dotsim_ros.cli.main import main


def _run(verb: str, old_name: str = "") -> int:
    if old_name:
        print(f"{old_name} is called dotsim_{old_name} now; this name will go", file=sys.stderr)
    try:
        from rclpy.utilities import remove_ros_args
    except ModuleNotFoundError:
        return main([verb, *sys.argv[1:]])
    return main([verb, *remove_ros_args(sys.argv)[1:]])


calibrate = partial(_run, "calibrate")
find_gap = partial(_run, "find-gap")
plan_gap = partial(_run, "plan-gap")
# The names that they had in 0.1.
calibrate_by_old_name = partial(_run, "calibrate", "calibrate")
find_gap_by_old_name = partial(_run, "find-gap", "find_gap")
plan_gap_by_old_name = partial(_run, "plan-gap", "plan_gap")
