# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How well the gap finder measures an effect whose law the library has: its own, added to presses
in which nothing is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from dotsim_ros.gap.presses.answer import answer_of, null_gains, screen
from dotsim_ros.gap.presses.certainty import estimates_of
from dotsim_ros.gap.presses.evidence import Variant
from dotsim_ros.gap.presses.inference import lengths
from studies.gap.presses import (
    NULL_DRAWS,
    Presses,
    Source,
    draw_presses,
    search_of,
)
from studies.gap.rates import median, rate

SHARES = (0.4, 0.6, 0.8)
"""Sizes that are hidden, as shares of the way from none to each end of an effect's range."""


@dataclass(frozen=True)
class SameLaw:
    """An effect of the library, hidden, and what was found.

    Attributes:
        effect: its name.
        size: of its first parameter.
        whitened_size: nuisances projected out.
        named: what the finder names.
        value, low, high: the size found and its interval, where the effect alone was named.
    """

    effect: str
    size: float
    whitened_size: float
    named: tuple[str, ...]
    value: float | None = None
    low: float | None = None
    high: float | None = None


def same_law_cases(presses: Presses, source: Source, random: np.random.Generator) -> list[SameLaw]:
    """Return what is found of every effect at some sizes."""
    variants = {variant.effect.name: variant for variant in presses.variants}
    planned: list[tuple[Variant, float]] = []
    for variant in variants.values():
        parameter = variant.effect.parameters[0]
        for end in (parameter.low, parameter.high):
            if end != variant.absent:
                away = end - variant.absent
                planned += [(variant, variant.absent + share * away) for share in SHARES]
    result = []
    for number, (variant, size) in enumerate(planned):
        result.append(_measured(presses, source, variant, size, random))
        source.progress("same law", number + 1, len(planned))
    return result


def _measured(
    presses: Presses, source: Source, variant: Variant, size: float, random: np.random.Generator
) -> SameLaw:
    case = presses.case
    hidden, _ = case.change_everywhere(variant, size)
    trajectories = [
        replace(t, observed=t.observed + change)
        for t, change in zip(case.trajectories, hidden, strict=True)
    ]
    altered = replace(case, trajectories=trajectories)
    chosen = draw_presses(len(case.trajectories), random)
    draw = int(random.integers(2**31))
    search = search_of(altered, chosen, source.request(draw), draw, presses.discrepancy)
    ranked = screen(search, presses.variants)
    answer = answer_of(search, ranked, *null_gains(search, ranked, NULL_DRAWS))
    name = variant.effect.name
    whitened = float(lengths(search.evidence, altered.whitened(hidden, chosen)[:, None])[0])
    named = tuple(entry.effect.name for entry in answer.decision.named)
    if named != (name,):
        return SameLaw(name, size, whitened, named)
    found = estimates_of(search, answer.decision.named[0], [])[0]
    return SameLaw(name, size, whitened, named, found.value, found.low, found.high)


def same_law_figures(cases: Sequence[SameLaw]) -> dict[str, Any]:
    """Return what is published: errors and intervals where the effect alone was named."""
    measured = [c for c in cases if c.value is not None]
    return {
        "named_alone_from_10": rate([c.value is not None for c in cases if c.whitened_size >= 10]),
        "median_relative_error": median([abs((c.value or 0.0) / c.size - 1.0) for c in measured]),
        "interval_covers": rate([_covers(c) for c in measured]),
        "cases": [asdict(c) for c in cases],
    }


def _covers(case: SameLaw) -> bool:
    return case.low is not None and case.high is not None and case.low <= case.size <= case.high
