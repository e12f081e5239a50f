# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The Bayesian bootstrap over trajectories (Rubin 1981).

Drawing with replacement leaves out a given one of n trajectories in (1 - 1/n)^n of the draws, a
third: a name that rests on the only slide would be called unstable however clear that slide is, and
its interval would reach to the end of the range. Here each trajectory counts more or less, but
counts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

import numpy as np

from dotsim_ros.io.arrays import FloatArray

BOOTSTRAPS = 100
"""Draws behind an interval or a stability: a share of them is known to 5 %."""


Contest = tuple[Callable[[FloatArray], str | None], Collection[str]]
"""What returns the name that comes first where trajectories count so much (T,), None for none; and
the names that are the same answer."""


def stability(contests: Iterable[Contest], repetitions: FloatArray) -> float:
    """Return the share of repetitions (draws, T) that give the same answer in all contests: one of
    each effect that is named, next to the others."""
    same = np.ones(len(repetitions), dtype=bool)
    for winner, accepted in contests:
        same &= [winner(counts) in accepted for counts in repetitions]
    return float(same.mean())


def bootstrap_weights(count: int, draws: int, random: np.random.Generator) -> FloatArray:
    """Return (draws, count) how much each of `count` trajectories counts in each draw: uniform on
    all shares, and 1 on average."""
    return np.asarray(count * random.dirichlet(np.ones(count), size=draws))
