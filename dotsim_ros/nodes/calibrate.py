"""`ros2 run dotsim_ros calibrate`: the verb `dotsim_ros calibrate` as a ROS executable.

It needs no graph: arguments that ROS adds are dropped, the rest is the verb's.
"""

from __future__ import annotations

import sys

from rclpy.utilities import remove_ros_args

from dotsim_ros.cli.main import main as run_verb


def main() -> int:
    """Run the verb; return its exit status."""
    return run_verb(["calibrate", *remove_ros_args(sys.argv)[1:]])
