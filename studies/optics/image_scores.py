# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scores of a predicted image against the measured one, over regions of it.

Colours are taken as shares of the full scale, 0 to 1. The error of a pixel is the length of the
difference of its red, green and blue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.io.arrays import BoolArray, FloatArray, ImageArray
from dotsim_ros.twin.image_metrics import FULL_SCALE, psnr_db

SIGNIFICANT_SHARE = 0.01
"""Share of the pixels, the worst predicted, that the significant error is the mean over."""
SSIM_SIGMA_PX = 1.5
"""Width of the Gaussian window of SSIM, as published."""


@dataclass(frozen=True)
class ImageScore:
    """How one predicted frame differs from the measured one, over one region of it.

    Attributes:
        psnr_db: 10 log10 of 1 over the mean squared error of all channels.
        mean_l2: mean error of a pixel.
        significant_l2: mean error of the worst hundredth of the pixels, one at least.
        ssim: mean structural similarity of the channels (Wang, Bovik, Sheikh, Simoncelli, "Image
            quality assessment: from error visibility to structural similarity", IEEE Transactions
            on Image Processing 13(4), 2004).
    """

    psnr_db: float
    mean_l2: float
    significant_l2: float
    ssim: float


def ssim_map(predicted: ImageArray, measured: ImageArray) -> FloatArray:
    """Return (H, W) structural similarity around each pixel, the mean of its channels.

    Gaussian windows, constants 0.01 and 0.03, biased variances, as published.

    Args:
        predicted, measured: (H, W, 3) uint8.

    Raises:
        ValueError: an image smaller than the window.
    """
    # Loaded on use: it takes half a second, and only scores need it.
    from skimage.metrics import structural_similarity

    _, similarity = structural_similarity(
        predicted,
        measured,
        channel_axis=2,
        data_range=FULL_SCALE,
        gaussian_weights=True,
        sigma=SSIM_SIGMA_PX,
        use_sample_covariance=False,
        full=True,
    )
    return np.asarray(similarity.mean(axis=2), dtype=np.float64)


def score_image(
    predicted: ImageArray, measured: ImageArray, regions: dict[str, BoolArray | None]
) -> dict[str, ImageScore]:
    """Return the scores of one frame over each region.

    Args:
        predicted, measured: (H, W, 3) uint8.
        regions: (H, W) by name; None for the whole frame. SSIM's windows reach beyond a region.

    Raises:
        ValueError: an image or a region of another shape, or a region without a pixel.
    """
    for image in (predicted, measured):
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape != measured.shape:
            raise ValueError(
                f"images have shapes {predicted.shape} and {measured.shape} and types "
                f"{predicted.dtype} and {measured.dtype}, expected (H, W, 3) uint8 both"
            )
    difference = (predicted.astype(np.float64) - measured) / FULL_SCALE
    square = np.sum(difference**2, axis=2)
    similarity = ssim_map(predicted, measured)
    scores = {}
    for name, region in regions.items():
        inside = np.ones(square.shape, dtype=np.bool_) if region is None else region
        if inside.shape != square.shape or not inside.any():
            raise ValueError(
                f"region {name!r} has shape {inside.shape} and {int(inside.sum())} pixels, "
                f"expected {square.shape} and one pixel at least"
            )
        scores[name] = _score(square[inside], similarity[inside])
    return scores


def _score(square: FloatArray, similarity: FloatArray) -> ImageScore:
    error = np.sqrt(square)
    worst = max(1, round(SIGNIFICANT_SHARE * len(error)))
    return ImageScore(
        psnr_db=psnr_db(float(square.mean()) / 3.0),
        mean_l2=float(error.mean()),
        significant_l2=float(np.partition(error, -worst)[-worst:].mean()),
        ssim=float(similarity.mean()),
    )
