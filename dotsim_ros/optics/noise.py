# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The noise of the camera's sensor."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from dotsim_ros.io.arrays import ImageArray

TILE_PX = (61, 67)
"""Rows and columns that are drawn and repeated: much faster, and no different to a network."""


def with_noise(
    image: ImageArray, levels: float, seed: int | Sequence[int], *, channel_count: int = 3
) -> ImageArray:
    """Return the image with normal noise of a standard deviation in grey levels, where it is lit.

    Args:
        image: (H, W, 3).
        levels: the standard deviation; 0 for the image itself.
        seed: what the noise is drawn by, not negative.
        channel_count: of the camera: 3, or 1 for one whose channels are equal.
    """
    if levels <= 0.0:
        return image
    height, width = image.shape[:2]
    rows, columns = TILE_PX
    tile = np.random.default_rng(seed).standard_normal(
        (rows, columns, channel_count), dtype=np.float32
    )
    times = (height // rows + 1, width // columns + 1, 3 // channel_count)
    noise = np.tile(np.rint(tile * levels).astype(np.int16), times)[:height, :width]
    # Clipped to grey levels.
    noisy = np.asarray(cv2.add(image, noise, dtype=cv2.CV_8U), dtype=np.uint8)
    noisy[image == 0] = 0
    return noisy
