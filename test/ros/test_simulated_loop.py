# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The closed loop in simulated time: the same messages whatever the machine does meanwhile."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from harness import Executable

from dotsim_ros.control.loop.judge import judge, trial_start
from dotsim_ros.control.policy.paths import DomeContact, reference_path
from dotsim_ros.data.bag import bag_sha256
from dotsim_ros.nodes.loop.closed_loop import (
    ARM,
    POLICY,
    SENSOR,
    ClosedLoop,
    LoopFault,
    LoopSetup,
    TimedFault,
)
from dotsim_ros.nodes.loop.loop_time import SIMULATED, SteppedTime
from dotsim_ros.nodes.loop.observer import LoopObserver
from dotsim_ros.nodes.simulated_time.stepper import StepperSettings
from studies.timing import busy_cores

PATH = "line"
APPROACH_S, FAULT_S, WATCHED_S = 0.7, 1.0, 0.3
APART = (ARM, SENSOR, POLICY)
COMPOSED_MODULE = "dotsim_ros.nodes.closed_loop.node"


@contextmanager
def busy(cores: list[int]) -> Iterator[None]:
    """Keep cores busy, and this process and its children on the last of them."""
    before = os.sched_getaffinity(0)
    with busy_cores(cores):
        os.sched_setaffinity(0, cores[-1:])
        try:
            yield
        finally:
            os.sched_setaffinity(0, before)


@dataclass(frozen=True)
class Led:
    """What became of a loop: its bag's hash and file, its figures, and when it was stopped."""

    sha256: str
    file: bytes
    row: dict[str, Any]
    stopped_s: float


def led(folder: Path, *, order: tuple[str, ...] = APART, one_process: bool = False) -> Led:
    """Lead a loop whose images are cut in the middle."""
    contact = DomeContact()
    path = reference_path(PATH, contact)
    # What the messages are depends on no grid; a coarse one is made and solved sooner.
    coarse = {"grid_spacing_m": 0.0048}
    setup = LoopSetup("densetact2_sphere", sensor_parameters=coarse, one_process=one_process)
    bag = folder / "loop"
    with ClosedLoop(setup, contact=contact, clock=SIMULATED) as loop:
        loop.start(path.name, order=order)
        start_m = trial_start(path, contact, seed=0, number=0)
        faults = [TimedFault(FAULT_S, LoopFault.IMAGES_CUT)]
        recording = loop.trial(start_m, FAULT_S + WATCHED_S, bag=bag, faults=faults)
        assert set(loop.close().values()) == {0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dotsim_ros.control.loop.judge.APPROACH_S", APPROACH_S)
        row = judge(recording, path, setup.limits())
    return Led(bag_sha256(bag), (bag / "loop.mcap").read_bytes(), row, recording.led_s()[1])


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> Led:
    """Return a loop in one process that nothing disturbed."""
    return led(tmp_path_factory.mktemp("quiet"), one_process=True)


def test_a_policy_follows_its_path_until_the_images_are_cut(quiet: Led) -> None:
    assert quiet.row["mean_error_mm"] < 1.0
    assert quiet.row["frame_rate_hz"] == pytest.approx(25.0, abs=0.2)
    assert quiet.row["stops"]["image_stale"] >= 1
    assert not quiet.row["exceeded"]


def test_the_same_in_three_processes_under_load_on_one_core(quiet: Led, tmp_path: Path) -> None:
    with busy(sorted(os.sched_getaffinity(0))[:2]):
        assert led(tmp_path, order=(POLICY, SENSOR, ARM)) == quiet


def test_a_time_off_the_steps_is_rounded_to_them() -> None:
    observer = LoopObserver({}, is_stepped=True)
    try:
        steps = SteppedTime(observer, StepperSettings(period_s=0.01), 1.0)
        steps.expect({})
        steps.go(0.02)
        for seconds, passed_s in ((0.104, 0.1), (0.004, 0.0), (0.096, 0.1)):
            since_ns, asked = steps.now_ns(), iter(range(100))
            # The hundred runs out where it waits for ever.
            steps.watch("of nobody", seconds, lambda asked=asked: next(asked) < 0)
            assert steps.now_ns() - since_ns == round(1e9 * passed_s)
    finally:
        observer.close()


def test_one_process_that_cannot_start_says_why_and_starts_none() -> None:
    node = Executable(COMPOSED_MODULE, {"tactile_policy:policy": "nowhere"})
    try:
        assert node.exit_status() == 2
        assert "cannot start" in node.log
        assert "nowhere" in node.log
        assert "ready" not in node.log
    finally:
        node.end()
