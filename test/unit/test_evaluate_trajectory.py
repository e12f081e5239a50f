# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Trials of a policy: what a recording is worth, what is kept, and the sensors they are run on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import msg_adapters
from dotsim_ros.control.loop.judge import judge, trial_start
from dotsim_ros.control.loop.recording import LoopPlaces, LoopRecording, read_loop_bag
from dotsim_ros.control.loop.report import path_image, trial_report
from dotsim_ros.control.policy.paths import PATHS, DomeContact, reference_path
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.data.bag import BAG_TYPES, BagFile
from dotsim_ros.geometry.pose import Pose, compose, inverse
from dotsim_ros.io.files import parameter_path
from dotsim_ros.io.page import as_markdown
from dotsim_ros.io.provenance import provenance
from dotsim_ros.specification import load_sensor
from studies.trajectory.study import write_grid
from studies.trajectory.trials import (
    SETTINGS,
    Setting,
    TrajectoryTrials,
    TrialPlan,
    run_trials,
    setting_of,
    summarize,
    trajectory_figures,
)

PLACES = LoopPlaces(Pose(np.array([0.35, 0.0, 0.3]), np.array([1.0, 0.0, 0.0, 0.0])))
TOPICS = ("ee_pose", "ee_twist", "cmd_vel", "wrench", "indenter/pose")
START_S = 1000.0
LIMITS = SafetyLimits()


@cache
def led_along(name: str, seconds: float, beside_m: float) -> LoopRecording:
    """Return an arm that goes along a path as the expert would, so far next to it."""
    path = reference_path(name)
    time_s = np.arange(0.0, seconds, 0.01)
    arc_m, arcs = 0.0, []
    for _ in time_s:
        arcs.append(arc_m)
        arc_m += 0.01 * float(path.at(arc_m)[2])
    wanted = path.at(np.array(arcs))[0] + np.array([0.0, beside_m, 0.0])
    indenter = PLACES.indenter(wanted[0])
    tools = [compose(indenter, inverse(Pose(place))) for place in wanted]
    pose = np.array([[*tool.position_m, *tool.quaternion_xyzw] for tool in tools])
    velocity = np.gradient(pose[:, :3], 0.01, axis=0)
    return LoopRecording(
        pose_s=START_S + time_s,
        pose=pose,
        twist_s=START_S + time_s,
        twist=np.hstack([velocity, np.zeros_like(velocity)]),
        command_s=START_S + time_s[::4],
        command=np.tile([0.005, 0, 0, 0, 0, 0], (len(time_s[::4]), 1)),
        frame_s=START_S + time_s[::4],
        force_n=np.tile([0.0, 0.0, 1.5], (len(time_s[::4]), 1)),
        indenter=indenter,
    )


def recording_of(
    name: str = "line", *, seconds: float = 9.0, beside_m: float = 0.0, **notes: Any
) -> LoopRecording:
    given = {"state": "running", "reason": "none", "stops": {}, "detail": "", **notes}
    return replace(led_along(name, seconds, beside_m), notes=given)


def pixels_of(file: str) -> np.ndarray[Any, Any]:
    image = cv2.imread(file)
    return image.astype(float)


def test_where_the_indenter_is_put_is_where_the_sensor_sees_it():
    place = np.array([0.001, -0.002, 0.014])
    seen = compose(inverse(PLACES.start), PLACES.indenter(place))
    np.testing.assert_allclose(seen.position_m, place, atol=1e-12)
    assert abs(seen.quaternion_xyzw[3]) == pytest.approx(1.0)


@pytest.mark.parametrize("name", PATHS)
def test_who_goes_along_the_path_makes_no_error_and_all_the_laps(name):
    row = judge(recording_of(name), reference_path(name), LIMITS)
    assert row["mean_error_mm"] < 0.001
    assert row["laps"] == pytest.approx(row["laps_of_expert"], rel=0.02)
    assert row["exceeded"] == []
    assert row["frame_rate_hz"] == pytest.approx(25.0)
    assert row["feedback_rate_hz"] == pytest.approx(100.0)
    assert row["force_n"] == 1.5


def test_what_counts_as_an_error_and_for_how_long():
    row = judge(recording_of("line", beside_m=0.5e-3), reference_path("line"), LIMITS)
    assert row["mean_error_mm"] == pytest.approx(0.5, abs=0.01)
    # The approach is not judged, nor the time in which nothing was commanded.
    recording = recording_of()
    pose, command = recording.pose.copy(), recording.command.copy()
    pose[:190, 1] += 0.01
    command[recording.command_s > START_S + 4.0] = 0.0
    row = judge(replace(recording, pose=pose, command=command), reference_path("line"), LIMITS)
    assert row["mean_error_mm"] < 0.001
    assert row["excursion_mm"][1] > 9.0
    assert row["seconds"] == pytest.approx(2.0, abs=0.06)


def exceeding(**changes: Any) -> list[str]:
    row = judge(replace(recording_of(), **changes), reference_path("line"), LIMITS)
    exceeded: list[str] = row["exceeded"]
    return exceeded


