# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images for people: what a press changes, and the image, change and depth side by side."""

from __future__ import annotations

import cv2
import numpy as np

from dotsim_ros.io.arrays import Float32Array, ImageArray

BACKGROUND = (16, 20, 26)
INK = (230, 233, 238)
CHANGE_GAIN = 3.0
"""A press changes most pixels by a few tens of grey levels; this makes it plain to see."""
TITLE_HEIGHT_PX = 24
FONT_SIZE = 0.5
FARTHEST_SHOWN_PERCENT = 99.0
"""End of the colour scale: a few pixels at the edge of the gel are far from all others. The other
end is the nearest pixel, so that no press is cut off."""


def change_image(image: ImageArray, before: ImageArray, gain: float = CHANGE_GAIN) -> ImageArray:
    """Return the difference of two images, times a gain; grey where nothing changes.

    Args:
        image, before: (H, W, 3) uint8.
        gain: grey levels for one of the difference.
    """
    difference = image.astype(np.float32) - before
    return np.clip(127.5 + gain * difference, 0.0, 255.0).astype(np.uint8)


def frame_picture(image: ImageArray, idle_image: ImageArray, range_m: Float32Array) -> ImageArray:
    """Return (H + `TITLE_HEIGHT_PX`, 3 W, 3) the image, its change and the range side by side.

    Args:
        image: (H, W, 3) uint8, red, green, blue.
        idle_image: the image without contact, of the same shape.
        range_m: (H, W) distance along the ray, NaN where no skin is seen; the nearest is bright.
    """
    seen = np.isfinite(range_m)
    ends = (0.0, FARTHEST_SHOWN_PERCENT)
    near_m, far_m = np.percentile(range_m[seen], ends) if seen.any() else (0.0, 0.0)
    share = (far_m - np.where(seen, range_m, far_m)) / max(far_m - near_m, 1e-12)
    level = (255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8)
    bgr = cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS)
    coloured = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB).astype(np.uint8)
    coloured[~seen] = BACKGROUND
    titles = (
        "image",
        f"change x{CHANGE_GAIN:g}",
        f"range {1e3 * near_m:.1f} to {1e3 * far_m:.1f} mm",
    )
    panels = (image, change_image(image, idle_image), coloured)
    return np.hstack([titled(*pair) for pair in zip(panels, titles, strict=True)])


def titled(panel: ImageArray, title: str) -> ImageArray:
    """Return an image (H, W, 3) below a line of `TITLE_HEIGHT_PX` with its title."""
    width = panel.shape[1]
    line = np.full((TITLE_HEIGHT_PX, width, 3), BACKGROUND, dtype=np.uint8)
    font = cv2.FONT_HERSHEY_SIMPLEX
    # Small images have small letters: none is cut off.
    size = min(
        FONT_SIZE, FONT_SIZE * (width - 8) / cv2.getTextSize(title, font, FONT_SIZE, 1)[0][0]
    )
    cv2.putText(line, title, (4, TITLE_HEIGHT_PX - 7), font, size, INK, 1, cv2.LINE_AA)
    return np.vstack([line, panel])
