# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What presses look like: images of both classes, by our gel and skin and by CalculiX."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.files import whole_file
from studies.tumour.images import Eye
from studies.tumour.presses import Simulation, SolvedPress
from studies.tumour.skins import CLASSES, SKINS

STRENGTH = 100.0
MIDDLE = 128.0
"""Grey levels of one unit of motion, and of none."""
WHITE = (255, 255, 255)


def write_presses(
    file: Path, simulation: Simulation, eye: Eye, judged: Mapping[str, Sequence[SolvedPress]]
) -> None:
    """Draw the same presses, solved by our gel and skin and by CalculiX, next to each other.

    Args:
        file: of the picture.
        simulation: of our gel and skins.
        eye: that sees the presses.
        judged: CalculiX's presses by skin, of which the first tumour and the first none are drawn,
            at their last depth.
    """
    rows = []
    for name, real in judged.items():
        labels = [press.press.label for press in real]
        shown = [real[labels.index(label)] for label in (1, 0) if label in labels]
        ours = simulation.solved(SKINS[name], [press.press for press in shown], 1)
        titled = [(press, f"{name}, {CLASSES[press.press.label]}: ours") for press in ours]
        titled += [(press, f"{CLASSES[press.press.label]}: CalculiX") for press in shown]
        rows.append(np.hstack([_column(eye, press, title) for press, title in titled]))
    width = max(row.shape[1] for row in rows)
    sheet = np.vstack([np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows])
    with whole_file(file) as part:
        cv2.imwrite(str(part), np.ascontiguousarray(sheet[..., ::-1]))


def _column(eye: Eye, press: SolvedPress, title: str) -> ImageArray:
    """Return the last image of a press above what a classifier is shown of its motion."""
    (image,) = eye.images(press.skin_m[0, -1:])
    height, width = image.shape[:2]
    column = np.vstack([image, np.zeros((height // 2, width, 3), dtype=np.uint8)])
    for part, motion in enumerate(eye.shown(image, eye.idle)[:2]):
        grey = np.clip(MIDDLE + STRENGTH * motion, 0.0, 255.0).astype(np.uint8)
        large = cv2.resize(grey, (width // 2, height // 2), interpolation=cv2.INTER_NEAREST)
        column[height:, part * width // 2 : (part + 1) * width // 2] = large[..., None]
    place, size = (6, 14), 0.42
    cv2.putText(column, title, place, cv2.FONT_HERSHEY_SIMPLEX, size, WHITE, 1, cv2.LINE_AA)
    return column
