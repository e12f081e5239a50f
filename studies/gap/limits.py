# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Detection limits: from which size on the gap finder detects an effect.

The library's own law is added to presses in which nothing is missing, at growing sizes, until the
effect gains more than its limit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from dotsim_ros.gap.presses.answer import null_gains, screen, set_limits
from dotsim_ros.gap.presses.evidence import Segment, Variant
from dotsim_ros.gap.presses.inference import fit_nuisances, lengths
from dotsim_ros.gap.presses.screening import best_trial
from dotsim_ros.gap.presses.search_state import Ranked, Search
from dotsim_ros.io.arrays import FloatArray
from studies.gap.presses import NULL_DRAWS

HALVINGS = 7
SMALLEST = 1.0 / 128.0
"""Share of the range at which the search for a limit begins."""


def detection_limits(
    searches: Iterable[Search], variants: Sequence[Variant]
) -> dict[str, dict[str, Any]]:
    """Return by effect and end of its range the smallest size that is seen: medians of draws.

    Args:
        searches: of data in which nothing is missing.
        variants: of the effects, simulated at their sizes.
    """
    found: dict[str, dict[str, Any]] = {}
    sizes: dict[tuple[str, float], list[tuple[float, float]]] = {}
    for search in searches:
        ranked = screen(search, variants)
        gains, _ = null_gains(search, ranked, NULL_DRAWS)
        set_limits(search, ranked, gains)
        for entry in ranked:
            parameter = entry.effect.parameters[0]
            segments = search.segments(entry.variants)
            for end in (parameter.low, parameter.high):
                if end != entry.variants[0].absent:
                    key = (entry.effect.name, end)
                    sizes.setdefault(key, []).append(_smallest_seen(search, entry, segments, end))
    for (name, end), each in sizes.items():
        size, length = np.median(np.array(each), axis=0).tolist()
        seen = np.isfinite(size)
        found.setdefault(name, {})[f"towards {end:g}"] = {
            "size": float(size) if seen else None,
            "whitened_size": round(float(length), 1) if seen else None,
        }
    return found


def _smallest_seen(
    search: Search, entry: Ranked, segments: Sequence[Segment], end: float
) -> tuple[float, float]:
    """Return the smallest size towards an end of the range that is seen, and its whitened size;
    both infinite where none is. Of a shape that is free the middle one is taken."""
    variant = entry.variants[len(entry.variants) // 2]

    def size_at(share: float) -> float:
        return variant.absent + share * (end - variant.absent)

    def change_at(share: float) -> FloatArray:
        change = search.case.change_at(variant, size_at(share))
        return search.case.whitened(change, search.chosen)

    def is_seen(share: float) -> bool:
        evidence = search.evidence.without(-change_at(share))
        base = fit_nuisances(evidence).objective
        return best_trial(evidence, segments, base).gain > entry.limit

    if not is_seen(1.0):
        return np.inf, np.inf
    low, high = np.log(SMALLEST), 0.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_seen(float(np.exp(middle))) else (middle, high)
    share = float(np.exp(high))
    return size_at(share), float(lengths(search.evidence, change_at(share)[:, None])[0])
