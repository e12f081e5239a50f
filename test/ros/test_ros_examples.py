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

from dotsim_ros.nodes.loop.controller_run import Controller, ControllerLoop

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


def test_the_example_of_a_test_is_one() -> None:
    """It takes a minute: one part of it here, the rest for a shorter time below."""
    file = EXAMPLES.joinpath("test_my_controller.py")
    command = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", str(file)]
    done = subprocess.run(
        [*command, "-k", "arm"], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout
    assert "1 passed, 3 deselected" in done.stdout


def test_a_controller_is_tested_in_simulated_time() -> None:
    node = EXAMPLES.joinpath("my_controller.py")
    controller = Controller("my_controller", [sys.executable, str(node)])
    with ControllerLoop(controller, path="line") as loop:
        run = loop.run(2.0)
    assert run.path_error_m < 0.5e-3
    assert 0.1 < run.largest_force_n < 6.0
    assert run.laps > 0.05
    assert not run.stops_s
