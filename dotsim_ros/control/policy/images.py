# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a policy sees of a camera's image: the middle of the crop and its change against idle.

The change is divided by the local brightness of the idle image, so that neither the strength nor
the colour of the lights matters much. Pure functions of images; nothing here is learned.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from dotsim_ros.io.arrays import Float32Array, ImageArray

DARK_LEVELS = 16.0
"""Added to the idle image's brightness, in grey levels, before anything is divided by it."""
LIT_LEVEL = 10
"""Grey level above which a pixel of the idle image counts as lit."""
GRID = (6, 8)
"""Rows and columns of the cells that `fingerprint` summarises."""
CELL_PX = 10
CHANNEL_COUNT = 8
FINGERPRINT = 2 * GRID[0] * GRID[1]
"""How many numbers `fingerprint` gives."""
LARGEST_SIDE_PX = 4096


@dataclass(frozen=True)
class PolicyView:
    """Which part of the image a network sees, and how finely.

    Attributes:
        image_shape: height and width of the images; others of the same aspect ratio are scaled.
        share: side of the square in the middle of the image, over the image's height.
        side_px: side of the square as the network sees it.

    Raises:
        ValueError: a number is out of range.
    """

    image_shape: tuple[int, int] = (480, 640)
    share: float = 0.56
    side_px: int = 80

    def __post_init__(self) -> None:
        are_lengths = all(32 <= length <= LARGEST_SIDE_PX for length in self.image_shape)
        if len(self.image_shape) != 2 or not are_lengths:
            raise ValueError(
                f"image_shape is {self.image_shape}, expected height and width from 32 to "
                f"{LARGEST_SIDE_PX}"
            )
        if not 0.1 <= self.share <= 1.0:
            raise ValueError(f"share is {self.share}, expected 0.1 to 1")
        if not 32 <= self.side_px <= 512:
            raise ValueError(f"side_px is {self.side_px}, expected 32 to 512")

    def check(self, image: ImageArray, what: str) -> None:
        """Refuse an image that is not of this view.

        Raises:
            ValueError: it is not (h, w, 3) uint8, or its aspect ratio differs by 1 % and more.
        """
        height, width = self.image_shape
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise ValueError(
                f"the {what} has shape {image.shape} and type {image.dtype}, expected (h, w, 3) "
                "uint8 in the order red, green, blue"
            )
        if abs(image.shape[1] * height / (image.shape[0] * width) - 1.0) > 0.01:
            raise ValueError(
                f"the {what} is {image.shape[1]}x{image.shape[0]}, expected {width}x{height} or "
                "another size of the same aspect ratio, showing the same view"
            )

    def crop(self, image: ImageArray) -> ImageArray:
        """Return the middle (side, side, 3) of an image (h, w, 3)."""
        height, width = image.shape[:2]
        half = 0.5 * self.share * height
        top, left = round(0.5 * height - half), max(0, round(0.5 * width - half))
        bottom, right = round(0.5 * height + half), round(0.5 * width + half)
        middle = image[top:bottom, left:right]
        shrinks = middle.shape[0] >= self.side_px
        size = (self.side_px, self.side_px)
        interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(middle, size, interpolation=interpolation), dtype=np.uint8)


def local_brightness(idle: Float32Array) -> Float32Array:
    """Return (h, w, 3) what changes of an idle crop (h, w, 3), grey levels, are divided by."""
    blur = cv2.GaussianBlur(idle, (0, 0), 0.06 * idle.shape[0], borderType=cv2.BORDER_REPLICATE)
    return np.asarray(blur + np.float32(DARK_LEVELS), dtype=np.float32)


class PolicyInput:
    """Makes a network's input from crops of one idle crop (side, side, 3) uint8."""

    def __init__(self, idle: ImageArray) -> None:
        self._idle = idle.astype(np.float32)
        self._brightness = local_brightness(self._idle)
        line = np.linspace(-1.0, 1.0, idle.shape[0], dtype=np.float32)
        # Each pixel's place, from -1 to 1, rightwards and downwards.
        self._place = np.stack(np.meshgrid(line, line))

    def __call__(self, crop: ImageArray) -> Float32Array:
        """Return (CHANNEL_COUNT, side, side): change (3), crop (3), place (2); each about 1."""
        now = crop.astype(np.float32)
        change = 4.0 * (now - self._idle) / self._brightness
        relative = 2.0 * (now / self._brightness - 0.7)
        return np.concatenate(
            [change.transpose(2, 0, 1), relative.transpose(2, 0, 1), self._place]
        ).astype(np.float32)


def fingerprint(image: ImageArray, idle: ImageArray) -> Float32Array:
    """Return (96,) a descriptor by which another sensor's images are detected: for each of 6x8
    cells of the whole image (h, w, 3) the lit share of the idle image, and how much the image
    differs."""
    size = (GRID[1] * CELL_PX, GRID[0] * CELL_PX)
    small = cv2.resize(idle, size, interpolation=cv2.INTER_AREA)
    now = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    lit = (small.max(axis=2) > LIT_LEVEL).astype(np.float32)
    before = small.astype(np.float32)
    change = np.abs(now - before) / local_brightness(before)
    cells = [_cell_means(lit), 10.0 * _cell_means(change.mean(axis=2))]
    return np.concatenate(cells).astype(np.float32)


def _cell_means(values: Float32Array) -> Float32Array:
    cells = values.reshape(GRID[0], CELL_PX, GRID[1], CELL_PX)
    return np.asarray(cells.mean(axis=(1, 3)).ravel(), dtype=np.float32)
