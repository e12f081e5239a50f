# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presses of a ball on a GelSight, as Rancho-zhao/FOTS publishes them (`mlp_calib/`, MIT).

Zhao, Qian, Duan, Luo: "FOTS: A Fast Optical Tactile Simulator for Sim2Real Learning of
Tactile-motor Robot Manipulation Skills", RA-L 2024 (arXiv 2404.19217). Images 240 wide and 320
high, one without contact, and circles marked by hand. Ball and scale are those of its repository.
"""

from __future__ import annotations

from pathlib import Path

from studies.optics.marked_photographs import (
    BallRecording,
    CircleColumns,
    read_marked_photographs,
)

BALL_RADIUS_M = 2.35e-3
PIXELS_PER_METRE = 19.58e3
TABLE = "contact_circles.csv"


def read_fots_balls(directory: Path) -> BallRecording:
    """Return the recording.

    Args:
        directory: with idle.png, contact_circles.csv and the images that it names.

    Raises:
        FileNotFoundError, ValueError: as `read_marked_photographs`.
    """
    columns = CircleColumns("img_names", "center_x", "center_y", "radius")
    idle, presses = read_marked_photographs(
        directory / "idle.png", directory / TABLE, columns, directory
    )
    return BallRecording("gelsight", idle, presses, BALL_RADIUS_M, PIXELS_PER_METRE)
