# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The report of one run of the closed loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dotsim_ros.control.loop.judge import limits_shown
from dotsim_ros.control.loop.recording import LoopRecording
from dotsim_ros.control.policy.paths import DomeContact, reference_path
from dotsim_ros.control.policy.rollout import APPROACH_S
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.page import (
    Bullets,
    Gallery,
    Page,
    ReportImage,
    Section,
    Table,
    image_of,
    page_figure,
)

PANEL_INCHES = (3.5, 2.5)
REFERENCE_COLOUR, APPROACH_COLOUR = "#9aa5b1", "#d9a441"
TRIAL_COLOURS = ("#1f5fa8", "#c0392b", "#2e8b57", "#7d3c98", "#b9770e")


def drawn_places(path: str, position_m: FloatArray) -> tuple[FloatArray, FloatArray, str, str]:
    """Return the two coordinates (mm) that show a path best, and their names."""
    contact = DomeContact()
    tilt, depth_m = contact.tilt_and_depth(position_m)
    radius_mm = 1e3 * (contact.dome_radius_m + contact.ball_radius_m - 1.4e-3)
    depth = 1e3 * depth_m
    match path:
        case "figure_eight":
            return radius_mm * tilt[..., 0], radius_mm * tilt[..., 1], "along x, mm", "along y, mm"
        case "arc":
            angle = np.linalg.norm(tilt, axis=-1)
            azimuth = np.arctan2(tilt[..., 0], tilt[..., 1])
            return radius_mm * np.sin(angle) * azimuth, depth, "along the arc, mm", "depth, mm"
        case "press":
            return radius_mm * tilt[..., 1], depth, "along y, mm", "depth, mm"
        case _:
            return radius_mm * tilt[..., 0], depth, "along x, mm", "depth, mm"


def draw_path(axes: Axes, path: str, recordings: Sequence[LoopRecording]) -> None:
    """Draw what was done on what should have been; the approach paler."""
    closed = reference_path(path).position_m
    x, y, x_name, y_name = drawn_places(path, np.concatenate([closed, closed[:1]]))
    axes.plot(x, y, color=REFERENCE_COLOUR, lw=5.0, solid_capstyle="round", zorder=1)
    for index, recording in enumerate(recordings):
        try:
            begun_s, ended_s = recording.led_s()
        except ValueError:
            continue
        places = recording.indenter_m()
        x, y, _, _ = drawn_places(path, places)
        approach = (recording.pose_s >= begun_s) & (recording.pose_s <= begun_s + APPROACH_S)
        judged = (recording.pose_s >= begun_s + APPROACH_S) & (recording.pose_s <= ended_s)
        axes.plot(x[approach], y[approach], color=APPROACH_COLOUR, lw=0.8, zorder=2)
        colour = TRIAL_COLOURS[index % len(TRIAL_COLOURS)]
        axes.plot(x[judged], y[judged], color=colour, lw=0.9, zorder=3)
    axes.set_xlabel(x_name)
    axes.set_ylabel(y_name)
    if path == "figure_eight":
        axes.set_aspect("equal", adjustable="datalim")


def path_image(path: str, recordings: Sequence[LoopRecording], *, name: str) -> ReportImage:
    """Return the image of a path for a report."""
    with page_figure(*PANEL_INCHES) as figure:
        axes = figure.add_subplot()
        draw_path(axes, path, recordings)
        axes.set_title(path.replace("_", " "))
        return image_of(figure, name=name, alt=f"The path {path}: executed and reference")


def trial_report(
    row: Mapping[str, Any],
    limits: SafetyLimits,
    image: ReportImage,
    *,
    path: str,
    policy: str,
    sensor: str,
    origin: Mapping[str, str],
) -> Page:
    """Return the report of one trial: its figures of `judge`, against limits, and where it comes
    from."""
    sections = [Section("Path", (Gallery((image,)),), is_half=True)]
    is_judged = "mean_error_mm" in row
    lead = f"Not judged: {row['ended']}."
    if is_judged:
        lead = (
            f"{row['mean_error_mm']:.2f} mm from the path on average, {row['laps']:.2f} laps in "
            f"the time in which the expert makes {row['laps_of_expert']:.2f}."
        )
        followed = (
            ("mean error", f"{row['mean_error_mm']:.3f} mm"),
            ("95th percentile", f"{row['p95_error_mm']:.3f} mm"),
            ("largest", f"{row['largest_error_mm']:.3f} mm"),
            ("judged", f"{row['seconds']:.1f} s, after an approach of {APPROACH_S:g} s"),
        )
        sections.append(Section("Followed", (Table(("figure", "value"), followed),), is_half=True))
    if "speed_mm_s" in row:
        allowed = limits_shown(limits)
        moved = tuple(
            (name, _number(row[key]), _number(allowed[key]))
            for name, key in (
                ("speed, mm/s", "speed_mm_s"),
                ("acceleration, m/s²", "acceleration_m_s2"),
                ("turning, rad/s", "turn_rate_rad_s"),
                ("turned, rad", "turn_rad"),
                ("away from where it was enabled, mm", "excursion_mm"),
            )
        )
        rates = (
            ("frames of the sensor", f"{row['frame_rate_hz']:.2f}"),
            ("commands", f"{row['command_rate_hz']:.2f}"),
            ("feedback of the arm", f"{row['feedback_rate_hz']:.2f}"),
        )
        sections += [
            Section(
                "Largest values", (Table(("what", "measured", "allowed"), moved),), is_half=True
            ),
            Section("Rates", (Table(("topic", "Hz"), rates),), is_half=True),
        ]
    stops = tuple(f"{reason}: {count}" for reason, count in row["stops"].items())
    sections += [
        Section("Stops", (Bullets(stops or ("none",)),), is_half=True),
        Section("Made by", (Bullets(tuple(f"{k}: {v}" for k, v in origin.items())),), is_half=True),
    ]
    is_good = is_judged and not row["ended"] and not row["exceeded"]
    return Page(
        f"{policy} on {sensor}: {path.replace('_', ' ')}",
        lead,
        tuple(sections),
        label="within all limits" if is_good else (row["ended"] or "beyond a limit"),
        colour="#2e7d32" if is_good else "#b3261e",
    )


def _number(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(f"{each:.3g}" for each in value)
    return f"{value:.3g}"
