# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rates and delays of the closed loop: sensor, policy and arm as processes on this machine.

The policy leads the arm along a path all the time. Rates are counted from the times at which the
middleware sent the messages. The way of a pose: `xarm_sim` stamps it, the frame that shows it is
stamped by `tactile_sim`, and the command that answers the frame is sent by `tactile_policy`. The
pose that a frame shows is published on `indenter/state`; the command that answers a frame is the
first that is sent SHORTEST_INFERENCE_S after it or later. The policy's node counts missed
deadlines.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped

import msg_adapters
from dotsim_ros.control.loop.judge import motion_figures, trial_start
from dotsim_ros.control.loop.recording import LoopRecording
from dotsim_ros.control.policy.network import read_policy
from dotsim_ros.control.policy.paths import PATHS, reference_path
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.nodes.common.transport import stay_local
from dotsim_ros.nodes.loop.closed_loop import (
    ARM,
    POLICY,
    SENSOR,
    ClosedLoop,
    LoopSetup,
    policy_name,
)
from dotsim_ros.nodes.loop.observer import LOOP_TOPICS, LoopTraffic
from dotsim_ros.nodes.tactile_policy.files import policy_folder
from studies.run import FAILED, expect_known, expect_positive
from studies.timing import percentiles_ms
from studies.trajectory.trials import summarize

TOPICS = {**LOOP_TOPICS, "indenter/pose": PoseStamped, "indenter/state": PoseStamped}
SHORTEST_INFERENCE_S = 0.005
PERCENTS = (50, 99, 100)
WINDOW_S = 10.0
REPORTED_GAP_S = 0.08
"""Gap between two commands: one period and a deadline missed by 40 ms."""
COMMAND_HZ, COMMAND_TOLERANCE_HZ = 25.0, 0.2
FEEDBACK_HZ, FEEDBACK_TOLERANCE_HZ = 100.0, 0.5
LONGEST_WAY_MS = 120.0


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def sent_s(heard: list[LoopTraffic]) -> FloatArray:
    """Return when messages were sent, in seconds of the system's clock."""
    return 1e-9 * np.array([each.sent_ns for each in heard], dtype=np.float64)


def stamps_s(heard: list[LoopTraffic]) -> FloatArray:
    """Return the messages' stamps in seconds."""
    return 1e-9 * np.array([msg_adapters.message_stamp_ns(each.message) for each in heard])


def rate_figures(times_s: FloatArray) -> dict[str, float]:
    """Return the mean rate, and the lowest and highest of windows of WINDOW_S."""
    gaps_s = np.diff(times_s)
    # At least one window, however short the run.
    edges = np.arange(times_s[0], max(times_s[-1] - WINDOW_S, times_s[0] + 1e-3), WINDOW_S)
    counts = [int(np.sum((times_s >= e) & (times_s < e + WINDOW_S))) for e in edges]
    return {
        "mean_hz": round(float(1.0 / gaps_s.mean()), 3),
        "lowest_hz": round(min(counts) / WINDOW_S, 2),
        "highest_hz": round(max(counts) / WINDOW_S, 2),
        "longest_gap_ms": round(1e3 * float(gaps_s.max()), 1),
    }


def shown_poses_s(poses: list[LoopTraffic], states: list[LoopTraffic]) -> FloatArray:
    """Return for each frame the stamp of the pose that it shows, NaN where it shows none that was
    sent: the frame then lags behind the indenter."""
    by_place: dict[tuple[float, ...], list[float]] = {}
    for stamp, heard in zip(stamps_s(poses), poses, strict=True):
        position, _ = msg_adapters.decode_pose_stamped(heard.message)
        by_place.setdefault(tuple(position.tolist()), []).append(float(stamp))
    shown = np.full(len(states), np.nan)
    for index, (stamp, heard) in enumerate(zip(stamps_s(states), states, strict=True)):
        position, _ = msg_adapters.decode_pose_stamped(heard.message)
        known = [s for s in by_place.get(tuple(position.tolist()), ()) if s <= stamp]
        if known:
            shown[index] = known[-1]
    return shown


def ways(loop: ClosedLoop) -> dict[str, Any]:
    """Return the delays from poses to frames to commands."""
    observer = loop.observer
    states = observer.heard("indenter/state")
    frame_s, frame_sent_s = stamps_s(states), sent_s(states)
    shown_s = shown_poses_s(observer.heard("indenter/pose"), states)
    commands = observer.heard("cmd_vel")
    moving = [
        h for h in commands if np.any(np.concatenate(msg_adapters.decode_twist_stamped(h.message)))
    ]
    command_s = sent_s(moving)
    answered = np.searchsorted(frame_sent_s, command_s - SHORTEST_INFERENCE_S) - 1
    known = answered >= 0
    answered, command_s = answered[known], command_s[known]
    # A frame that is answered by two commands: the first one is the answer.
    answered, first = np.unique(answered, return_index=True)
    command_s = command_s[first]
    whole = command_s - shown_s[answered]
    lags = np.isnan(whole)
    return {
        "pose_to_frame": percentiles_ms((frame_s - shown_s)[~np.isnan(shown_s)], PERCENTS),
        "frame_to_sent": percentiles_ms(frame_sent_s - frame_s, PERCENTS),
        "frame_to_sent_percentiles_s": np.percentile(frame_sent_s - frame_s, np.arange(101))
        .round(4)
        .tolist(),
        "frame_to_command": percentiles_ms(command_s - frame_s[answered], PERCENTS),
        "pose_to_command": percentiles_ms(whole[~lags], PERCENTS),
        "commands_counted": int(np.sum(~lags)),
        "commands_on_lagging_frames": int(np.sum(lags)),
    }


