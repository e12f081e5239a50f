# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A contact sheet: the strongest moment of each part of a bag, and the force over time."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dotsim_ros.io.files import whole_file
from dotsim_ros.io.printable import boxes_for_missing_glyphs, figure_label
from dotsim_ros.view.panels import FAINT, INK, STYLE, TITLES, Drawing
from dotsim_ros.view.timeline import BagMoment, Forces

COLUMN_INCHES = 2.6
PLOT_INCHES = 2.3
DOTS_PER_INCH = 110
CONTACT_FRACTION = 0.1
LABEL_CHARACTERS = 12


def strongest_stamps(
    stamps_ns: NDArray[np.int64], forces: Forces | None, *, count: int
) -> list[int]:
    """Return the times to show: the greatest force in each of `count` parts of the contact.

    The moments in contact (above a tenth of the greatest force) are cut into parts of equal number
    in order of time. With fewer of them than parts, all moments are; without forces too, and the
    middle of each part is shown.
    """
    shown = stamps_ns
    strength = np.zeros(len(stamps_ns))
    if forces is not None:
        strength = np.array([np.linalg.norm(forces.at(int(stamp))) for stamp in stamps_ns])
        in_contact = strength >= CONTACT_FRACTION * strength.max()
        if in_contact.sum() >= count:
            shown, strength = stamps_ns[in_contact], strength[in_contact]
    chosen = []
    for part in np.array_split(np.arange(len(shown)), min(count, len(shown))):
        best = part[len(part) // 2] if forces is None else part[np.argmax(strength[part])]
        chosen.append(int(shown[best]))
    return chosen


def write_sheet(path: str | Path, moments: Iterable[BagMoment], drawing: Drawing) -> None:
    """Write a contact sheet with a column a moment as PNG, whole or not at all."""
    columns, images = list(moments), drawing.images
    heights = [COLUMN_INCHES * height / width for height, width in images.shape_px.values()]
    size = (COLUMN_INCHES * len(columns) + 1.5, sum(heights) + PLOT_INCHES + 1.3)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, dpi=DOTS_PER_INCH, layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(figure_label(drawing.title, 80), fontsize=13)
        grid = figure.add_gridspec(
            len(heights) + 1, len(columns), height_ratios=[*heights, PLOT_INCHES]
        )
        for row, name in enumerate(images.shape_px):
            row_axes = [figure.add_subplot(grid[row, column]) for column in range(len(columns))]
            for axes, moment in zip(row_axes, columns, strict=True):
                axes.set_xticks([])
                axes.set_yticks([])
                axes.spines[:].set_visible(False)
                image = images.panel(name, moment)
                if image is not None:
                    axes.imshow(image, interpolation="antialiased")
                if row == 0:
                    axes.set_title(_caption(moment, drawing))
            # Horizontal: an image may be lower than its label is long.
            row_axes[0].set_ylabel(
                textwrap.fill(TITLES[name], LABEL_CHARACTERS), rotation=0, ha="right", va="center"
            )
            scale = images.colour_scale(name)
            if scale is not None:
                figure.colorbar(scale, ax=row_axes, fraction=0.02, pad=0.01)
        plot = figure.add_subplot(grid[len(heights), :])
        drawing.draw_forces(plot)
        for moment in columns:
            time_s = drawing.time_s(moment)
            plot.axvline(time_s, color=FAINT, lw=1.0, zorder=0)
            below: Any = {"transform": plot.get_xaxis_transform(), "clip_on": False}
            plot.plot(time_s, 0.0, marker="v", color=INK, markersize=7, **below)
        with whole_file(path) as temporary, boxes_for_missing_glyphs():
            # The layout keeps no room for labels that are longer than their axes; this does.
            figure.savefig(temporary, format="png", bbox_inches="tight", pad_inches=0.15)


def _caption(moment: BagMoment, drawing: Drawing) -> str:
    caption = f"{drawing.time_s(moment):.2f} s"
    if drawing.forces is not None:
        caption += f"   {np.linalg.norm(drawing.forces.at(moment.stamp_ns)):.2f} N"
    return caption
