# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From an answer to findings: what is left, where, and what the effects close (steps 4 and 9)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dotsim_ros.calibration.parameters import PARAMETERS
from dotsim_ros.data.measurement import Measurement
from dotsim_ros.effects.effect import Active, Effect
from dotsim_ros.effects.overlay import Estimate, FoundEffect, Overlay
from dotsim_ros.effects.simulate import EffectRequest
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Candidate, ChannelGap, Findings, Verdict, candidate_of
from dotsim_ros.gap.presses.answer import (
    Decision,
    SearchAnswer,
    decide,
    pair_instead,
    size_beyond_range,
    sizes_by_channel,
    tried_again,
)
from dotsim_ros.gap.presses.assumptions import GEL_CONSTANTS
from dotsim_ros.gap.presses.certainty import close_pairs, estimates_of
from dotsim_ros.gap.presses.evidence import Case
from dotsim_ros.gap.presses.inference import Fit, fit_nuisances
from dotsim_ros.gap.presses.locate import (
    Closed,
    Residuals,
    channel_gaps,
    frame_of,
    places_of_gap,
    residuals_of,
    share_closed,
    with_effects,
    worst_place,
)
from dotsim_ros.gap.presses.made_up import no_gap_sentence
from dotsim_ros.gap.presses.search_state import PATTERN_DEVIATION, Ranked, Search
from dotsim_ros.gap.presses.shear import shear_gaps
from dotsim_ros.gap.report import wording
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.twin.follow import SolveError


