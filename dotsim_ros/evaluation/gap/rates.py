"""Shares and medians of outcomes, as they are published."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def median(values: Sequence[float | None]) -> float | None:
    """Return the median of the values that are there, None without any."""
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 4) if known else None


def rate(outcomes: Sequence[bool]) -> dict[str, float | int | None]:
    """Return a share with Wilson's interval of 95 % (Wilson 1927)."""
    n = len(outcomes)
    if n == 0:
        return {"share": None, "low": None, "high": None, "of": 0}
    p, z = sum(outcomes) / n, 1.96
    centre = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return {
        "share": round(p, 4),
        "low": round(float(centre - half), 4),
        "high": round(float(centre + half), 4),
        "of": n,
    }
