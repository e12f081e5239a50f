"""Tries every effect of the library on the evidence, and says what chance would have given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gap.effect import FORCE, SKIN
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


def excited_variants(case: Case, candidates: Sequence[str] = ()) -> tuple[list[Variant], list[str]]:
    """Return the variants of the effects that the data excite, and the names of the others.

    Args:
        case: the data.
        candidates: names of the effects to look at; none for all.
    """
    variants, silent = [], []
    for effect in case.library.values():
        if candidates and effect.name not in candidates:
            continue
        if not ({SKIN, FORCE} & set(effect.channels)):
            continue
        if case.excited(effect):
            variants += case.variants(effect)
        else:
            silent.append(effect.name)
    return variants, silent