def test_what_exceeds_a_limit_is_named():
    recording = recording_of()
    fast = recording.twist.copy()
    fast[400, 0] = 0.06
    assert exceeding(twist=fast) == ["speed_mm_s", "acceleration_m_s2"]
    command = recording.command.copy()
    command[50, 1] = -0.051
    assert exceeding(command=command) == ["commanded_speed_mm_s"]
    away = recording.pose.copy()
    away[300, 2] += 0.021
    assert exceeding(pose=away) == ["excursion_mm"]
    turned = recording.pose.copy()
    turned[300, 3:] = (
        Rotation.from_quat(turned[300, 3:]) * Rotation.from_rotvec([0, 0.4, 0])
    ).as_quat()
    assert exceeding(pose=turned) == ["turn_rad"]


def test_a_trial_that_was_never_led_or_latched_early_is_told():
    still = recording_of()
    row = judge(replace(still, command=0.0 * still.command), reference_path("line"), LIMITS)
    assert "never moved the arm" in row["ended"]
    latched = recording_of(
        seconds=1.5, state="latched", reason="workspace", detail="too far", stops={"workspace": 1}
    )
    early = judge(latched, reference_path("line"), LIMITS)
    assert early["ended"] == "workspace: too far"
    found = summarize([row, early, judge(still, reference_path("line"), LIMITS)])
    assert (found["trials"], found["judged"], found["ended_early"]) == (3, 1, 2)
    notes = still.notes | {"state": "refused", "reason": "refused", "detail": "no image"}
    refused = judge(
        replace(still, command=0.0 * still.command, notes=notes), reference_path("line"), LIMITS
    )
    assert refused["ended"] == "refused: no image"
    assert found["stops"] == {"workspace": 1}
    assert found["std_mm"] is None


def test_a_recording_is_read_as_it_was_written(tmp_path):
    recording = recording_of(stops={"image_stale": 2})
    recording = recording.between(START_S + 2.0, START_S + 3.0)
    assert len(recording.pose) == len(recording.pose_s) == pytest.approx(101, abs=1)
    assert len(recording.command) == len(recording.command_s) == pytest.approx(26, abs=1)
    recording.save(tmp_path / "a.npz")
    again = LoopRecording.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(again.pose, recording.pose)
    np.testing.assert_array_equal(again.indenter_m(), recording.indenter_m())
    assert again.notes == recording.notes
    (tmp_path / "b.npz").write_bytes(b"PK\x03\x04 nothing")
    with pytest.raises(ValueError, match="no recording of a closed loop"):
        LoopRecording.load(tmp_path / "b.npz")


def test_a_bag_is_read_as_the_same_recording(tmp_path):
    recording = recording_of()
    with BagFile(tmp_path / "bag") as bag:
        for stamp_s, pose, twist, seen in zip(
            recording.pose_s, recording.pose, recording.twist, recording.indenter_m(), strict=True
        ):
            stamp_ns = round(1e9 * stamp_s)
            known: dict[str, Any] = {"stamp_ns": stamp_ns, "types": BAG_TYPES}
            tool = msg_adapters.encode_pose_stamped(pose[:3], pose[3:], frame_id="a", **known)
            rate = msg_adapters.encode_twist_stamped(twist[:3], twist[3:], frame_id="a", **known)
            felt = msg_adapters.encode_wrench_stamped((0, 0, 1.5), (0, 0, 0), frame_id="a", **known)
            there = msg_adapters.encode_pose_stamped(seen, (0, 0, 0, 1), frame_id="a", **known)
            for topic, message in zip(TOPICS, (tool, rate, rate, felt, there), strict=True):
                bag.write(f"/left/{topic}", stamp_ns, message)
        # The recorder stopped before the pose of the tool that belongs to the indenter's last.
        known["stamp_ns"] = stamp_ns + 10_000_000
        alone = msg_adapters.encode_pose_stamped(seen + 0.001, (0, 0, 0, 1), frame_id="a", **known)
        bag.write("/left/indenter/pose", known["stamp_ns"], alone)
    again = read_loop_bag(tmp_path / "bag", notes=recording.notes)
    np.testing.assert_allclose(again.indenter_m(), recording.indenter_m(), atol=1e-9)
    told = judge(again, reference_path("line"), LIMITS)
    assert told["mean_error_mm"] < 0.001
    with BagFile(tmp_path / "poor") as bag:
        bag.write("/ee_pose", stamp_ns, tool)
    with pytest.raises(ValueError, match="holds no topic ee_twist"):
        read_loop_bag(tmp_path / "poor")
    with BagFile(tmp_path / "apart") as bag:
        for topic, message in zip(TOPICS, (tool, rate, rate, felt, alone), strict=True):
            bag.write(f"/{topic}", stamp_ns, message)
    with pytest.raises(ValueError, match="has the time of a pose of the tool"):
        read_loop_bag(tmp_path / "apart")


def plan_of(*, trials: int = 2, policy: str = "abc") -> TrialPlan:
    settings = tuple(Setting(name, "densetact2", content="x") for name in SETTINGS[:2])
    return TrialPlan(settings, ("line", "press"), trial_count=trials, seconds=4.0, policy=policy)