def worst_motion(
    recording: LoopRecording, led_s: Sequence[tuple[float, float]], limits: SafetyLimits
) -> dict[str, Any]:
    """Return the largest values of the stretches in which the arm was led; in between it was put
    back to its start, which is a jump."""
    parts = [recording.between(*stretch) for stretch in led_s]
    rows = [motion_figures(part, limits) for part in parts if part.command.any()]
    found = summarize([row | {"stops": {}, "ended": ""} for row in rows])
    names = ("speed_mm_s", "acceleration_m_s2", "turn_rate_rad_s", "turn_rad", "excursion_mm")
    exceeded = sorted({name for row in rows for name in row["exceeded"]})
    return {name: found[name] for name in (*names, "force_n")} | {"exceeded": exceeded}


def measure(
    policy: Path,
    path_name: str,
    minutes: float,
    sensor: str,
    sensor_parameters: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Run the loop and return its figures.

    Args:
        policy: its folder.
        path_name: to follow.
        minutes: how long.
        sensor, sensor_parameters: parameters of `tactile_sim`.

    Raises:
        OSError: it does not start.
    """
    path = reference_path(path_name)
    setup = LoopSetup(policy_name(policy), sensor=sensor, sensor_parameters=sensor_parameters or {})
    restarts: list[str] = []
    led_s: list[tuple[float, float]] = []
    with ClosedLoop(setup, topics=TOPICS) as loop:
        loop.start(path_name)
        loop.touch(trial_start(path, loop.contact, seed=0, number=0))
        loop.enable()
        time.sleep(2.0)
        pids = {name: loop.process(name).pid for name in (SENSOR, POLICY, ARM)}
        used_s = {name: cpu_s(pid) for name, pid in pids.items()}
        loop.observer.forget()
        begun_s, since_s = time.monotonic(), time.time()
        while (passed_s := time.monotonic() - begun_s) < 60.0 * minutes:
            time.sleep(0.5)
            state, reason = loop.state()
            if state == "latched":
                restarts.append(f"{passed_s:.0f} s: {reason}")
                led_s.append((since_s, time.time()))
                loop.rest()
                loop.touch(trial_start(path, loop.contact, seed=0, number=len(restarts)))
                since_s = time.time()
                loop.enable()
        spent = {
            name: round(100.0 * (cpu_s(pid) - used_s[name]) / passed_s, 1)
            for name, pid in pids.items()
        }
        values = {
            part: loop.observer.values(f"{POLICY}: {part}") for part in ("control", "inference")
        }
        heard = {name: sent_s(loop.observer.heard(name)) for name in LOOP_TOPICS}
        led_s.append((since_s, time.time()))
        recording = loop.recording({})
        found = {
            "minutes": round(passed_s / 60.0, 2),
            "path": path_name,
            "commands": rate_figures(heard["cmd_vel"]),
            "feedback": rate_figures(heard["ee_pose"]),
            "frames": rate_figures(heard["wrench"]),
            "ways": ways(loop),
            "command_gaps_over_80_ms": int(np.sum(np.diff(heard["cmd_vel"]) > REPORTED_GAP_S)),
            "stops": loop.stops(),
            "latched": restarts,
            "told_by_the_policy": values,
            "told_by_the_sensor": loop.observer.values(f"{SENSOR}: frames"),
            "cpu_percent": spent,
            "motion": worst_motion(recording, led_s, setup.limits()),
        }
        loop.disable()
    return found


def verdicts(figures: Mapping[str, Any]) -> dict[str, bool]:
    """Return what of the targets is met."""
    commands, feedback = figures["commands"]["mean_hz"], figures["feedback"]["mean_hz"]
    reported = sum(
        int(values.get("deadline_misses_over_40_ms", 0))
        for values in figures["told_by_the_policy"].values()
    )
    return {
        "commands 25.0 +- 0.2 Hz": abs(commands - COMMAND_HZ) <= COMMAND_TOLERANCE_HZ,
        "feedback 100 +- 0.5 Hz": abs(feedback - FEEDBACK_HZ) <= FEEDBACK_TOLERANCE_HZ,
        "pose to command p99 under 120 ms": figures["ways"]["pose_to_command"]["p99_ms"]
        < LONGEST_WAY_MS,
        "no gap over 80 ms that was not told": figures["command_gaps_over_80_ms"] <= reported,
        "no limit exceeded": not figures["motion"]["exceeded"],
        "never latched": not figures["latched"],
    }


def closed_loop(
    *, minutes: float = 4.0, policy: str = "densetact2_sphere", path: str = "figure_eight"
) -> dict[str, Any]:
    """Rates and delays of the closed loop: sensor, policy and arm as processes on this machine.

    Args:
        minutes: how long.
        policy: folder or name.
        path: that it follows.
    """
    expect_positive(minutes=minutes)
    expect_known("path", [path], PATHS)
    stay_local()
    folder = policy_folder(policy)
    card, _ = read_policy(folder)
    figures = measure(folder, path, minutes, card.sensor)
    met = verdicts(figures)
    return {
        **figures,
        "met": met,
        "policy": card.name,
        FAILED: [f"missed: {target}" for target, is_met in met.items() if not is_met],
    }
