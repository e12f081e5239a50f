# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What video and contact sheet have in common: their look, their colour scales, the force plot."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from dotsim_ros.optics.picture import BACKGROUND, CHANGE_GAIN
from dotsim_ros.view.panels import (
    DEPTH_COLOURS,
    SKIN_COLOURS,
    Ranges,
)
from dotsim_ros.view.timeline import Forces

TITLES = {
    "image": "Image",
    "change": f"Change x{CHANGE_GAIN:g}",
    "depth": "Depth, mm",
    "skin": "Motion of the skin, mm",
}

INK = "#e6e9ee"
FAINT = "#5b6675"
STYLE: Any = {
    "figure.facecolor": tuple(level / 255 for level in BACKGROUND),
    "axes.facecolor": "#181d25",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": "#2b323d",
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.titlesize": 11.0,
}
AXIS_COLOURS = {"x": "#ff6b6b", "y": "#51cf66", "z": "#4dabf7"}


def colour_scale(name: str, ranges: Ranges) -> ScalarMappable | None:
    """Return the colour scale of a panel in millimetres, or None where it has none."""
    if name == "depth" and ranges.depth_m is not None:
        low, high = ranges.depth_m
        return ScalarMappable(Normalize(1e3 * low, 1e3 * high), matplotlib.colormaps[DEPTH_COLOURS])
    if name == "skin" and ranges.displacement_m is not None:
        high = ranges.displacement_m
        return ScalarMappable(Normalize(0.0, 1e3 * high), matplotlib.colormaps[SKIN_COLOURS])
    return None


def draw_forces(axes: Axes, forces: Forces | None, *, start_ns: int, end_ns: int) -> None:
    """Plot the force over the time of a bag, in seconds from its start."""
    axes.set_xlim(0.0, max(1e-3, (end_ns - start_ns) * 1e-9))
    axes.set_xlabel("time, s")
    if forces is None:
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no force recorded", transform=axes.transAxes, ha="center", va="center")
        return
    time_s = (forces.stamp_ns - start_ns) * 1e-9
    for index, (name, colour) in enumerate(AXIS_COLOURS.items()):
        axes.plot(time_s, forces.force_n[:, index], color=colour, lw=1.6, label=f"F{name}")
    magnitude = np.linalg.norm(forces.force_n, axis=1)
    axes.plot(time_s, magnitude, color=INK, lw=1.2, ls="--", label="|F|")
    axes.set_ylabel("force on the indenter, N")
    axes.grid(True)
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, frameon=False, borderaxespad=0.2
    )
