# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shares and medians of outcomes, as they are published."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np


def median(values: Sequence[float | None]) -> float | None:
    """Return the median of the values that are there, None without any."""
    known = [value for value in values if value is not None]
    return round(float(np.median(known)), 4) if known else None


def rate(outcomes: Sequence[bool]) -> dict[str, float | int | None]:
    """Return a share with Wilson's interval of 95 % (Wilson 1927); the cases are independent."""
    n = len(outcomes)
    return _with_interval(sum(outcomes), n, float(n))


def clustered_rate(
    outcomes: Sequence[bool], members: Sequence[Collection[str]]
) -> dict[str, float | int | None]:
    """Return a share of cases that share their members, with an interval of 95 % by members.

    The variance is the jackknife's over members: what the share changes by when all cases that
    hold a member are left out (Arvesen 1969, on U-statistics). Wilson's interval is that of so many
    independent cases as have this variance; where all outcomes are the same, of as many as there
    are draws without a common member.

    Args:
        outcomes: of the cases.
        members: of each case.
    """
    n = len(outcomes)
    everything = sorted({name for case in members for name in case})
    if not everything:
        return rate(outcomes)
    share = sum(outcomes) / n
    disjoint = len(everything) / (sum(len(case) for case in members) / n)
    left = [
        np.mean(kept)
        for name in everything
        if (kept := [o for o, case in zip(outcomes, members, strict=True) if name not in case])
    ]
    count = len(left)
    variance = (
        (count - 1) / count * float(np.sum((np.array(left) - np.mean(left)) ** 2)) if left else 0.0
    )
    spread = share * (1.0 - share)
    independent = disjoint if spread == 0.0 or variance == 0.0 else spread / variance
    return _with_interval(sum(outcomes), n, min(float(n), independent))


def _with_interval(right: int, n: int, independent: float) -> dict[str, float | int | None]:
    if n == 0:
        return {"share": None, "low": None, "high": None, "of": 0}
    p, z, size = right / n, 1.96, independent
    centre = (p + z * z / (2 * size)) / (1 + z * z / size)
    half = z * np.sqrt(p * (1 - p) / size + z * z / (4 * size * size)) / (1 + z * z / size)
    return {
        "share": round(p, 4),
        "low": round(float(centre - half), 4),
        "high": round(float(centre + half), 4),
        "of": n,
    }
