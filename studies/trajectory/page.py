# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The trajectories' table, its images, and what its figures mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from dotsim_ros.files import whole_file
from dotsim_ros.tasks.control.loop_recording import LoopRecording
from dotsim_ros.tasks.loop.report import draw_path
from dotsim_ros.tasks.policy.rollout import APPROACH_S
from studies.table import Column, entry_list, markdown_table
from studies.trajectory.trials import SETTINGS

COLUMNS = (
    Column("mean_error_mm", "mean error mm ↓"),
    Column("std_mm", "± between trials mm"),
    Column("p95_error_mm", "95th percentile mm"),
    Column("largest_error_mm", "largest mm"),
    Column("progress", "progress ↑", 2),
    Column("trials", "trials", 0),
    Column("judged", "judged", 0),
    Column("ended_early", "ended early", 0),
    Column("stop_count", "stops", 0),
    Column("frame_rate_hz", "frames/s", 1),
)
LIMIT_COLUMNS = (
    Column("speed_mm_s", "speed mm/s", 1),
    Column("acceleration_m_s2", "acceleration m/s²", 2),
    Column("turn_rate_rad_s", "turning rad/s", 3),
    Column("turn_rad", "turned rad", 3),
    Column("excursion", "excursion x, y, z mm"),
    Column("force_n", "force N", 2),
    Column("exceeded", "trials beyond a limit", 0),
)
SAYS = {
    "simulated": "the sensor that the policy was trained on",
    "transferred": "the stand-in for a measured sensor: its calibrated gel, lens and lights, the "
    "network that completes its image, and noise as its camera has; the policy saw none of it",
    "shifted": "the sensor trained on with a gel 10 % stiffer, light dimmed to 60 %, and a camera "
    "tilted by 1 degree",
    "reality": "the stand-in for reality: `transferred` with what finite elements put into five "
    "measured sets and the gap finder found there, all at once: a gel 10.4 % thinner, of whose "
    "stress 17 % relaxes in 1 s, with 0.43 of the friction, solved on the finer grid",
}
NOT_SO = (
    "`transferred` is no real sensor. The images are those of a simulation that was fitted to a "
    "data set which is itself synthetic, and the gel under them is this package's, not the "
    "finite-element one that the data came from: what both leave out, neither shows.",
    "`reality` is none either: its effects were found in independent data, but act in this "
    "package's gel.",
    "`shifted` lies within what training varied for light and camera. The stiffer gel hardly shows "
    "in an image, since the shape of a gel that a rigid body presses slowly does not depend on its "
    "stiffness; it shows in the force.",
    "The arm is simulated, and the indenter stands still in its base.",
)
CLOCKS = {
    "simulated": (
        "In simulated time",
        "All nodes go on in steps together, with delays of camera and policy as they were measured "
        "in real time: the figures are the same however busy the machine, on processors of one "
        "kind.",
    ),
    "realtime": (
        "In real time",
        "Everything shares the machine, and what comes late is late: the figures depend on the "
        "machine and on what else it does.",
    ),
}
"""Title and explanation of the trials by each clock."""
GRID_PANEL_INCHES = (3.1, 2.3)
DOTS_PER_INCH = 110


def write_grid(file: Path, recordings: Mapping[tuple[str, str], Sequence[LoopRecording]]) -> None:
    """Write an image of all paths in all settings, whole or not at all.

    Args:
        file: PNG.
        recordings: by setting and path.
    """
    settings = [name for name in SETTINGS if any(key[0] == name for key in recordings)]
    paths = list(dict.fromkeys(path for _, path in recordings))
    width, height = GRID_PANEL_INCHES
    with matplotlib.rc_context({"font.family": "DejaVu Sans", "font.size": 8.0}):
        figure = Figure(figsize=(width * len(paths), height * len(settings)), layout="constrained")
        panels = figure.subplots(len(settings), len(paths), squeeze=False)
        for row, setting in enumerate(settings):
            for column, path in enumerate(paths):
                axes = panels[row, column]
                draw_path(axes, path, recordings.get((setting, path), ()))
                axes.set_title(f"{path.replace('_', ' ')}, {setting}", fontsize=8.5)
        with whole_file(file) as part:
            figure.savefig(part, dpi=DOTS_PER_INCH)


