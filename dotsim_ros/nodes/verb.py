"""Runs a verb of `dotsim_ros` as a ROS executable.

It needs no graph: arguments that ROS adds are dropped, the rest is the verb's.
"""

from __future__ import annotations

import sys

from rclpy.utilities import remove_ros_args

from dotsim_ros.cli.main import main


def run_as_executable(verb: str) -> int:
    """Run a verb; return its exit status."""
    return main([verb, *remove_ros_args(sys.argv)[1:]])
