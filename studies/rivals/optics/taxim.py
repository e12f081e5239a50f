# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Taxim's image: a table over the skin's slope, each entry a polynomial of the pixel's position.

Si, Yuan: "Taxim: An Example-Based Simulation Model for GelSight Tactile Sensors", RA-L 7(2), 2022
(arXiv 2109.04027). The gradient of the height map, as magnitude and direction, names an entry of a
table of 125 by 125; an entry holds, for each colour, the six coefficients of a polynomial of second
degree of the pixel's position, which gives the change of the colour against the image without
contact. It is fitted by least squares on presses with known shape; entries that no pixel fell into
take those of their neighbours.

The paper's gel is flat. Here the normal is turned first by the rotation that takes the normal of
the same pixel at rest to a flat gel's, so that the gradient is zero at rest. The magnitude is given
as the angle of the slope. The paper's shadows, from a second table measured with single pins, are
left out, as no such presses exist.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import Float32Array, FloatArray, ImageArray, IntArray
from dotsim_ros.twin.footage import OpticalPress, Rest
from studies.rivals.optics.pixels import (
    Ground,
    PixelGrid,
    PixelSamples,
    draw_pixels,
    idle_ground,
    pixel_grid,
)

PUBLISHED_BINS = 125
CANDIDATE_BINS = (8, 16, 32, 64, PUBLISHED_BINS)
"""Numbers of bins each way, of which the best on held-back presses is taken."""
SAMPLES = 4_000_000
TERMS = 6
LEAST_PIXELS = 30
"""Pixels below which an entry takes its neighbours' polynomial: five for each coefficient."""
CANDIDATE_RIDGES = (1e-3, 10.0, 300.0)
"""Pulls of the coefficients to zero, in pixels, of which the best on held-back presses is taken."""
HELD_BACK = 4
"""Every fourth press is held back to choose the number of bins."""


def polynomial_terms(position: Float32Array) -> FloatArray:
    """Return (N, 6) terms of second degree of positions (N, 2)."""
    x, y = position[:, 0].astype(np.float64), position[:, 1].astype(np.float64)
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def slope_bins(relative: Float32Array, bins: int) -> IntArray:
    """Return (N,) the entry of the table for normals (N, 3) relative to rest.

    Args:
        relative: as `pixels.relative_normal`; at rest (0, 0, -1).
        bins: number of bins of the slope's angle, 0 to a right angle, and of its direction.
    """
    across = np.hypot(relative[:, 0], relative[:, 1])
    angle = np.arctan2(across, np.maximum(-relative[:, 2], 0.0))
    direction = np.arctan2(relative[:, 1], relative[:, 0])
    row = np.minimum(angle / (0.5 * np.pi) * bins, bins - 1).astype(np.int64)
    column = np.minimum((direction / (2.0 * np.pi) + 0.5) * bins, bins - 1).astype(np.int64)
    return row * bins + column


@dataclass(frozen=True)
class TableSums:
    """What least squares needs of the pixels of each entry.

    Attributes:
        matrix: (bins^2, 6, 6) sums of products of two terms.
        right: (bins^2, 6, 3) sums of products of a term and a colour's change.
    """

    matrix: FloatArray
    right: FloatArray

    def table(self, ridge: float) -> Float32Array:
        """Return the coefficients (bins^2, 6, 3) of least squares with a pull to zero."""
        table: FloatArray = np.linalg.solve(self.matrix + ridge * np.eye(TERMS), self.right).astype(
            np.float64
        )
        return _fill(table, self.matrix[:, 0, 0] >= LEAST_PIXELS).astype(np.float32)


