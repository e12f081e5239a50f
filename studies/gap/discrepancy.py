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
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.simulate import EffectRequest, open_solver
from dotsim_ros.gap.decision import MARGIN
from dotsim_ros.gap.presses.answer import null_gains, pattern_gain, screen
from dotsim_ros.gap.presses.assumptions import BIASED, DIFFERENTIAL
from dotsim_ros.gap.presses.covariance import Discrepancy, fit_discrepancy, save_discrepancy
from dotsim_ros.gap.presses.inference import fit_nuisances
from dotsim_ros.gap.presses.observables import observe, places_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.worker_pool.pool import crew
from studies.gap.presses import (
    Source,
    draw_presses,
    halves,
    open_case,
    open_presses,
    search_of,
    source_of,
)

SPLITS = 4
"""Draws of the halves."""
LIMIT_DRAWS = 15
"""Cases drawn from each half."""
NULLS_OF_DRAW = 10
QUANTILE = 0.98


def gap_discrepancy(
    *,
    data: Path = Path("data/hidden_17/commissioning"),
    sensor: str = "data/hidden_17/sensor_a.yaml",
    out: Path = Path("out/discrepancy.npz"),
    representative: bool = False,
    seed: int = 0,
    workers: int = 2,
    ray_address: str | None = None,
    cache: Path | None = None,
) -> dict[str, Any]:
    """The twin's own error, and the limits of effects, from presses without an effect.

    Args:
        data: folder of a data set without an effect.
        sensor: name or file of the sensor, calibrated to it.
        out: file for the discrepancy (.npz).
        representative: whether the presses differ as the units do that will be searched: they are
            of several, or of several meshes of a solver. Limits need no margin for that then.
        seed: of the draws.
        workers: processes, or workers of the Ray cluster, at most.
        ray_address: HOST:PORT of the head of a Ray cluster, auto or local (none).
        cache: folder of the solves (the user's cache).
    """
    source = source_of(data, sensor, cache, crew(workers, ray_address))
    names = [recording.name for recording in source.measurement.recordings]
    found = calibrated_discrepancy(source, names, seed, is_representative=representative)
    save_discrepancy(found, out)
    return {
        "file": str(out),
        "source": found.source,
        "bias": dict(found.bias),
        "limit_factors": dict(found.limit_factors),
    }


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
    residuals = residuals_by_name(source, recordings)
    found = _with_bias(source, names, covariances_of(source, recordings, residuals))
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
        half = _with_bias(source, known, covariances_of(source, of_half, residuals))
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


def residuals_by_name(source: Source, recordings: Sequence[Recording]) -> dict[str, FloatArray]:
    """Return measured minus simulated, (F, SIZE), of each recording, by name."""
    skin, values = source.measurement.skin, values_of(source.sensor)
    with open_solver(source.sensor, skin, source.run, workers=source.workers) as solver:
        answers = solver.run(
            [EffectRequest(recording, values) for recording in recordings],
            lambda done, total: source.progress("discrepancy", done, total),
        )
    found = {}
    for recording, answer in zip(recordings, answers, strict=True):
        places, press = places_of(recording, skin), recording.press
        measured, simulated = (
            observe(places, skin.rest_position_m, position_m, force_n, press.frame_count)
            for position_m, force_n in (
                (press.skin_position_m, press.force_n),
                (answer.skin_position_m, answer.force_n),
            )
        )
        found[recording.name] = measured - simulated
    return found


def covariances_of(
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