def trajectory_page(figures: Mapping[str, Any], image: str) -> str:
    """Return the page of the figures.

    Args:
        figures: as `trajectory_figures` gives them, with `clock`, `provenance`, `plan`, `limits`.
        image: of the paths, seen from the page.
    """
    settings = [name for name in SETTINGS if name in figures]
    parts = [
        "# Trajectories followed by touch alone",
        "Over ROS topics: `tactile_sim`, `tactile_policy` and `xarm_sim` as processes. Every trial "
        "starts somewhere on its path and a little beside it, drawn by the seed, at the same "
        "places in every setting.",
        "\n".join(f"- **{setting}**: {SAYS[setting]}." for setting in settings),
        *_clock_parts(figures, settings),
        "## The paths",
        f"![executed paths on the reference]({image})",
        "Grey: the path; yellow: the approach of the first "
        f"{APPROACH_S:g} s, which is not judged; coloured: the trials.",
        "## What the figures mean",
        entry_list(
            {
                "mean error": "distance from where the indenter was in the sensor's frame to the "
                "nearest point of the path, mean over a trial after the approach, then over "
                "trials; ± is the deviation of the trials' means",
                "progress": "laps made over those that the expert makes in that time: who stands "
                "still makes no error",
                "judged": "trials that went on after the approach; one that was latched before has "
                "no error and is counted here and under ended early",
                "frames/s": "of the simulated sensor; 25 is all of them",
            }
        ),
        "## What this does not show",
        "\n".join(f"- {line}" for line in NOT_SO),
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _clock_parts(figures: Mapping[str, Any], settings: Sequence[str]) -> list[str]:
    """Return the tables of the trials by their clock."""
    title, says = CLOCKS[figures["clock"]]
    rows = [
        ((setting, path), _shown(found))
        for setting in settings
        for path, found in [("all", figures[setting]), *figures[setting]["paths"].items()]
    ]
    plan, limits = figures["plan"], figures["limits"]
    return [
        f"## {title}",
        f"{says} {plan['trials']} trials of each path and setting, {plan['seconds']:g} s each.",
        markdown_table(("setting", "path"), rows, COLUMNS),
        "### The motion against its limits",
        "Largest values of all trials, of the motion that was recorded. The policy's node allows "
        f"{limits['speed_mm_s']:g} mm/s, {limits['acceleration_m_s2']:g} m/s², "
        f"{limits['turn_rate_rad_s']:g} rad/s, {limits['turn_rad']:g} rad, and an excursion of "
        f"{', '.join(f'{v:g}' for v in limits['excursion_mm'])} mm.",
        markdown_table(("setting", "path"), rows, LIMIT_COLUMNS),
        "### Stops",
        _stops(figures, settings),
        "### Made by",
        entry_list(figures["provenance"]),
    ]


def _shown(found: Mapping[str, Any]) -> dict[str, Any]:
    excursion = found.get("excursion_mm")
    return {
        **found,
        "stop_count": sum(found["stops"].values()),
        "excursion": None if excursion is None else ", ".join(f"{v:.1f}" for v in excursion),
    }


def _stops(figures: Mapping[str, Any], settings: Sequence[str]) -> str:
    lines = []
    for setting in settings:
        for path, found in figures[setting]["paths"].items():
            for reason, count in found["stops"].items():
                lines.append(f"- {setting}, {path}: {reason} {count}")
        for path, rows in figures[setting]["rows"].items():
            for number, row in enumerate(rows):
                if row["ended"]:
                    lines.append(f"- {setting}, {path}, trial {number + 1} ended: {row['ended']}")
    return "\n".join(lines) or "None."
