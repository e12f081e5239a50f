"""The closed loop in simulated time: the same messages whatever the machine does meanwhile."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install pin")

from dotsim_ros.evaluation.trajectory.trials import judge, trial_start
from dotsim_ros.measured.bag_hash import bag_sha256
from dotsim_ros.nodes.loop.closed_loop import (
    ARM,
    POLICY,
    SENSOR,
    ClosedLoop,
    LoopFault,
    LoopSetup,
    TimedFault,
)
from dotsim_ros.nodes.loop.loop_time import SIMULATED
from dotsim_ros.tasks.policy.paths import DomeContact, reference_path

PATH = "line"
FAULT_S, WATCHED_S = 3.2, 0.6


@contextmanager
def busy(cores: list[int]) -> Iterator[None]:
    """Keep cores busy, and this process and its children on the last of them."""
    before = os.sched_getaffinity(0)
    program = "import os, sys\nos.sched_setaffinity(0, [int(sys.argv[1])])\nwhile True: pass"
    rivals = [subprocess.Popen([sys.executable, "-c", program, str(core)]) for core in cores]
    os.sched_setaffinity(0, cores[-1:])
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
        for rival in rivals:
            rival.kill()
            rival.wait()


def led(bag: Path, fault: LoopFault, order: tuple[str, ...]) -> tuple[str, dict[str, Any], float]:
    """Lead a loop in which something fails; return the hash of its bag, its figures, and when the
    commands became zero, by their stamps."""
    contact = DomeContact()
    path = reference_path(PATH, contact)
    setup = LoopSetup("densetact2_sphere")
    with ClosedLoop(setup, contact=contact, clock=SIMULATED) as loop:
        loop.start(path.name, order=order)
        start_m = trial_start(path, contact, seed=0, number=0)
        faults = [TimedFault(FAULT_S, fault)]
        recording = loop.trial(start_m, FAULT_S + WATCHED_S, bag=bag, faults=faults)
        assert set(loop.close().values()) == {0}
    return bag_sha256(bag), judge(recording, path, setup.limits()), recording.led_s()[1]


def test_the_same_messages_under_load_on_one_core_and_in_any_order(tmp_path: Path) -> None:
    quiet, row, stopped_s = led(
        tmp_path / "quiet" / "loop", LoopFault.IMAGES_CUT, (ARM, SENSOR, POLICY)
    )
    cores = sorted(os.sched_getaffinity(0))[:2]
    with busy(cores):
        other, _, other_s = led(
            tmp_path / "busy" / "loop", LoopFault.IMAGES_CUT, (POLICY, SENSOR, ARM)
        )
    assert other == quiet
    assert other_s == stopped_s
    files = [tmp_path / name / "loop" / "loop.mcap" for name in ("quiet", "busy")]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert row["stops"] == {"image_stale": 1}
    assert row["mean_error_mm"] < 1.0
    assert row["frame_rate_hz"] == pytest.approx(25.0, abs=0.2)
    assert not row["exceeded"]
