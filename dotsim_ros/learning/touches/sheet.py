# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The contact sheet of a data set of touches: the strongest frame of each, image and change."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.files import read_image, write_image
from dotsim_ros.learning.touches.making import Side, Touch
from dotsim_ros.optics.picture import frame_picture, titled

SHEET = "contact_sheet.jpg"
PANEL_WIDTH_PX = 150
COLUMNS = 3
MOST_TOUCHES = 36


def thumbnail_of(touch: Touch) -> ImageArray:
    """Return a touch's strongest frame (H, W, 3): image, change and depth of each side."""
    rows = [_row(side, touch) for side in touch.sides]
    return np.vstack(rows)


def _row(side: Side, touch: Touch) -> ImageArray:
    image, idle = side.images[side.strongest], side.idle_image
    height, width = image.shape[:2]
    size = (PANEL_WIDTH_PX, round(height * PANEL_WIDTH_PX / width))
    small, small_idle = (
        np.asarray(cv2.resize(each, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        for each in (image, idle)
    )
    nearest = cv2.resize(side.depth_m, size, interpolation=cv2.INTER_NEAREST)
    depth = np.asarray(nearest, dtype=np.float32)
    force = side.solved.wrenches[side.strongest].force_n
    title = (
        f"{touch.number} {touch.task}  {np.linalg.norm(force):.2f} N  "
        f"slip {side.solved.slip_share[side.strongest]:.0%}"
    )
    return titled(frame_picture(small, small_idle, depth), title)


def write_sheet(folder: Path, thumbnails: Sequence[Path]) -> Path:
    """Write the contact sheet of the pictures of touches, evenly chosen, and return its file."""
    chosen = np.unique(np.linspace(0, len(thumbnails) - 1, MOST_TOUCHES).astype(int))
    pictures = [read_image(thumbnails[number]) for number in chosen]
    blank = np.zeros_like(pictures[0])
    pictures += [blank] * (-len(pictures) % COLUMNS)
    rows = [np.hstack(pictures[i : i + COLUMNS]) for i in range(0, len(pictures), COLUMNS)]
    write_image(folder / SHEET, np.vstack(rows))
    return folder / SHEET
