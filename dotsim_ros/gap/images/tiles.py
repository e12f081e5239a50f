# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What of two images is compared: the tiles of a grid inside the lit disc, with sign and place.

Of each tile six numbers: the difference of the mean red, green and blue, that of the sharpness, and
the way in x and y that the pattern has moved. The way is the least-squares answer of the difference
to the reference's gradient (Lucas and Kanade, "An iterative image registration technique with an
application to stereo vision", 1981), fitted together with a gain and an offset of the tile, so that
brightness is not taken for motion. All but the sharpness are linear in the difference of the
images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.io.arrays import BoolArray, FloatArray, IntArray

NAMES = ("red", "green", "blue", "sharpness", "shift_x", "shift_y")
"""Observables of a tile."""
COLOURS = slice(0, 3)
SHARPNESS = 3
SHIFTS = slice(4, 6)

RIM_PX = 4
"""Pixels closer to the rim of the lit disc belong to no tile, in an image up to 240 px high: what
is beyond the rim is dark, and the blur reaches it. In larger ones in proportion."""
REFERENCE_HEIGHT = 240
LEAST_SHARE = 0.5
"""A tile of which less is inside has no place in the grid."""
SMOOTHING_PX = 1.0
"""Deviation of the blur before anything is differentiated, against the noise of single pixels."""
NOISE_PRIOR_IMAGES = 4.0
"""Weight, in images, of the noise of all tiles in that of one."""


@dataclass(frozen=True)
class TileGrid:
    """Where the T tiles are.

    Attributes:
        centre_px: (T, 2) mean x and y of each tile's pixels.
        tile: (H, W) number of each pixel's tile; -1 for none.
        count: (T,) pixels of each.
    """

    centre_px: FloatArray
    tile: IntArray
    count: IntArray

    def __len__(self) -> int:
        """Return T."""
        return len(self.count)

    def mean(self, image: NDArray[np.generic]) -> FloatArray:
        """Return (T, ...) the mean over each tile of an image (H, W, ...)."""
        values = image.reshape(self.tile.size, -1)[self._order].astype(np.float64)
        first = np.concatenate([[0], np.cumsum(self.count[:-1])])
        means = np.add.reduceat(values, first, axis=0) / self.count[:, None]
        return np.asarray(means.reshape(len(self), *image.shape[2:]))

    @cached_property
    def _order(self) -> IntArray:
        """Return the pixels inside, tile by tile."""
        flat = self.tile.ravel()
        return np.argsort(flat, kind="stable")[int(np.count_nonzero(flat < 0)) :]


