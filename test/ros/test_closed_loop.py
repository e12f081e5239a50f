# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The closed loop as it is evaluated: shipped policy, simulated sensor and arm, real contact.

How closely a path is followed depends on how busy the machine is, so that is not judged here. Only
the limits of time are wider than a user's: a busy machine gives few frames a second.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

import msg_adapters
from dotsim_ros.control.loop.judge import judge, trial_start
from dotsim_ros.control.loop.recording import LoopRecording, read_loop_bag
from dotsim_ros.control.policy.paths import reference_path
from dotsim_ros.nodes.loop.closed_loop import SENSOR, ClosedLoop, LoopSetup

PATH = "figure_eight"
SECONDS = 6.0
PATIENT = {"stop_within_s": 1.0, "maximum_delay_s": 10.0}


@pytest.fixture(scope="module")
def started() -> Iterator[ClosedLoop]:
    with ClosedLoop(LoopSetup("densetact2_sphere", policy_parameters=PATIENT)) as running:
        running.start(PATH)
        yield running


@pytest.fixture
def loop(started: ClosedLoop) -> ClosedLoop:
    """The loop before it is enabled, with another sensor where a test before has killed it."""
    if psutil.Process(started.process(SENSOR).pid).status() == psutil.STATUS_ZOMBIE:
        started.start_sensor()
        # The policy does not start next to two senders, and DDS counts the dead one for a while.
        seen = started.observer
        seen.wait(lambda: seen.node.count_publishers("image_raw") == 1, "the end of the dead one")
    started.disable()
    return started


@pytest.fixture(scope="module")
def led(
    started: ClosedLoop, tmp_path_factory: pytest.TempPathFactory
) -> tuple[LoopRecording, Path]:
    """What the observer and what the recorder heard of one trial."""
    loop = started
    bag = tmp_path_factory.mktemp("bag") / "loop"
    path = reference_path(PATH, loop.contact)
    start_m = trial_start(path, loop.contact, seed=0, number=0)
    recording = loop.trial(start_m, SECONDS, bag=bag)
    first_m = recording.indenter_m()[0]
    np.testing.assert_allclose(first_m, start_m, atol=1e-6)
    return recording, bag


def test_the_policy_moves_the_arm_in_contact_within_every_limit(
    loop: ClosedLoop, led: tuple[LoopRecording, Path]
) -> None:
    recording, _ = led
    row = judge(recording, reference_path(PATH), loop.setup.limits())
    assert row["exceeded"] == []
    assert 1.0 < row["speed_mm_s"] < 15.0
    assert np.linalg.norm(recording.force_n[0]) > 0.1
    assert np.isfinite(row["mean_error_mm"])


def test_the_bag_tells_the_same_motion(
    loop: ClosedLoop, led: tuple[LoopRecording, Path], tmp_path: Path
) -> None:
    recording, bag = led
    recorded = read_loop_bag(bag, notes=recording.notes)
    np.testing.assert_allclose(
        recorded.indenter.position_m, recording.indenter.position_m, atol=1e-9
    )
    # Both heard the same commands, but for the first and last of each.
    assert set(recorded.command_s) & set(recording.command_s)
    limits, path = loop.setup.limits(), reference_path(PATH)
    told, seen = judge(recorded, path, limits), judge(recording, path, limits)
    assert told["exceeded"] == []
    assert told["mean_error_mm"] == pytest.approx(seen["mean_error_mm"], abs=0.02)
    recording.save(tmp_path / "trial.npz")
    assert judge(LoopRecording.load(tmp_path / "trial.npz"), path, limits) == seen


def wait_for_motion(loop: ClosedLoop) -> None:
    loop.observer.forget()
    loop.observer.wait(lambda: any(map(moves, loop.observer.heard("cmd_vel"))), "a motion")


def moves(heard: object) -> bool:
    twist = msg_adapters.decode_twist_stamped(heard.message)  # type: ignore[attr-defined]
    return bool(np.any(np.concatenate(twist)))


def wait_for_stop(loop: ClosedLoop, reasons: set[str]) -> None:
    """Wait for one of the reasons, then see that the commands stay zero and the arm stays."""
    loop.observer.wait(
        lambda: loop.state()[0] == "stopped" and loop.state()[1] in reasons, f"a stop for {reasons}"
    )
    time.sleep(0.3)
    loop.observer.forget()
    loop.observer.wait(lambda: loop.observer.count("cmd_vel") >= 10, "ten commands")
    assert not any(map(moves, loop.observer.heard("cmd_vel")))


def test_feedback_that_is_dropped_stops_the_arm(
    loop: ClosedLoop, led: tuple[LoopRecording, Path]
) -> None:
    loop.enable()
    wait_for_motion(loop)
    loop.set_arm(fail_drop_feedback=True)
    wait_for_stop(loop, {"pose_stale"})
    loop.set_arm(fail_drop_feedback=False)
    wait_for_motion(loop)


def test_a_trial_that_the_policy_refuses_is_recorded_as_such(
    loop: ClosedLoop, led: tuple[LoopRecording, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dotsim_ros.nodes.loop.closed_loop.ENABLE_TIMEOUT_S", 1.0)
    path = reference_path(PATH, loop.contact)
    loop.set_arm(fail_drop_feedback=True)
    try:
        recording = loop.trial(trial_start(path, loop.contact, seed=0, number=1), SECONDS)
    finally:
        loop.set_arm(fail_drop_feedback=False)
    row = judge(recording, path, loop.setup.limits())
    assert row["ended"].startswith("refused: ")
    assert "mean_error_mm" not in row


def test_a_sensor_that_is_killed_stops_the_arm(
    loop: ClosedLoop, led: tuple[LoopRecording, Path]
) -> None:
    loop.enable()
    wait_for_motion(loop)
    # The last of this file: a test after it would have to start another one.
    loop.process(SENSOR).signal(signal.SIGKILL)
    wait_for_stop(loop, {"image_stale", "force_stale"})
    loop.observer.wait(lambda: loop.observer.count("ee_pose") >= 10, "ten poses")
    places = [
        msg_adapters.decode_pose_stamped(h.message)[0] for h in loop.observer.heard("ee_pose")
    ]
    assert np.ptp(places, axis=0).max() < 1e-6
