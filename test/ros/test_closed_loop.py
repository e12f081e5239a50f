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
import pytest

from dotsim_ros.control.loop.judge import judge, trial_start
from dotsim_ros.control.loop.recording import LoopRecording, read_loop_bag
from dotsim_ros.control.policy.paths import reference_path
from dotsim_ros.nodes.loop.closed_loop import SENSOR, ClosedLoop, LoopSetup

PATH = "figure_eight"
SECONDS = 4.0
PATIENT = {"stop_within_s": 1.0, "maximum_delay_s": 10.0}


@pytest.fixture(scope="module")
def loop() -> Iterator[ClosedLoop]:
    """The loop in three processes, in real time."""
    with ClosedLoop(LoopSetup("densetact2_sphere", policy_parameters=PATIENT)) as running:
        running.start(PATH)
        yield running


@pytest.fixture(scope="module")
def led(loop: ClosedLoop, tmp_path_factory: pytest.TempPathFactory) -> tuple[LoopRecording, Path]:
    """What the observer and what the recorder heard of one trial."""
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
    seen = loop.observer
    loop.enable()
    seen.wait(lambda: loop.state()[0] == "running", "a motion")
    # The last of this file: a test after it would have to start another one.
    loop.process(SENSOR).signal(signal.SIGKILL)
    reasons = {"image_stale", "force_stale"}
    seen.wait(lambda: loop.state()[0] == "stopped" and loop.state()[1] in reasons, "a stop")
    time.sleep(0.3)
    seen.forget()
    seen.wait(lambda: min(seen.count("ee_pose"), seen.count("cmd_vel")) >= 10, "ten poses")
    recording = loop.recording({})
    assert not recording.command.any()
    assert np.ptp(recording.pose[:, :3], axis=0).max() < 1e-6
