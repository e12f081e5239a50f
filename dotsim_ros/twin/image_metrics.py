# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The peak signal-to-noise ratio of a predicted image, and the depths that group frames.

Colours are taken as shares of the full scale, 0 to 1. A table's PSNR is the mean of its frames', as
an image is judged, and not the PSNR of the mean error, which its worst frames rule.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dotsim_ros.io.arrays import ImageArray

DEPTH_EDGES_M = (0.0, 1.0e-3, 2.0e-3, 3.0e-3)
"""Depths of the tip that divide frames into groups."""
FULL_SCALE = 255.0
LARGEST_PSNR_DB = 100.0
"""PSNR given to an image without any error, whose ratio is infinite."""


def psnr_db(mean_squared_error: float) -> float:
    """Return the peak signal-to-noise ratio of a mean squared error (colours 0 to 1)."""
    if mean_squared_error <= 0.0:
        return LARGEST_PSNR_DB
    return min(float(-10.0 * np.log10(mean_squared_error)), LARGEST_PSNR_DB)


def image_psnr_db(predicted: ImageArray, measured: ImageArray) -> float:
    """Return the peak signal-to-noise ratio of images, or of chosen pixels, of one shape."""
    error = (predicted.astype(np.float64) - measured) / FULL_SCALE
    return psnr_db(float(np.mean(error**2)))


def depth_ranges() -> list[tuple[str, float, float]]:
    """Return name, least and greatest depth (m) of the ranges that group the frames."""
    edges = (-np.inf, *DEPTH_EDGES_M, np.inf)
    names = ["untouched"]
    names += [f"{1e3 * low:g} to {1e3 * high:g} mm" for low, high in pairwise(DEPTH_EDGES_M)]
    names.append(f"from {1e3 * DEPTH_EDGES_M[-1]:g} mm")
    return [(name, low, high) for name, (low, high) in zip(names, pairwise(edges), strict=True)]