def findings_of(
    search: Search,
    measurement: Measurement,
    reference: Measurement | None,
    answer: SearchAnswer,
    silent: Sequence[str],
) -> tuple[Findings, Overlay | None]:
    """Return what was found, and the overlay if an effect was named; the effects of the names in
    `silent` are those that the data do not excite."""
    case, request = search.case, search.request
    measured = [k for k, t in enumerate(case.trajectories) if not t.is_reference]
    judged = search.held_out or measured
    ranked = answer.ranked
    decided, left_open = _confirmed(search, ranked, answer.decision)
    named, verdict = decided.named, decided.verdict
    nearest = ranked[:1] if left_open is None else answer.decision.named
    for entry in named:
        others = [other for other in named if other is not entry]
        entry.estimates = estimates_of(search, entry, others)
    residuals, refitted = with_effects(search, named)
    closed = share_closed(residuals, judged, search.random) if named else None
    if named and closed is None:
        search.warnings.append("the held-out trajectories show no gap that could be closed")
    if verdict is not Verdict.NO_GAP:
        search.warnings += _hinges(search, ranked, decided)
    estimated = [(entry.effect, entry.estimates) for entry in named]
    search.warnings += wording.certainty_warnings(
        "", decided.stability if named else None, estimated
    )
    place, worst = worst_place(residuals, measured), None
    if place is not None:
        worst = frame_of(case, residuals, *place, _skins(search, place[0], named))
    fallback: tuple[ChannelGap, ...] = ()
    if verdict is Verdict.UNKNOWN:
        fallback = channel_gaps(_fallback(search), judged)
    gaps = channel_gaps(residuals, judged)
    places = places_of_gap(case, residuals, measured, search.random)
    where = wording.largest_place(places)
    if verdict is Verdict.NO_GAP:
        sentence = no_gap_sentence(search, gaps)
    elif decided.doubted:
        sentence = wording.not_decided(
            [e.effect for e in decided.doubted],
            are_two=decided.are_two,
            stability=decided.stability or 0.0,
            place=where,
        )
    elif verdict is Verdict.UNKNOWN:
        reasons = _reasons(search, nearest, left_open)
        sentence = wording.unknown(where, [e.effect for e in nearest], reasons)
    else:
        alternatives = [e.effect for e in decided.alternatives]
        sentence = wording.missing(estimated, alternatives, gaps, is_held_out=bool(search.held_out))
        for entry in named:
            usual = case.library[entry.effect.name]
            sentence += wording.beyond_usual(usual, entry.trial.size)
    findings = Findings(
        verdict=verdict,
        sentence=sentence,
        named=tuple(e.effect.name for e in named),
        alternatives=tuple(e.effect.name for e in decided.alternatives),
        statistic=answer.statistic,
        threshold=answer.threshold,
        alpha=request.alpha,
        p_value=answer.p_value,
        mode="absolute" if reference is None else "differential",
        candidates=_candidates(search, ranked, silent),
        calibrated=_calibrated(case, refitted),
        places=places,
        shear=shear_gaps(case, residuals, measured),
        gaps=gaps,
        share_closed=None if closed is None else closed.share,
        share_closed_low=None if closed is None else closed.low,
        share_closed_high=None if closed is None else closed.high,
        fallback=fallback,
        stability=decided.stability,
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


def _reasons(search: Search, nearest: Sequence[Ranked], left_open: float | None) -> list[str]:
    """Return why what comes nearest to a gap does not explain it: one effect, or two that act
    together, which leave a share of the held-out trajectories' gap open."""
    beyond, sizes = None, None
    if len(nearest) == 1:
        beyond = size_beyond_range(search, nearest[0])
        sizes = sizes_by_channel(search, nearest[0])
    parameter = nearest[0].effect.parameters[0]
    return [
        *([] if beyond is None else [wording.asked("data", parameter, beyond)]),
        *([] if left_open is None else [wording.left_open(len(nearest), left_open)]),
        *([] if sizes is None else [wording.disagreeing(parameter, *sizes)]),
    ]


def _confirmed(
    search: Search, ranked: Sequence[Ranked], decided: Decision
) -> tuple[Decision, float | None]:
    """Return what held-out trajectories leave of a decision, and which share of their gap the
    effects close that are not named because of them; None where they are."""
    if not decided.named or not search.held_out:
        return decided, None
    residuals, _ = with_effects(search, decided.named)
    closed = share_closed(residuals, search.held_out, search.random)
    if closed is None or not leaves_open(closed):
        return decided, None
    # What explains the searched trajectories alone is not an explanation.
    both = pair_instead(search, ranked) if len(decided.named) == 1 else None
    return both or Decision(Verdict.UNKNOWN), closed.share


def _hinges(search: Search, ranked: Sequence[Ranked], decided: Decision) -> list[str]:
    """Return a warning of the chosen trajectories without each of which the answer is another one;
    none where there are none."""
    others: dict[str, list[list[Effect]]] = {}
    measured = [k for k in search.chosen if not search.case.trajectories[k].is_reference]
    for number in measured if len(measured) > 1 else ():
        part = search.without(number)
        again = tried_again(part, ranked)
        other, _ = _confirmed(part, again, decide(part, again))
        if is_other_answer(decided, other):
            name = search.case.trajectories[number].recording.name
            answer = [[entry.effect] for entry in other.named]
            if answer:
                answer[0] += [entry.effect for entry in other.alternatives]
            # Last, so that a list of rivals does not run into the other effect.
            others[name] = answer[::-1]
    return [wording.hinges(others)] if others else []


def is_other_answer(decided: Decision, other: Decision) -> bool:
    """Return whether two decisions name other effects, or another number of them; of sets, whether
    no effect is in both."""
    if len(decided.named) != len(other.named):
        return True
    names, others = (
        {e.effect.name for e in (*one.named, *one.alternatives)} for one in (decided, other)
    )
    is_set = bool(decided.alternatives or other.alternatives)
    return not names & others if is_set and names and others else names != others


def leaves_open(closed: Closed) -> bool:
    """Return whether named effects leave a clear gap of the held-out trajectories open."""
    is_clear = (
        closed.before >= decision.FAR
        and closed.high is not None
        and closed.high < 1.0
        and closed.trajectories >= decision.TRAJECTORIES_OFF
    )
    return is_clear and closed.share < decision.LEAST_CLOSED


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


def _calibrated(case: Case, refitted: Fit) -> tuple[Estimate, ...]:
    """Return the nuisances as fitted; the range is that of their priors."""
    result = []
    for (nuisance, name, _), moved in zip(case.columns(), refitted.nuisance.tolist(), strict=True):
        reach = 1.96 * nuisance.deviation
        if nuisance.name in GEL_CONSTANTS:
            parameter = PARAMETERS[nuisance.name]
            at = parameter.to_coordinate(getattr(case.values, parameter.field)) + nuisance.mean
            ends = sorted(parameter.to_value(at + side * reach) for side in (-1.0, 1.0))
            value = parameter.to_value(at + moved * nuisance.deviation)
            value = float(np.clip(value, *parameter.bounds))
            result.append(Estimate(name, parameter.unit, value, ends[0], ends[1]))
        else:
            value = nuisance.mean + moved * nuisance.deviation
            ends = [nuisance.mean + side * reach for side in (-1.0, 1.0)]
            result.append(Estimate(name, nuisance.unit, value, ends[0], ends[1]))
    return tuple(result)


def _skins(
    search: Search, number: int, named: Sequence[Ranked]
) -> tuple[FloatArray, FloatArray] | None:
    """Return the skins (F, V, 3) of a trajectory without and with the effects, None where none was
    measured, and where the gel could not be solved."""
    recording = search.case.trajectories[number].recording
    if recording.press.skin_position_m is None:
        return None
    effects = [
        Active(e.effect, e.effect.checked(e.trial.variant.values(e.trial.size))) for e in named
    ]
    requests = [EffectRequest(recording, search.case.values, effects=e) for e in ((), effects)]
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
