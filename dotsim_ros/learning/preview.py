# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sheet that shows what a network has learned: measured, warped, predicted, and the error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.files import write_image
from dotsim_ros.twin.footage import OpticalPress

COLUMNS = ("measured", "warped", "predicted", "error of warped x4", "error of predicted x4")
ERROR_GAIN = 4.0
TITLE_PX = 18


def _error(image: ImageArray, measured: ImageArray) -> ImageArray:
    error = 128.0 + ERROR_GAIN * (measured.astype(np.float32) - image)
    return np.clip(error, 0.0, 255.0).astype(np.uint8)


def _titled(image: ImageArray, title: str) -> ImageArray:
    bar = np.zeros((TITLE_PX, image.shape[1], 3), dtype=np.uint8)
    cv2.putText(
        bar, title, (3, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (230, 230, 230), 1, cv2.LINE_AA
    )
    return np.vstack([bar, image])


def write_preview(
    path: Path, presses: Sequence[OpticalPress], predicted: Sequence[ImageArray], *, rows: int = 6
) -> None:
    """Write the deepest frame of each press, a row each, as PNG.

    Args:
        path: of the file.
        presses: what was measured; presses beyond `rows` are thinned evenly.
        predicted: images (F, H, W, 3) of each press.
        rows: most rows.
    """
    chosen = np.unique(np.linspace(0, len(presses) - 1, min(rows, len(presses))).astype(int))
    lines = []
    for index in chosen:
        press = presses[index]
        frame = int(np.argmax(press.tip_depth_m))
        measured, warped = press.measured[frame], press.warped[frame]
        image = predicted[index][frame]
        images = (measured, warped, image, _error(warped, measured), _error(image, measured))
        titles = (f"{press.name}, frame {frame}: {COLUMNS[0]}", *COLUMNS[1:])
        lines.append(np.hstack([_titled(*pair) for pair in zip(images, titles, strict=True)]))
    write_image(path, np.vstack(lines))
