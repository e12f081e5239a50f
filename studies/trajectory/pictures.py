# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The paths of all trials in one image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from dotsim_ros.control.loop.recording import LoopRecording
from dotsim_ros.control.loop.report import draw_path
from dotsim_ros.io.files import whole_file
from studies.trajectory.trials import SETTINGS

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
