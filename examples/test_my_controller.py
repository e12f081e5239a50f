# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Test a controller, alike on any machine: pytest examples/test_my_controller.py"""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from dotsim_ros.nodes.loop.closed_loop import LoopFault, TimedFault
from dotsim_ros.nodes.loop.controller_run import Controller, ControllerLoop

NODE = Path(__file__).with_name("my_controller.py")
CONTROLLER = Controller("my_controller", [sys.executable, str(NODE)])


@pytest.fixture(scope="module")
def loop() -> Iterator[ControllerLoop]:
    with ControllerLoop(CONTROLLER, path="line") as loop:
        yield loop


def test_it_follows_the_path(loop: ControllerLoop) -> None:
    run = loop.run(20.0)
    assert run.path_error_m < 0.5e-3
    assert run.largest_force_n < 6.0
    assert run.laps > 1.0
    assert not run.stops_s


@pytest.mark.parametrize("fault", [LoopFault.IMAGES_CUT, LoopFault.POSE_CUT, LoopFault.ARM_STOPPED])
def test_it_stops_where_something_fails(loop: ControllerLoop, fault: LoopFault) -> None:
    run = loop.run(3.0, faults=[TimedFault(2.0, fault)])
    assert run.stands_from_s < 2.4
