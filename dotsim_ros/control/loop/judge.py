# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of one recording of the closed loop: errors from the path, rates, limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.control.loop.recording import LoopRecording
from dotsim_ros.control.policy.demonstration import within_bounds
from dotsim_ros.control.policy.paths import PATHS, DomeContact, ReferencePath
from dotsim_ros.control.policy.rollout import APPROACH_S
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.io.arrays import FloatArray

START_SPREAD_M = 0.4e-3
"""Standard deviation along each axis of where a trial starts next to its path."""

BRAKING_S = 0.3
"""After the last command the motion still counts for so long."""


def trial_start(path: ReferencePath, contact: DomeContact, *, seed: int, number: int) -> FloatArray:
    """Return where the indenter is (3,) in the sensor's frame as a trial begins: somewhere on the
    path and a little next to it, the same in every setting."""
    random = np.random.default_rng([seed, PATHS.index(path.name), number])
    place = path.position_m[int(random.integers(len(path.position_m)))]
    return within_bounds(place + START_SPREAD_M * random.standard_normal(3), contact)


def summary_of(row: Mapping[str, Any]) -> str:
    """Return a trial's figures on one line."""
    if "mean_error_mm" not in row:
        return f"not judged: {row['ended']}"
    stops = ", ".join(f"{reason} {count}" for reason, count in row["stops"].items())
    return (
        f"{row['mean_error_mm']:.3f} mm, {row['laps']:.2f} of {row['laps_of_expert']:.2f} laps, "
        f"{row['frame_rate_hz']:.1f} frames/s, stops: {stops or 'none'}"
        + (f", ended: {row['ended']}" if row["ended"] else "")
    )


def judge(recording: LoopRecording, path: ReferencePath, limits: SafetyLimits) -> dict[str, Any]:
    """Return the figures of a recording.

    Errors are distances from where the indenter was in the sensor's frame to the nearest point of
    the path, after the first APPROACH_S in which the arm was led; largest values are of the whole
    time from the first command to the last.
    """
    notes = recording.notes
    ended = ""
    if notes.get("state") in ("latched", "refused"):
        ended = f"{notes['reason']}: {notes['detail']}"
    row: dict[str, Any] = {"stops": dict(notes.get("stops", {})), "ended": ended}
    try:
        begun_s, ended_s = recording.led_s()
    except ValueError as error:
        return row | {"ended": ended or str(error)}
    row |= motion_figures(recording, limits)
    led = (recording.pose_s >= begun_s + APPROACH_S) & (recording.pose_s <= ended_s)
    if np.count_nonzero(led) < 2:
        return row | {"ended": ended or "within the approach"}
    places = recording.indenter_m()[led]
    error_mm = 1e3 * path.nearest(places)[0]
    duration_s = float(np.ptp(recording.pose_s[led]))
    return row | {
        "mean_error_mm": round(float(error_mm.mean()), 4),
        "p95_error_mm": round(float(np.percentile(error_mm, 95)), 4),
        "largest_error_mm": round(float(error_mm.max()), 4),
        "laps": round(path.laps(places), 3),
        "laps_of_expert": round(duration_s / path.lap_s, 3),
        "seconds": round(duration_s, 2),
    }


def motion_figures(recording: LoopRecording, limits: SafetyLimits) -> dict[str, Any]:
    """Return rates, largest speeds, accelerations and excursions of the motion that was recorded,
    and which limits it exceeded."""
    begun_s, ended_s = recording.led_s()
    within = (recording.twist_s >= begun_s) & (recording.twist_s <= ended_s + BRAKING_S)
    twist, twist_s = recording.twist[within], recording.twist_s[within]
    step_s = np.diff(twist_s)
    steps = np.diff(twist, axis=0)[step_s > 0.0] / step_s[step_s > 0.0, None]
    shown = (recording.pose_s >= begun_s) & (recording.pose_s <= ended_s + BRAKING_S)
    pose = recording.pose[shown]
    before = recording.pose[recording.pose_s <= begun_s]
    home = before[-1] if len(before) else pose[0]
    away_m = np.abs(pose[:, :3] - home[:3]).max(axis=0)
    turns = Rotation.from_quat(home[3:]).inv() * Rotation.from_quat(pose[:, 3:])
    commands = recording.command[
        (recording.command_s >= begun_s) & (recording.command_s <= ended_s)
    ]
    figures = {
        "speed_mm_s": 1e3 * _largest(twist[:, :3]),
        "turn_rate_rad_s": _largest(twist[:, 3:]),
        "acceleration_m_s2": _largest(steps[:, :3]),
        "turn_acceleration_rad_s2": _largest(steps[:, 3:]),
        "commanded_speed_mm_s": 1e3 * _largest(commands[:, :3]),
        "turn_rad": float(turns.magnitude().max()),
    }
    allowed = limits_shown(limits)
    allowed["commanded_speed_mm_s"] = allowed["speed_mm_s"]
    exceeded = [name for name, value in figures.items() if value > allowed[name] * (1.0 + 1e-9)]
    if (away_m > limits.half_box_m).any():
        exceeded.append("excursion_mm")
    frames = (recording.frame_s >= begun_s) & (recording.frame_s <= ended_s)
    force = np.linalg.norm(recording.force_n[frames], axis=1)
    return {
        **{name: round(value, 4) for name, value in figures.items()},
        "excursion_mm": np.round(1e3 * away_m, 2).tolist(),
        "exceeded": exceeded,
        "standing_share": round(float(np.mean(~commands.any(axis=1))), 4),
        "force_n": round(float(force.max(initial=0.0)), 3),
        "frame_rate_hz": _rate_hz(recording.frame_s, begun_s, ended_s),
        "feedback_rate_hz": _rate_hz(recording.pose_s, begun_s, ended_s),
        "command_rate_hz": _rate_hz(recording.command_s, begun_s, ended_s),
    }


def _largest(vectors: FloatArray) -> float:
    return float(np.linalg.norm(vectors, axis=1).max(initial=0.0))


def _rate_hz(times_s: FloatArray, begun_s: float, ended_s: float) -> float:
    inside = times_s[(times_s >= begun_s) & (times_s <= ended_s)]
    if len(inside) < 2:
        return 0.0
    return round(float((len(inside) - 1) / (inside[-1] - inside[0])), 2)


def limits_shown(limits: SafetyLimits) -> dict[str, Any]:
    """Return the limits under the names of the figures that are held against them."""
    return {
        "speed_mm_s": 1e3 * limits.maximum_linear_m_s,
        "turn_rate_rad_s": limits.maximum_angular_rad_s,
        "acceleration_m_s2": limits.maximum_linear_m_s2,
        "turn_acceleration_rad_s2": limits.maximum_angular_rad_s2,
        "turn_rad": limits.maximum_turn_rad,
        "excursion_mm": (1e3 * limits.half_box_m).tolist(),
    }