def test_a_run_that_was_broken_off_goes_on(tmp_path):
    asked: list[tuple[str, str]] = []

    def loop(setting: Setting, path: str, start_m: Any, seconds: float) -> LoopRecording:
        asked.append((setting.name, path))
        if len(asked) == 4:
            raise KeyboardInterrupt
        return recording_of(path, seconds=seconds)

    def run(plan: TrialPlan) -> TrajectoryTrials:
        return run_trials(plan, loop, LIMITS, tmp_path)

    with pytest.raises(KeyboardInterrupt):
        run(plan_of())
    trials = run(plan_of())
    # Eight trials, the fourth was asked for twice.
    assert len(asked) == 9
    assert [len(rows) for rows in trials.rows.values()] == [2, 2, 2, 2]
    assert run(plan_of()).rows == trials.rows
    assert len(asked) == 9
    # What is empty or broken is run again.
    for number, path in enumerate(sorted(tmp_path.glob("*.npz"))[:2]):
        path.write_bytes(b"" if number else path.read_bytes()[:100])
    assert run(plan_of()).rows == trials.rows
    assert len(asked) == 11
    run(plan_of(policy="another"))
    assert len(asked) == 19


def test_a_loop_that_does_not_start_is_tried_again_and_then_reported(tmp_path, capsys):
    tries = []

    def loop(setting: Setting, path: str, start_m: Any, seconds: float) -> LoopRecording:
        tries.append(path)
        if len(tries) < 3:
            raise OSError("the newest force came late")
        return recording_of(path)

    plan = TrialPlan(plan_of().settings[:1], ("line",), trial_count=1)
    run_trials(plan, loop, LIMITS, tmp_path / "a")
    assert capsys.readouterr().out.count("once more") == 2

    def broken(setting: Setting, path: str, start_m: Any, seconds: float) -> LoopRecording:
        raise OSError("nobody there")

    with pytest.raises(OSError, match="nobody there"):
        run_trials(plan, broken, LIMITS, tmp_path / "b")


def test_starts_are_near_the_path_and_the_same_for_a_seed():
    contact, path = DomeContact(), reference_path("arc")
    starts = [trial_start(path, contact, seed=0, number=n) for n in range(20)]
    assert path.nearest(np.array(starts))[0].max() < 2e-3
    assert len({tuple(start) for start in starts}) == 20
    np.testing.assert_array_equal(starts[3], trial_start(path, contact, seed=0, number=3))


def test_the_shifted_sensor_is_stiffer_darker_and_tilted(tmp_path):
    shifted = setting_of("shifted", tmp_path, trained_on="densetact2")
    own, other = load_sensor("densetact2"), load_sensor(shifted.sensor)
    assert other.material.youngs_modulus_pa == pytest.approx(1.1 * own.material.youngs_modulus_pa)
    assert other.gel == own.gel
    turn = (
        Rotation.from_quat(own.camera.quaternion_xyzw).inv()
        * Rotation.from_quat(other.camera.quaternion_xyzw)
    ).magnitude()
    assert np.degrees(turn) == pytest.approx(1.0)
    image = pixels_of(other.camera.idle_image)
    bright = pixels_of(str(parameter_path(own.camera.idle_image)))
    assert image.mean() == pytest.approx(0.6 * bright.mean(), rel=0.03)
    # A camera that is tilted by a degree sees everything somewhere else.
    assert np.abs(image - 0.6 * bright).mean() > 2.0
    again = setting_of("shifted", tmp_path / "elsewhere", trained_on="densetact2")
    assert again.content == shifted.content
    assert len({setting_of(n, tmp_path, trained_on="densetact2").content for n in SETTINGS}) == 4
    with pytest.raises(ValueError, match="no setting 'real'"):
        setting_of("real", tmp_path, trained_on="densetact2")


def test_the_figures_are_of_all_trials(tmp_path):
    plan = plan_of()
    trials = run_trials(
        plan,
        lambda setting, path, start_m, seconds: recording_of(
            path, beside_m=0.2e-3, stops={"image_stale": 1}
        ),
        LIMITS,
        tmp_path,
    )
    figures = trajectory_figures(plan, trials)
    assert figures["simulated"]["trials"] == 4
    assert 0.1 < figures["simulated"]["mean_error_mm"] < 0.21
    assert figures["simulated"]["paths"]["line"]["stops"] == {"image_stale": 2}
    assert "press" in figures["transferred"]["paths"]
    write_grid(tmp_path / "grid.png", trials.recordings)
    assert pixels_of(str(tmp_path / "grid.png")).shape[1] > 500


def test_the_report_of_a_trial_says_whether_it_kept_the_limits():
    recording = recording_of("press")
    row = judge(recording, reference_path("press"), LIMITS)
    image = path_image("press", [recording], name="path")
    given: dict[str, Any] = {"path": "press", "policy": "p", "sensor": "s", "origin": provenance()}
    text = as_markdown(trial_report(row, LIMITS, image, **given))
    assert "within all limits" in text
    bad = as_markdown(trial_report(row | {"exceeded": ["speed_mm_s"]}, LIMITS, image, **given))
    assert "beyond a limit" in bad
