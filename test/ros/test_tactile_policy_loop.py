# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole loop over DDS: tactile_sim, xarm_sim and tactile_policy, with faults of the other two.

The network is a small one that goes sideways, whatever it sees: this is about the loop.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from harness import Executable, running
from policy_rig import FOLLOWED, MODULE, Observer, stopping_times_s, write_network

SENSOR = "dotsim_ros.nodes.tactile_sim.node"
SLACK_S = 0.25
"""What a busy machine may add to 80 ms and to the arm's own answer."""


@dataclass
class Loop:
    """The sensor and somebody who looks; the arm is in the air above the indenter."""

    sensor: Executable
    seen: Observer


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loop]:
    parameters = {
        "policy": write_network(tmp_path_factory.mktemp("policy") / "steady"),
        "maximum_image_distance": 1e6,
        "diagnostics_period_s": 0.1,
        "force_limit_n": 5.0,
        # It goes on sideways for as long as the tests take.
        "workspace_m": "[0.6, 0.6, 0.6]",
    }
    remap = ("-r", "~/cmd_vel:=cmd_vel")
    with (
        running(SENSOR) as sensor,
        running("dotsim_ros.nodes.xarm_sim.node"),
        running(MODULE, parameters=parameters, arguments=remap),
        observer() as seen,
    ):
        loop = Loop(sensor, seen)
        try:
            yield loop
        finally:
            loop.sensor.end()


@pytest.fixture
def loop(started: Loop) -> Loop:
    move(started)
    return started


def move(started: Loop) -> None:
    """Let the arm move, with another sensor where one was killed."""
    seen = started.seen
    if started.sensor.process.poll() is not None:
        started.sensor = Executable(SENSOR)
        started.sensor.wait_for_line("ready:")
    if not seen.newest().moves():
        seen.enable(False)
        seen.calibrate()
        seen.wait(lambda: seen.enable().success, "the start")
        seen.wait(lambda: seen.newest().moves(), "a motion")


@contextmanager
def observer() -> Iterator[Observer]:
    seen = Observer("", commands="cmd_vel")
    try:
        yield seen
    finally:
        seen.close()


def set_arm(seen: Observer, **values: object) -> None:
    assert seen.set_parameters_of("xarm_sim", **values).successful


def test_the_arm_moves_by_what_the_policy_says(loop: Loop) -> None:
    seen = loop.seen
    seen.wait(lambda: seen.heard, "the first pose of the arm")
    begun_s, start = seen.heard[-1]
    start_m = start.position_m
    seen.wait(lambda: seen.tool.position_m[0] - start_m[0] > 0.002, "the arm to move by 2 mm")
    # By the arm's own stamps: poses may come late, and many at once, where the machine is busy. It
    # may have been stopped for a moment; it has never been too fast.
    ended_s, end = seen.heard[-1]
    moved_m = end.position_m - start_m
    assert moved_m[0] / (ended_s - begun_s) < 1.2 * FOLLOWED[0]
    assert abs(moved_m[1]) < 1e-4


def test_a_pose_stream_that_is_cut_stops_the_arm(loop: Loop) -> None:
    seen = loop.seen

    def stop() -> float:
        set_arm(seen, fail_drop_feedback=False)
        move(loop)
        set_arm(seen, fail_drop_feedback=True)
        seen.wait(lambda: time.time() - seen.last_pose_s > 0.02, "the silence")
        return seen.rest_s(seen.last_pose_s) - seen.last_pose_s

    stopping_times_s(stop, limit_s=0.08 + SLACK_S)
    seen.wait_for_reason("stopped", "pose_stale")
    set_arm(seen, fail_drop_feedback=False)
    seen.wait(lambda: seen.newest().moves(), "the motion to go on")


def test_a_sensor_that_is_killed_stops_the_arm_itself(loop: Loop) -> None:
    seen = loop.seen

    def stop() -> float:
        move(loop)
        killed_s = time.time()
        # In the last test of this file: one after it would have to start another sensor.
        loop.sensor.process.send_signal(signal.SIGKILL)
        return seen.rest_s(killed_s) - killed_s

    stopping_times_s(stop, limit_s=0.08 + SLACK_S)
    state = seen.wait_for_reason("stopped", "force_stale")
    assert "the newest force came" in state.message
    time.sleep(0.5)
    rest_m = seen.tool.position_m
    time.sleep(0.5)
    np.testing.assert_allclose(seen.tool.position_m, rest_m, atol=1e-6)
