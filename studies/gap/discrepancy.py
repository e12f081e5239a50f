# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the gap finder knows of presses in which nothing is missing: how far model and measurement
are apart, what the twin is off by, and how much effects gain by it.

All of it comes from the presses that are named, and from no other. How much effects gain is
cross-fitted: one half of the presses gives the covariances and the bias, the other half shows what
effects gain next to them, and the other way round, for several draws of the halves: the limit of
latency from one draw alone was twice that from another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dotsim_ros.data.recording import Recording
from dotsim_ros.gap.decision import MARGIN
from dotsim_ros.gap.presses.answer import null_gains, pattern_gain, screen
from dotsim_ros.gap.presses.assumptions import BIASED, DIFFERENTIAL
from dotsim_ros.gap.presses.covariance import Discrepancy, fit_discrepancy
from dotsim_ros.gap.presses.inference import fit_nuisances
from dotsim_ros.io.arrays import FloatArray
from studies.gap.null import residuals_without_effect
from studies.gap.presses import (
    Source,
    draw_presses,
    halves,
    open_case,
    open_presses,
    search_of,
)

SPLITS = 4
"""Draws of the halves."""
LIMIT_DRAWS = 15
"""Cases drawn from each half."""
NULLS_OF_DRAW = 10
QUANTILE = 0.98


def calibrated_discrepancy(
    source: Source, names: Sequence[str], seed: int, *, is_representative: bool = False
) -> Discrepancy:
    """Return the discrepancy that some presses show.

    Args:
        source: of the presses.
        names: of those to use; such as cannot be read are left out, as the source's warnings say.
        seed: of the draws.
        is_representative: whether they show how the units differ that will be searched.
    """
    recordings = [r for r in source.measurement.recordings if r.name in names]
    names = [r.name for r in recordings]
    residuals = _residuals(source, recordings)
    found = _with_bias(source, names, _covariances(source, recordings, residuals))
    gains: dict[str, list[float]] = {}
    simulated: list[float] = []
    patterns: list[float] = []
    simulated_patterns: list[float] = []
    misfits: list[float] = []
    random = np.random.default_rng([seed, 2])
    drawn = [halves(names, int(random.integers(2**31))) for _ in range(SPLITS)]
    both_ways = [way for one, other in drawn for way in ((one, other), (other, one))]
    for number, (known, shown) in enumerate(both_ways):
        of_half = [r for r in recordings if r.name in known]
        half = _with_bias(source, known, _covariances(source, of_half, residuals))
        with open_presses(source, shown, half) as presses:
            for draw in range(LIMIT_DRAWS):
                chosen = draw_presses(len(presses.case.trajectories), random)
                search = search_of(presses.case, chosen, source.request(seed), draw, half)
                ranked = screen(search, presses.variants)
                misfits.append(search.base.objective / len(search.evidence.residual))
                for entry in ranked:
                    gains.setdefault(entry.effect.name, []).append(entry.trial.gain)
                patterns.append(pattern_gain(search))
                by_effects, by_patterns = null_gains(search, ranked, NULLS_OF_DRAW)
                simulated += by_effects.tolist()
                simulated_patterns += by_patterns.tolist()
                done = number * LIMIT_DRAWS + draw + 1
                source.progress("limits", done, len(both_ways) * LIMIT_DRAWS)
    threshold = float(np.quantile(simulated, QUANTILE))
    factors = {
        name: round(MARGIN * max(0.0, float(np.quantile(each, QUANTILE))) / threshold, 2)
        for name, each in sorted(gains.items())
    }
    by_patterns_alone = [np.quantile(each, QUANTILE) for each in (patterns, simulated_patterns)]
    return replace(
        found,
        limit_factors=factors,
        pattern_factor=round(MARGIN * float(by_patterns_alone[0] / by_patterns_alone[1]), 2),
        misfit_limit=round(float(np.quantile(misfits, QUANTILE)), 4),
        is_representative=is_representative,
    )


def _residuals(source: Source, recordings: Sequence[Recording]) -> dict[str, FloatArray]:
    """Return what the twin leaves of each recording, (F, SIZE), by name."""
    each = residuals_without_effect(
        replace(source.measurement, recordings=tuple(recordings)),
        source.sensor,
        source.run,
        workers=source.workers,
        progress=lambda done, total: source.progress("discrepancy", done, total),
    )
    return {r.name: residual for r, residual in zip(recordings, each, strict=True)}


def _covariances(
    source: Source, recordings: Sequence[Recording], residuals: Mapping[str, FloatArray]
) -> Discrepancy:
    text = f"{len(recordings)} presses of {source.directory.name} with {source.sensor.name}"
    return fit_discrepancy(recordings, [residuals[r.name] for r in recordings], text)


def _with_bias(source: Source, names: Sequence[str], discrepancy: Discrepancy) -> Discrepancy:
    """Return covariances with the most probable bias beside them; its prior is the wide one of data
    that have a commissioning."""
    with open_case(source, names, discrepancy, DIFFERENTIAL) as (case, _, _):
        evidence = case.evidence(range(len(case.trajectories)))
        moved = fit_nuisances(evidence).nuisance.tolist()
        columns = case.columns()
    bias = {
        nuisance.name: float(f"{deviations * nuisance.deviation:.3g}")
        for (nuisance, *_), deviations in zip(columns, moved, strict=True)
        if nuisance.name in BIASED
    }
    return replace(discrepancy, bias=bias)
