# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presses of a ball on two GelSights, as the package `taxim` publishes them (MIT).

Si, Yuan: "Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L 7(2), 2022
(arXiv 2109.04027), as continued in TimSchneider42/taxim. Images of 640x480 and circles marked by
hand, for a lab's GelSight and for a GelSight Mini.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from studies.optics.marked_photographs import (
    BallRecording,
    CircleColumns,
    read_marked_photographs,
)


@dataclass(frozen=True)
class TaximSubset:
    """One of the two sensors.

    Attributes:
        ball_radius_m: of the ball.
        pixels_per_metre: of the flat gel.
        scale_known: whether these were recorded.
    """

    ball_radius_m: float
    pixels_per_metre: float
    scale_known: bool


SUBSETS = {
    "gelsight": TaximSubset(2.0e-3, 1.0 / 0.0295e-3, True),
    # Neither was recorded. The scale is the 0.0634 mm a pixel of the maker's demonstrations at
    # 320x240; images of a ball alone do not tell its radius, see docs/real_data.md. It is a round
    # number above the widest contact found.
    "gelsight_mini": TaximSubset(1.0e-3, 2.0 / 0.0634e-3, False),
}


def read_taxim_balls(directory: Path, subset: str) -> BallRecording:
    """Return the recording of one sensor.

    Args:
        directory: with a folder and a table of circles for each sensor.
        subset: one of `SUBSETS`.

    Raises:
        FileNotFoundError, ValueError: as `read_marked_photographs`, or no such subset.
    """
    if subset not in SUBSETS:
        raise ValueError(f"subset is {subset!r}, expected one of {', '.join(SUBSETS)}")
    known = SUBSETS[subset]
    columns = CircleColumns(
        "file", "contact_x_px", "contact_y_px", "contact_radius_px", withheld=("split", "held_out")
    )
    folder = directory / subset
    idle, presses = read_marked_photographs(
        folder / "idle.png", directory / f"{subset}.csv", columns, folder
    )
    return BallRecording(
        f"taxim_{subset}",
        idle,
        presses,
        known.ball_radius_m,
        known.pixels_per_metre,
        known.scale_known,
    )