def table_sums(samples: PixelSamples, bins: int) -> TableSums:
    """Return the sums over samples for a table of so many bins each way."""
    entry = slope_bins(samples.relative, bins)
    terms = polynomial_terms(samples.position)
    size = bins * bins
    matrix = np.empty((size, TERMS, TERMS))
    right = np.empty((size, TERMS, 3))
    for i in range(TERMS):
        for j in range(i, TERMS):
            matrix[:, i, j] = np.bincount(entry, terms[:, i] * terms[:, j], size)
            matrix[:, j, i] = matrix[:, i, j]
        for colour in range(3):
            right[:, i, colour] = np.bincount(entry, terms[:, i] * samples.change[:, colour], size)
    return TableSums(matrix, right)


def _fill(table: FloatArray, filled: NDArray[np.bool_]) -> FloatArray:
    if not filled.any():
        return np.zeros_like(table)
    bins = round(np.sqrt(len(table)))
    # Directions close into a circle: three turns side by side, of which the middle one is kept.
    empty = np.tile(~filled.reshape(bins, bins), (1, 3))
    row, column = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    middle = slice(bins, 2 * bins)
    return table[(row[:, middle] * bins + column[:, middle] % bins).reshape(-1)]


@dataclass(frozen=True)
class TaximImage:
    """The fitted table.

    Attributes:
        bins: number of bins each way.
        table: (bins^2, 6, 3) coefficients of the change of each colour, full scale 1.
        name: how tables call it.
        ground: what the change is added to.
    """

    bins: int
    table: Float32Array
    name: str = "taxim"
    ground: Ground = idle_ground

    def predict(self, press: OpticalPress, rest: Rest) -> ImageArray:
        """Return images (F, H, W, 3); see `studies.optics.judge.ImageModel`."""
        grid = pixel_grid(rest)
        terms = polynomial_terms(grid.position).astype(np.float32)
        return np.stack(
            [
                self._frame(normal, grid, terms, below)
                for normal, below in zip(press.normal, self.ground(press, rest), strict=True)
            ]
        )

    def _frame(
        self, normal: Float32Array, grid: PixelGrid, terms: Float32Array, below: ImageArray
    ) -> ImageArray:
        entry = slope_bins(grid.normals(normal)[1], self.bins)
        change = np.einsum("nt,ntc->nc", terms, self.table[entry])
        return grid.changed(below, change)


def fit(
    train: Sequence[OpticalPress],
    rest: Rest,
    camera: Camera,
    *,
    seed: int = 0,
    ground: Ground = idle_ground,
) -> TaximImage:
    """Return the table with the bins and the pull that do best on presses held back from it.

    Every fourth press is held back for the choice; the table is then fitted on all.

    Args:
        train: frames to fit on.
        rest: of the gel untouched.
        camera: plays no part.
        seed: of the pixels drawn, where there are more than four millions.
        ground: what the change is added to.

    Raises:
        ValueError: no frame.
    """
    bins, ridge = PUBLISHED_BINS, CANDIDATE_RIDGES[0]
    if len(train) >= HELD_BACK:
        back = train[HELD_BACK - 1 :: HELD_BACK]
        front = [press for press in train if all(press is not other for other in back)]
        fitted = draw_pixels(front, rest, count=SAMPLES // 2, seed=seed, ground=ground)
        judged = draw_pixels(back, rest, count=SAMPLES // 4, seed=seed, ground=ground)
        errors = {}
        for count in CANDIDATE_BINS:
            sums = table_sums(fitted, count)
            for pull in CANDIDATE_RIDGES:
                errors[count, pull] = _error(sums.table(pull), judged, count)
        bins, ridge = min(errors, key=lambda candidate: errors[candidate])
    samples = draw_pixels(train, rest, count=SAMPLES, seed=seed, ground=ground)
    return TaximImage(bins, table_sums(samples, bins).table(ridge), ground=ground)


def _error(table: Float32Array, judged: PixelSamples, bins: int) -> float:
    terms = polynomial_terms(judged.position).astype(np.float32)
    change = np.einsum("nt,ntc->nc", terms, table[slope_bins(judged.relative, bins)])
    return float(np.mean((change - judged.change) ** 2))
