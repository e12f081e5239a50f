"""`ros2 run dotsim_ros plan_gap`: the verb `dotsim_ros plan-gap` as a ROS executable."""

from __future__ import annotations

from dotsim_ros.nodes.verb import run_as_executable


def main() -> int:
    """Run the verb; return its exit status."""
    return run_as_executable("plan-gap")
