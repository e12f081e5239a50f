# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From an answer to findings: what is left, where, and what the effects close (steps 4 and 9)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dotsim_ros.calibration.parameters import PARAMETERS
from dotsim_ros.data.measurement import Measurement
from dotsim_ros.effects.effect import Active
from dotsim_ros.effects.overlay import Estimate, FoundEffect, Overlay
from dotsim_ros.effects.simulate import request_of
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Candidate, ChannelGap, Findings, Verdict, candidate_of
from dotsim_ros.gap.presses.answer import (
    Decision,
    SearchAnswer,
    size_beyond_range,
    sizes_by_channel,
)
from dotsim_ros.gap.presses.assumptions import GEL_CONSTANTS, values_after
from dotsim_ros.gap.presses.certainty import close_pairs
from dotsim_ros.gap.presses.evidence import Case
from dotsim_ros.gap.presses.inference import Fit, fit_nuisances
from dotsim_ros.gap.presses.locate import (
    Closed,
    Residuals,
    channel_gaps,
    places_of_gap,
    residuals_of,
    share_closed,
    worst_frame,
)
from dotsim_ros.gap.presses.made_up import made_up
from dotsim_ros.gap.presses.search_state import PATTERN_DEVIATION, Ranked, Search
from dotsim_ros.gap.report import wording
from dotsim_ros.gel.values import GelValues
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.twin.follow import SolveError


def findings_of(
    search: Search,
    measurement: Measurement,
    reference: Measurement | None,
    *,
    answer: SearchAnswer,
    silent: Sequence[str],
) -> tuple[Findings, Overlay | None]:
    case, request = search.case, search.request
    measured = [k for k, t in enumerate(case.trajectories) if not t.is_reference]
    judged = search.held_out or measured
    decided, ranked = answer.decision, answer.ranked
    residuals, refitted = _with_effects(search, decided.named)
    closed: Closed | None = None
    left_open: float | None = None
    nearest = ranked[:1]
    if decided.named:
        closed = share_closed(residuals, judged, search.random)
        if closed is None:
            search.warnings.append("the held-out trajectories show no gap that could be closed")
        elif search.held_out and leaves_open(closed):
            # What explains the searched trajectories alone is no explanation.
            left_open, closed = closed.share, None
            nearest = list(decided.named)
            decided = Decision(Verdict.UNKNOWN)
            residuals, refitted = _with_effects(search, [])
    named, verdict = decided.named, decided.verdict
    doubt, stability = decided.doubt, decided.stability
    told = [(entry.effect, entry.estimates) for entry in named]
    search.warnings += wording.certainty_warnings("", stability if named else None, told)
    worst = worst_frame(
        case,
        residuals,
        measured,
        lambda number: _skins(search, number, named),
        measurement.skin.rest_position_m,
    )
    shared = case.shared_nuisances()
    fallback: tuple[ChannelGap, ...] = ()
    is_unknown = verdict is Verdict.UNKNOWN
    alone = len(nearest) == 1
    if is_unknown:
        fallback = channel_gaps(_fallback(search), judged)
    fitted = values_after(case.values, shared, refitted.nuisance[: len(shared)])
    gaps = channel_gaps(residuals, judged)
    places = places_of_gap(case, residuals, measured, search.random)
    beyond = size_beyond_range(search, nearest[0]) if is_unknown and alone else None
    facts = wording.Facts(
        named=told,
        alternatives=[e.effect for e in decided.alternatives],
        gaps=gaps,
        nearest=[e.effect for e in nearest],
        sizes=sizes_by_channel(search, nearest[0]) if is_unknown and alone else None,
        beyond=None if beyond is None else (nearest[0].effect.parameters[0], beyond),
        left_open=left_open,
        doubted=""
        if doubt is None
        else wording.amid_all([e.effect for e in doubt.effects], are_two=doubt.are_two),
        stability=stability,
        place=wording.largest_place(places),
        is_held_out=bool(search.held_out),
        made_up=made_up(search, gaps) if verdict is Verdict.NO_GAP else None,
    )
    findings = Findings(
        verdict=verdict,
        sentence=wording.sentence(verdict, facts),
        named=tuple(e.effect.name for e in named),
        alternatives=tuple(e.effect.name for e in decided.alternatives),
        statistic=answer.statistic,
        threshold=answer.threshold,
        alpha=request.alpha,
        p_value=answer.p_value,
        mode="absolute" if reference is None else "differential",
        candidates=_candidates(search, ranked, silent),
        calibrated=_calibrated(case, fitted, refitted),
        places=places,
        gaps=gaps,
        share_closed=None if closed is None else closed.share,
        share_closed_low=None if closed is None else closed.low,
        share_closed_high=None if closed is None else closed.high,
        fallback=fallback,
        stability=stability,
        pairs=close_pairs(search, ranked),
        worst=worst,
        warnings=tuple(search.warnings),
        trajectories=tuple(case.trajectories[k].recording.name for k in search.chosen),
        locked=tuple(case.trajectories[k].recording.name for k in search.held_out),
        data_hash=measurement.digest,
        sensor=request.sensor.name,
    )
    if verdict not in (Verdict.NAMED, Verdict.SET):
        return findings, None
    overlay = Overlay(
        request.sensor.name,
        measurement.digest,
        tuple(FoundEffect(e.effect.name, e.estimates) for e in named),
    )
    return findings, overlay


