# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Delays of a simulated world, drawn from a measured distribution. Needs no ROS."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

LONGEST_S = 2.0


def check_quantiles(name: str, quantiles_s: Sequence[float]) -> None:
    """Check a distribution as `Latency` takes it.

    Raises:
        ValueError: a delay that is negative, too long, not a number, or less than the one before.
    """
    values = np.asarray(quantiles_s, dtype=np.float64)
    if values.size == 0:
        raise ValueError(f"{name} is empty, expected one delay, or the quantiles of its spread")
    if not (np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= LONGEST_S):
        raise ValueError(
            f"{name} is {[float(f'{value:g}') for value in values]}, expected delays from 0 to "
            f"{LONGEST_S:g} s"
        )
    if (np.diff(values) < 0.0).any():
        raise ValueError(
            f"{name} falls from one quantile to the next, expected the delays in rising order"
        )


class Latency:
    """Draws delays, the same ones for the same seed.

    Args:
        quantiles_s: of the delay, evenly spaced from the smallest to the largest; between two of
            them every delay is equally likely. One number: that delay, always.

    Raises:
        ValueError: see `check_quantiles`.
    """

    def __init__(self, quantiles_s: Sequence[float], *, seed: int) -> None:
        check_quantiles("a latency", quantiles_s)
        self._quantiles_s = np.asarray(quantiles_s, dtype=np.float64)
        self._shares = np.linspace(0.0, 1.0, len(self._quantiles_s))
        self._random = np.random.default_rng(seed)

    def draw_s(self) -> float:
        """Return the next delay."""
        return float(np.interp(self._random.random(), self._shares, self._quantiles_s))
