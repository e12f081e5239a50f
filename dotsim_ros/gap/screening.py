"""Tries every effect of the library on the evidence, and says what chance would have given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gap.evidence import Case, Segment, Variant
from dotsim_ros.gap.inference import Evidence, Fit, fit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """The best of an effect's variants on some evidence.

    Attributes:
        variant: it.
        size: of the effect.
        gain: by how much it lowers the objective of nuisances alone.
        fit: nuisances and weights with it.
        change: (n,) whitened, what it does at that size.
    """

    variant: Variant
    size: float
    gain: float
    fit: Fit
    change: Array


def try_segment(evidence: Evidence, segment: Segment, base: float) -> Trial:
    """Return the trial of one segment.

    Args:
        evidence: to explain.
        segment: of an effect.
        base: objective of nuisances alone.
    """
    left = evidence.with_residual(evidence.residual - segment.offset)
    found = fit(left, segment.column[:, None], np.array([segment.low]), np.array([segment.high]))
    step = float(found.size[0])
    return Trial(
        segment.variant,
        segment.begin + step,
        base - found.objective,
        found,
        segment.offset + step * segment.column,
    )


def best_trial(evidence: Evidence, segments: Sequence[Segment], base: float) -> Trial:
    """Return the segment that gains most."""
    return max((try_segment(evidence, s, base) for s in segments), key=lambda trial: trial.gain)


def null_gains(
    evidence: Evidence,
    segments: Sequence[Sequence[Segment]],
    draw: Callable[[np.random.Generator], Array],
    *,
    count: int,
    seed: int,
) -> Array:
    """Return (count,) the largest gain of any effect on data without one.

    Args:
        evidence: whose nuisances are refitted each time.
        segments: of each effect.
        draw: makes a residual (n,) of data without any effect.
        count: how many.
        seed: of the draws.
    """
    random = np.random.default_rng(seed)
    gains = np.zeros(count)
    nothing = np.zeros((len(evidence.residual), 0))
    for k in range(count):
        drawn = evidence.with_residual(draw(random))
        base = fit(drawn, nothing).objective
        gains[k] = max(best_trial(drawn, group, base).gain for group in segments)
    return gains


def excited_variants(case: Case) -> tuple[list[Variant], list[str]]:
    """Return the variants of the effects that the data excite, and the names of the others."""
    variants, silent = [], []
    for effect in case.library.values():
        if not ({"skin", "force"} & set(effect.channels)):
            continue
        if case.excited(effect):
            variants += case.variants(effect)
        else:
            silent.append(effect.name)
    return variants, silent
