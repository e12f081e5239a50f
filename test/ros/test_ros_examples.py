# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The examples for ROS 2, run next to a real `tactile_sim` as a user runs them."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from harness import PATIENCE_S, Executable, running
from programs import program

from dotsim_ros.nodes.loop.closed_loop import LoopFault
from dotsim_ros.nodes.loop.controller_run import ControllerLoop

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name: str, *arguments: str) -> Executable:
    """Start an example."""
    return Executable("", arguments=arguments, script=EXAMPLES / name)


@pytest.mark.timed
def test_a_controller_keeps_a_force_that_a_subscriber_reads() -> None:
    with running():
        subscriber = example("ros_subscriber.py")
        controller = example("ros_controller.py", "-p", "force_n:=0.8")
        try:
            end_s = time.monotonic() + PATIENCE_S
            force_n: list[float] = []
            while not (len(force_n) > 10 and all(abs(one - 0.8) < 0.05 for one in force_n[-10:])):
                assert time.monotonic() < end_s, f"{force_n[-20:]}\n{controller.log}"
                time.sleep(0.2)
                force_n = [float(z) for z in re.findall(r"(-?[\d.]+) N, image", subscriber.log)]
            assert max(force_n) < 1.2
            assert "image (480, 640, 3)" in subscriber.log
            assert subscriber.interrupt() == 0, subscriber.log
            assert controller.interrupt() == 0, controller.log
        finally:
            subscriber.end()
            controller.end()


def test_a_controller_is_tested_in_simulated_time_as_the_example_does() -> None:
    """The example takes a minute: it is collected, and its controller is tested for less time."""
    file = EXAMPLES / "test_my_controller.py"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--collect-only"]
    collected = subprocess.run([*command, str(file)], capture_output=True, text=True, check=False)
    assert "4 tests collected" in collected.stdout, collected.stdout
    example = program("examples/test_my_controller.py")
    assert example.NODE == EXAMPLES / "my_controller.py"
    # What the skin does is not asked here; a coarse grid is made and solved sooner.
    coarse = {"grid_spacing_m": 0.0048}
    with ControllerLoop(example.CONTROLLER, path="line", sensor_parameters=coarse) as loop:
        run = loop.run(2.0)
        assert run.path_error_m < 0.5e-3
        assert 0.1 < run.largest_force_n < 6.0
        assert run.laps > 0.05
        assert not run.stops_s
        example.test_it_stops_where_something_fails(loop, LoopFault.ARM_STOPPED)
