# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Confusion matrices of the rows that matter, as one picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dotsim_ros.io.files import whole_file
from studies.optics.models import BOUND

SHOWN = ("ours", "paper", BOUND)
PANEL_IN = 2.9
DARK = 0.5
"""Share from which a cell is dark, so that its figure is white."""


def write_confusions(file: Path, figures: Mapping[str, Any], domains: Sequence[str]) -> None:
    """Draw a panel for each domain (down) and each row of `SHOWN` that there is (across)."""
    models = [model for model in SHOWN if all(model in figures[domain] for domain in domains)]
    models = models or list(figures[domains[0]])[:1]
    size = (PANEL_IN * len(models) + 0.6, PANEL_IN * len(domains))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(domains), len(models), squeeze=False)
    for line, domain in zip(panels, domains, strict=True):
        for axes, model in zip(line, models, strict=True):
            row = figures[domain][model]
            shares = np.array(row["confusion"], dtype=float)
            shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1.0)
            axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0)
            for (shown, told), share in np.ndenumerate(shares):
                colour = "white" if share > DARK else "black"
                axes.text(told, shown, f"{100.0 * share:.0f}", ha="center", va="center", c=colour)
            names = [name.partition("_")[2] or name for name in row["classes"]]
            axes.set_xticks(range(len(names)), names, rotation=40, ha="right", fontsize=7)
            axes.set_yticks(range(len(names)), names, fontsize=7)
            axes.set_title(f"{domain}, {model}: {100.0 * row['mean']:.1f} %", fontsize=9)
        line[0].set_ylabel("shown")
    for axes in panels[-1]:
        axes.set_xlabel("told, % of the frames shown")
    with whole_file(file) as part:
        figure.savefig(part, dpi=110)