def leaves_open(closed: Closed) -> bool:
    """Return whether named effects leave a clear gap of the held-out trajectories open."""
    is_clear = (
        closed.before >= decision.FAR
        and closed.high is not None
        and closed.high < 1.0
        and closed.trajectories >= decision.TRAJECTORIES_OFF
    )
    return is_clear and closed.share < decision.LEAST_CLOSED


def _with_effects(search: Search, named: Sequence[Ranked]) -> tuple[Residuals, Fit]:
    """Return what effects leave, and the nuisances next to them."""
    change = change_by_trajectory(search, named)
    refitted = fit_nuisances(search.evidence.without(search.case.whitened(change, search.chosen)))
    residuals = residuals_of(
        search.case,
        recalibrated=search.base.nuisance,
        refitted=refitted.nuisance,
        change=change,
        noise=search.noise,
        discrepancy=search.discrepancy,
    )
    return residuals, refitted


def change_by_trajectory(search: Search, entries: Sequence[Ranked]) -> list[FloatArray]:
    """Return (F, SIZE) of each trajectory by effects at the sizes found."""
    total = [np.zeros_like(t.predicted) for t in search.case.trajectories]
    for entry in entries:
        change, failures = search.case.change_everywhere(entry.trial.variant, entry.trial.size)
        search.warnings += [f"an effect could not be simulated: {text}" for text in failures]
        total = [before + part for before, part in zip(total, change, strict=True)]
    return total


def _fallback(search: Search) -> Residuals:
    """Return what patterns leave when they stand in for an effect: a Gaussian process with the
    patterns as its functions, fitted next to the nuisances."""
    widened = search.evidence.with_nuisances(search.pattern_columns)
    found = fit_nuisances(widened).nuisance
    count = search.evidence.nuisance.shape[1]
    return residuals_of(
        search.case,
        recalibrated=search.base.nuisance,
        refitted=found[:count],
        change=search.case.pattern_change(PATTERN_DEVIATION * found[count:]),
        noise=search.noise,
        discrepancy=search.discrepancy,
    )


def _calibrated(case: Case, fitted: GelValues, refitted: Fit) -> tuple[Estimate, ...]:
    """Return the nuisances as fitted; the range is that of their priors."""
    result = []
    for (nuisance, _), name, moved in zip(
        case.columns(), case.column_names(), refitted.nuisance.tolist(), strict=True
    ):
        reach = 1.96 * nuisance.deviation
        if nuisance.name in GEL_CONSTANTS:
            parameter = PARAMETERS[nuisance.name]
            at = parameter.to_coordinate(getattr(case.values, parameter.field)) + nuisance.mean
            ends = sorted(parameter.to_value(at + side * reach) for side in (-1.0, 1.0))
            value = float(getattr(fitted, parameter.field))
            result.append(Estimate(name, parameter.unit, value, ends[0], ends[1]))
        else:
            value = nuisance.mean + moved * nuisance.deviation
            ends = [nuisance.mean + side * reach for side in (-1.0, 1.0)]
            result.append(Estimate(name, nuisance.unit, value, ends[0], ends[1]))
    return tuple(result)


def _skins(
    search: Search, number: int, named: Sequence[Ranked]
) -> tuple[FloatArray, FloatArray] | None:
    """Return the skins (F, V, 3) of a trajectory without and with the effects, None where the gel
    could not be solved."""
    recording = search.case.trajectories[number].recording
    effects = [
        Active(e.effect, e.effect.checked(e.trial.variant.values(e.trial.size))) for e in named
    ]
    requests = [request_of(recording, search.case.values, effects=e) for e in ((), effects)]
    try:
        without, with_effects = search.case.solver.run(requests)
    except SolveError as error:
        search.warnings.append(f"no image of {recording.name}: {error}")
        return None
    return without.skin_position_m, with_effects.skin_position_m


def _candidates(
    search: Search, ranked: Sequence[Ranked], silent: Sequence[str]
) -> tuple[Candidate, ...]:
    result = [
        Candidate(
            e.effect.name,
            e.effect.title,
            True,
            e.trial.gain,
            e.trial.size,
            e.explained,
            e.held_out_gain,
            e.estimates,
            e.limit,
        )
        for e in ranked
    ]
    return (*result, *(candidate_of(search.case.library[name]) for name in silent))