def tile_grid(lit: BoolArray, *, columns: int = 8, rows: int = 6) -> TileGrid:
    """Return the tiles of an even grid over an image, as far as they lie in the lit disc.

    Args:
        lit: (H, W) the lit disc.
        columns, rows: of the grid.

    Raises:
        ValueError: no tile is lit.
    """
    height, width = lit.shape
    rim = RIM_PX * max(height / REFERENCE_HEIGHT, 1.0)
    # Beyond the image's edge the disc continues.
    padded = cv2.copyMakeBorder(lit.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    inside = distance > rim
    y, x = np.mgrid[0:height, 0:width]
    number = (y * rows // height) * columns + x * columns // width
    whole = np.bincount(number.ravel(), minlength=rows * columns)
    count = np.bincount(number[inside], minlength=rows * columns)
    kept = (count > 0) & (count >= LEAST_SHARE * whole)
    if not kept.any():
        raise ValueError(
            f"no tile of {columns} x {rows} lies in the lit disc of {int(lit.sum())} pixels of "
            f"{width}x{height}; expected images of the lit gel"
        )
    new = np.where(kept, np.cumsum(kept) - 1, -1)
    tile = np.where(inside, new[number], -1).astype(np.int64)
    centre = np.zeros((int(kept.sum()), 2))
    grid = TileGrid(centre, tile, count[kept].astype(np.int64))
    return TileGrid(grid.mean(np.stack([x, y], axis=-1).astype(np.float64)), tile, grid.count)


@dataclass(frozen=True)
class TileReference:
    """What comparing with one reference takes that the image does not enter.

    Attributes:
        colour: (T, 3) mean of each tile.
        grey: (H, W) smoothed.
        detail: (T,) deviation of its Laplacian.
        terms: (H, W, 4) what a difference is explained by: motion in x and y, gain, offset.
        solve: (T, 2, 4) from the terms' products with the difference to the motion.
    """

    colour: FloatArray
    grey: FloatArray
    detail: FloatArray
    terms: FloatArray
    solve: FloatArray


@dataclass(frozen=True)
class TileMeter:
    """Compares images tile by tile, all against one idle frame.

    Args:
        grid: the tiles.
        idle: (H, W, 3) the frame whose sharpness is 1.
    """

    grid: TileGrid
    idle: FloatArray

    def colour(self, images: NDArray[np.generic]) -> FloatArray:
        """Return (F, T, 3) mean colours, levels, of images (F, H, W, 3)."""
        return np.stack([self.grid.mean(image) for image in images])

    def sharpness(self, images: NDArray[np.generic]) -> FloatArray:
        """Return (F, T) the deviation of the Laplacian of images (F, H, W, 3), over the idle
        frame's."""
        rest = self._detail(_smooth_grey(self.idle))
        return np.stack([self._detail(_smooth_grey(image)) / rest for image in images])

    def difference(
        self, images: NDArray[np.generic], references: NDArray[np.generic]
    ) -> FloatArray:
        """Return (F, T, 6) the observables `NAMES` of images against references, (F, H, W, 3)."""
        return self.differences([images], self.references(references))[0]

    def differences(
        self, several: Sequence[NDArray[np.generic]], references: Sequence[TileReference]
    ) -> list[FloatArray]:
        """Return `difference` of several films, (F, H, W, 3) each, against F references."""
        rest = self._detail(_smooth_grey(self.idle))
        results = [np.empty((len(references), len(self.grid), len(NAMES))) for _ in several]
        for frame, reference in enumerate(references):
            for images, result in zip(several, results, strict=True):
                grey = _smooth_grey(images[frame])
                products = reference.terms * (grey - reference.grey)[..., None]
                motion = np.einsum("tij,tj->ti", reference.solve, self.grid.mean(products))
                result[frame, :, COLOURS] = self.grid.mean(images[frame]) - reference.colour
                result[frame, :, SHARPNESS] = (self._detail(grey) - reference.detail) / rest
                result[frame, :, SHIFTS] = motion
        return results

    def references(self, images: NDArray[np.generic]) -> list[TileReference]:
        """Return what comparing with images (F, H, W, 3) takes, to be used several times."""
        return [self._reference(image) for image in images]

    def _reference(self, image: NDArray[np.generic]) -> TileReference:
        grey = _smooth_grey(image)
        slope_y, slope_x = np.gradient(grey)
        # What moves by d looks at x - d: the difference is -d . gradient.
        terms = np.stack([-slope_x, -slope_y, grey, np.ones_like(grey)], axis=-1)
        normal = self.grid.mean(terms[..., :, None] * terms[..., None, :])
        # A tile without texture does not identify a motion: none is found there.
        inverse = np.asarray(np.linalg.pinv(normal, rcond=1e-9), dtype=np.float64)
        return TileReference(self.grid.mean(image), grey, self._detail(grey), terms, inverse[:, :2])

    def _detail(self, smooth_grey: FloatArray) -> FloatArray:
        """Return (T,) the deviation of the Laplacian of a smoothed grey image (H, W)."""
        laplacian = cv2.Laplacian(smooth_grey, cv2.CV_64F)
        mean, square = self.grid.mean(np.stack([laplacian, laplacian**2], axis=-1)).T
        # A tile without any texture keeps a finite ratio.
        return np.sqrt(np.maximum(square - mean**2, 1e-6))

    def noise(self, repeats: NDArray[np.generic]) -> FloatArray:
        """Return (T, 6) the deviation of the observables of one image by the camera's noise.

        Each tile's is estimated together with that of all tiles, which weigh as much as
        `NOISE_PRIOR_IMAGES` images: of a few images alone it would be off by a third.

        Args:
            repeats: (N, H, W, 3) of one scene, two at least.
        """
        mean = repeats.mean(axis=0, dtype=np.float64)
        found = self.difference(repeats, np.broadcast_to(mean, repeats.shape))
        # A mean of noisy images has less detail than any of them: spread, not distance.
        spread = np.sum((found - found.mean(axis=0)) ** 2, axis=0)
        freedom = len(repeats) - 1.0
        pooled = (spread / freedom).mean(axis=0)
        prior = NOISE_PRIOR_IMAGES
        return np.sqrt((spread + prior * pooled) / (freedom + prior))


def _smooth_grey(image: NDArray[np.generic]) -> FloatArray:
    """Return the mean of an image's colours (H, W), smoothed."""
    grey = image.astype(np.float64) @ np.full(3, 1.0 / 3.0)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), SMOOTHING_PX), dtype=np.float64)
