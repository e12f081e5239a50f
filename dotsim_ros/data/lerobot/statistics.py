# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Statistics of features, by which LeRobot's policies normalise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.io.arrays import FloatArray

Statistics = dict[str, FloatArray]
"""min, max, mean, std, count and quantiles of one feature, by name."""

LONGEST_VECTOR = 4
"""A last axis that is longer is one of places."""
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


def statistics_of(values: NDArray[Any]) -> Statistics:
    """Return the statistics of a feature over the frames of an episode (F, ...).

    Those of a field (F, H, W) are one number (1, 1) of all its places, those of vectors (F, N, C)
    and (F, H, W, C) one of each entry of the vector, (1, C) and (1, 1, C).
    """
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.ndim == 1:
        numbers = numbers[:, None]
    frame_count, *shape = numbers.shape
    kept = [1] * len(shape)
    if len(shape) == 1 or shape[-1] <= LONGEST_VECTOR:
        kept[-1] = shape[-1]
    # An entry's numbers side by side: several times as fast as along the first axis.
    columns = np.ascontiguousarray(numbers.reshape(-1, kept[-1]).T)
    found = {
        "min": columns.min(axis=1),
        "max": columns.max(axis=1),
        "mean": columns.mean(axis=1),
        "std": columns.std(axis=1),
        **dict(zip(QUANTILES, np.quantile(columns, list(QUANTILES.values()), axis=1), strict=True)),
    }
    shaped = {name: level.reshape(kept) for name, level in found.items()}
    return shaped | {"count": np.array([frame_count], dtype=np.int64)}


def image_statistics(images: NDArray[np.uint8]) -> Statistics:
    """Return the statistics of the channels (C, 1, 1) of images (F, H, W, C), in shares of 255."""
    found = statistics_of(images)
    count = {"count": found.pop("count")}
    return {name: level.reshape(-1, 1, 1) / 255.0 for name, level in found.items()} | count


def merged(before: Mapping[str, Any] | None, more: Statistics) -> Statistics:
    """Return the statistics of what two describe. As LeRobot does, quantiles are averaged."""
    if before is None:
        return dict(more)
    first, second = (float(np.asarray(each["count"]).ravel()[0]) for each in (before, more))
    share = second / (first + second)
    found = {
        name: (1.0 - share) * np.asarray(before[name]) + share * more[name]
        for name in ("mean", *QUANTILES)
    }
    square = sum(
        part * (np.asarray(each["std"]) ** 2 + (np.asarray(each["mean"]) - found["mean"]) ** 2)
        for part, each in ((1.0 - share, before), (share, more))
    )
    return found | {
        "min": np.minimum(before["min"], more["min"]),
        "max": np.maximum(before["max"], more["max"]),
        "std": np.sqrt(square),
        "count": np.array([int(first + second)], dtype=np.int64),
    }
