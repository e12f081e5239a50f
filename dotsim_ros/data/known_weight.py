# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a force gauge reads of known weights: its scale, without any gel.

The bag of a weight holds the wrench alone: some frames without the weight and some with it, resting
where the gauge carries it. Magnitudes are compared, so neither frame nor direction matters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.data_set import WeightEntry
from dotsim_ros.data.trajectory import MEASURED_TOPICS, read_trajectory
from dotsim_ros.io.arrays import FloatArray

LEAST_FRAMES = 5
"""Frames under the weight that a reading takes."""
BESIDE = 0.2
"""A frame whose force differs from the largest, or from the smallest, by less than this share of
their difference is one with the weight, or one without it; the others are of its being set down."""
LARGEST_SCALE = 10.0
"""A reading that is larger than this many times the weight, or as much smaller, is of no weight."""


@dataclass(frozen=True)
class ForceScale:
    """What a gauge reads over what it carries, 1 where it is right, by the weights of some bags."""

    scale: float
    deviation: float
    names: tuple[str, ...]

    def over(self, other: ForceScale) -> ForceScale:
        """Return this scale over another."""
        ratio = self.scale / other.scale
        share = np.hypot(self.deviation / self.scale, other.deviation / other.scale)
        return ForceScale(ratio, ratio * float(share), self.names + other.names)


def read_weight(entry: WeightEntry) -> ForceScale:
    """Return the scale of a gauge by one weight.

    Raises:
        ValueError: no bag with forces, too few frames, or a reading that is of no weight.
    """
    wrench = read_trajectory(entry.bag, channels=("wrench",)).wrench
    if wrench is None or not np.all(np.isfinite(wrench.force_n)):
        raise ValueError(
            f"{entry.name}: no force, or one that is not finite, in {MEASURED_TOPICS.wrench}"
        )
    reading_n, error_n, count = _reading(wrench.force_n)
    if count < LEAST_FRAMES:
        raise ValueError(
            f"{entry.name}: {count} frames under the weight, expected {LEAST_FRAMES} at least; let "
            "it rest on the gauge for some seconds"
        )
    scale = reading_n / entry.known_force_n
    if not 1.0 / LARGEST_SCALE < scale < LARGEST_SCALE:
        raise ValueError(
            f"{entry.name}: the gauge reads {reading_n:.3g} N of a weight of "
            f"{entry.known_force_n:.3g} N; check mass_kg, which is in kilograms, and that the "
            "weight rests on the gauge"
        )
    deviation = float(np.hypot(error_n / entry.known_force_n, scale * entry.tolerance))
    return ForceScale(scale, deviation, (entry.name,))


def combined_scale(scales: Sequence[ForceScale]) -> ForceScale:
    """Return the scale that several weights agree on, their mean by their variances.

    Where they differ by more than their deviations allow, its own is as much larger (Birge, "The
    calculation of errors by the method of least squares", Physical Review 40, 1932).
    """
    scale = np.array([one.scale for one in scales])
    weight = np.array([one.deviation for one in scales]) ** -2.0
    mean = float(np.average(scale, weights=weight))
    square = float(weight @ (scale - mean) ** 2)
    birge = max(1.0, square / max(len(scales) - 1, 1))
    names = tuple(name for one in scales for name in one.names)
    return ForceScale(mean, float(np.sqrt(birge / weight.sum())), names)


def _reading(force_n: FloatArray) -> tuple[float, float, int]:
    """Return what a weight adds to forces (N, 3), one deviation of it, and of how many frames."""
    size = np.linalg.norm(force_n, axis=1)
    least, most = float(size.min()), float(size.max())
    loaded = force_n[size >= most - BESIDE * (most - least)]
    free = force_n[size <= least + BESIDE * (most - least)]
    if least > 0.5 * most:
        # The weight rests all the time, on a gauge that was tared without it.
        loaded, free = force_n, np.zeros((1, 3))
    # Medians: the last frames of its being set down are among them.
    added = np.median(loaded, axis=0) - np.median(free, axis=0)
    reading = float(np.linalg.norm(added))
    along = added / max(reading, 1e-12)
    variance = sum(_variance_of_median(part @ along) for part in (loaded, free))
    return reading, float(np.sqrt(variance)), len(loaded)


def _variance_of_median(values: FloatArray) -> float:
    """Return the variance of the median of normal values, their own by the median deviation."""
    deviation = 1.4826 * float(np.median(np.abs(values - np.median(values))))
    return 0.5 * np.pi * deviation**2 / len(values)
