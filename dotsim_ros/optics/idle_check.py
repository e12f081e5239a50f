# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Checks that idle images show the gel without contact: against each other, and against the first
frames of presses whose indenter is still off the gel.

Two images of one scene differ by noise that neighbouring pixels do not share, so a blur takes it
away; a contact moves the pattern over many pixels and stays. On the stand-in data set, whose images
are path-traced, the blurred difference of an untouched frame from the idle image reaches 12 grey
levels, and that of a contact 0.5 mm deep 25 to 36.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.io.arrays import BoolArray, Float32Array, ImageArray
from dotsim_ros.optics.idle import lit_region

BLUR_PX = 2.0
"""Standard deviation of the blur, up to 240 pixels of height; of larger images in proportion."""
REFERENCE_HEIGHT = 240

LEAST_DEVIATION_LEVELS = 0.5
"""Whole grey levels hide a smaller noise."""
BLOCK_PX = 8
QUIET_SHARE = 0.25
TOLERANCE_LEVELS = 3.0
TOLERANCE_DEVIATIONS = 3.2
"""A blurred difference counts as contact where it exceeds the levels plus so many deviations of the
unblurred one: noise of one deviation leaves 0.7 of it as the largest of an image if it is white,
and up to four if a few pixels are far off, as those of a path tracer."""


@dataclass(frozen=True)
class Difference:
    """How one image differs from another beyond noise.

    Attributes:
        largest_levels: largest blurred difference, grey levels.
        tolerated_levels: what noise explains.
        pixel: (x, y) where it lies.
    """

    largest_levels: float
    tolerated_levels: float
    pixel: tuple[int, int]

    @property
    def is_noise(self) -> bool:
        """Whether noise explains it."""
        return self.largest_levels <= self.tolerated_levels

    def __str__(self) -> str:
        return (
            f"{self.largest_levels:.0f} grey levels around pixel {self.pixel}, where noise leaves "
            f"{self.tolerated_levels:.0f}"
        )


def difference(
    image: ImageArray | Float32Array, other: ImageArray | Float32Array, lit: BoolArray
) -> Difference:
    """Return how two images (H, W, 3) differ within the lit disc (H, W)."""
    change = image.astype(np.float32) - other.astype(np.float32)
    change[~lit] = 0.0
    deviation = max(_noise_deviation(change, lit), LEAST_DEVIATION_LEVELS)
    size_px = BLUR_PX * max(len(change) / REFERENCE_HEIGHT, 1.0)
    blurred = np.abs(cv2.GaussianBlur(change, (0, 0), size_px)).max(axis=2)
    y, x = np.unravel_index(int(np.argmax(blurred)), blurred.shape)
    return Difference(
        float(blurred[y, x]),
        TOLERANCE_LEVELS + TOLERANCE_DEVIATIONS * deviation,
        (int(x), int(y)),
    )


def _noise_deviation(change: Float32Array, lit: BoolArray) -> float:
    """Return the root mean square of a change (H, W, 3) in the quieter blocks of the lit disc,
    which a contact does not reach."""
    size = (lit.shape[1] // BLOCK_PX, lit.shape[0] // BLOCK_PX)
    whole = cv2.resize(lit.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
    square = cv2.resize(np.mean(change**2, axis=2), size, interpolation=cv2.INTER_AREA)
    if not whole.any():
        return float(np.sqrt(np.mean(change[lit] ** 2)))
    return float(np.sqrt(np.quantile(square[whole], QUIET_SHARE)))


def read_idle_images(paths: Sequence[Path]) -> NDArray[np.uint8]:
    """Read idle images of one camera, (N, H, W, 3) uint8, red, green, blue.

    Raises:
        ValueError: none, a file that is no colour image of 8 bits, or images of several sizes.
    """
    if not paths:
        raise ValueError(
            "no idle image: record a few images without contact as idle_0.png, idle_1.png, ..."
        )
    images: list[ImageArray] = []
    for path in paths:
        pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if pixels is None:
            raise ValueError(f"{path} is no image that OpenCV can read; expected a PNG file")
        if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] != 3:
            raise ValueError(
                f"{path} has shape {pixels.shape} and type {pixels.dtype}, expected a colour image "
                "of 8 bits a channel"
            )
        if images and pixels.shape != images[0].shape:
            raise ValueError(
                f"{path} is {pixels.shape[1]}x{pixels.shape[0]}, but {paths[0]} is "
                f"{images[0].shape[1]}x{images[0].shape[0]}; record all with one camera"
            )
        images.append(np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8))
    return np.stack(images)


def mean_idle_image(images: NDArray[np.uint8], paths: Sequence[Path]) -> ImageArray:
    """Return the mean (H, W, 3) of idle images (N, H, W, 3) that show the same.

    Args:
        images: of `read_idle_images`.
        paths: their files, for the message.

    Raises:
        ValueError: they are dark, or one differs from the others by more than noise: something
            touched the gel.
    """
    mean = images.mean(axis=0, dtype=np.float64).astype(np.float32)
    lit = lit_region(np.rint(mean).astype(np.uint8))
    if not lit.any():
        raise ValueError(f"{paths[0].parent}: the idle images are dark; expected the lit gel")
    # The median of three images or more shows what most of them show.
    usual = np.median(images, axis=0).astype(np.float32)
    for image, path in zip(images, paths, strict=True):
        found = difference(image, usual, lit)
        if not found.is_noise:
            raise ValueError(
                f"{path} differs from the other idle images by {found}: something touched the gel, "
                "or the camera or its exposure changed; take idle images again, without contact"
            )
    return np.rint(mean).astype(np.uint8)


def check_untouched(idle: ImageArray, untouched: Iterable[tuple[str, ImageArray]]) -> None:
    """Raise ValueError where frames without contact show another gel than the idle image.

    Args:
        idle: (H, W, 3).
        untouched: names and images of frames whose indenter does not touch the gel.
    """
    lit = lit_region(idle)
    found = [(name, difference(image, idle, lit)) for name, image in untouched]
    other = [(name, change) for name, change in found if not change.is_noise]
    if not other:
        return
    name, change = max(other, key=lambda item: item[1].largest_levels)
    if 2 * len(other) > len(found):
        raise ValueError(
            f"the idle image shows another gel than {len(other)} of {len(found)} frames whose "
            f"indenter does not touch it; {name} differs by {change}: the idle image was taken "
            "with something in contact, or the camera, its exposure or the lights changed since; "
            "take idle images again, without contact, before the presses"
        )
    raise ValueError(
        f"{name} differs from the idle image by {change}, though its pose is off the gel; check "
        "that the pose is that of the indenter's tip in the sensor's base frame, or leave this "
        f"press out ({len(other)} of {len(found)} such frames differ)"
    )
