# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is still possible after a search, and the trajectories whose recordings would decide most of
it in a second of the robot's time.

Each explanation is a linear model about its fit to the data: nuisances and sizes, as uncertain as
the data leave them. Real data gain more than simulated ones, by the factor of the effects' limits,
so data count by one over it: those that are there, and those that are expected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

import numpy as np

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.presses import Press
from dotsim_ros.data.recording import Recording, recording_of
from dotsim_ros.effects.effect import Active
from dotsim_ros.effects.simulate import EffectRequest
from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Explanation, Findings, Question, Verdict
from dotsim_ros.gap.presses.answer import (
    SearchAnswer,
    close_to_best,
    possible_pair,
    rivals_beside,
)
from dotsim_ros.gap.presses.catalogue import Planned, catalogue
from dotsim_ros.gap.presses.certainty import SHOWN
from dotsim_ros.gap.presses.evidence import Case, make_case, observed_of
from dotsim_ros.gap.presses.inference import Evidence, fit, log_evidence
from dotsim_ros.gap.presses.information import (
    Beliefs,
    distances,
    information,
    reduced,
    weights_of,
)
from dotsim_ros.gap.presses.search_state import PATTERN_DEVIATION, Ranked, Search
from dotsim_ros.gap.report import wording
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.twin.follow import SolveError

ASKED = "asked_"
"""Begins the names of trajectories that were asked for: they are searched, never held out."""
LEAST_WEIGHT = 0.01
"""No explanation is less probable: no law is quite that of the real effect."""
LEAST_NATS = 0.01
"""What says less is not asked for."""
OVERHEAD_S = 15.0
"""To move there, to tare the gauge, and to begin and end a recording."""
INDENTERS = 2
NO_GAP, UNKNOWN = "no_gap", "unknown"


@dataclass(frozen=True)
class Possible:
    """An explanation, before it is one of a report.

    Attributes:
        name: of the effect, of two joined by "+", `NO_GAP` or `UNKNOWN`.
        title: within a sentence.
        entries: its effects.
        has_patterns: whether any smooth pattern may act.
    """

    name: str
    title: str
    entries: tuple[Ranked, ...] = ()
    has_patterns: bool = False


def is_sure(findings: Findings, no_gap: float) -> bool:
    """Return whether nothing needs to be asked: a name is stable, or there is no gap, with a
    probability of `no_gap` that is as large."""
    if findings.verdict is Verdict.NO_GAP:
        return no_gap >= decision.STABLE_SHARE
    is_stable = findings.stability is None or findings.stability >= decision.STABLE_SHARE
    return findings.verdict is Verdict.NAMED and is_stable


def with_questions(
    findings: Findings, search: Search, answer: SearchAnswer, skin: SkinMesh
) -> Findings:
    """Return findings that say what is still possible, and what to record next; those that are sure
    as they are.

    Args:
        findings: of the search.
        search, answer: the case and what the rule makes of it.
        skin: of the sensor.
    """
    possible = _possible(search, answer.ranked)
    entries = list({id(e): e for one in possible for e in one.entries}.values())
    beliefs = beliefs_of(search, possible, entries)
    if is_sure(findings, float(beliefs.weight[0])):
        return findings
    order = np.argsort(-beliefs.weight, kind="stable")
    explanations = tuple(
        Explanation(possible[k].name, possible[k].title, float(beliefs.weight[k])) for k in order
    )
    planned, designs = _designs(search, entries, skin)
    best = int(order[0])
    questions: list[Question] = []
    known, known_nats = np.zeros((0, beliefs.mean.shape[1])), 0.0
    taken = [entry.name for entry in read_data_set(search.request.measured).entries]
    numbers = (k for k in count(1) if not any(t.startswith(f"{ASKED}{k}_") for t in taken))
    while designs and len(questions) < search.request.next_presses:
        gained = {
            k: information(beliefs.weight, distances(beliefs, np.concatenate([known, design])))
            - known_nats
            for k, design in designs.items()
        }
        chosen = max(gained, key=lambda k: gained[k] / _seconds(planned[k]))
        if gained[chosen] < LEAST_NATS:
            break
        apart = distances(beliefs, designs[chosen])[best]
        one = planned[chosen]
        questions.append(
            Question(
                name=f"{ASKED}{next(numbers)}_{one.kind}",
                indenter=one.indenter,
                path=one.path,
                seconds=_seconds(one),
                information_nats=gained[chosen],
                apart_nats={possible[k].name: float(apart[k]) for k in order.tolist() if k != best},
                stamp_s=one.stamp_s.tolist(),
                poses=[[*p.position_m.tolist(), *p.quaternion_xyzw.tolist()] for p in one.poses],
            )
        )
        known = reduced(np.concatenate([known, designs.pop(chosen)]))
        known_nats += gained[chosen]
    return replace(
        findings,
        sentence=f"{findings.sentence} {wording.to_record(explanations, questions)}",
        explanations=explanations,
        questions=tuple(questions),
    )


def _seconds(planned: Planned) -> float:
    return OVERHEAD_S + planned.duration_s


def _possible(search: Search, ranked: list[Ranked]) -> list[Possible]:
    """Return what may explain the data."""
    singles = [e for e in close_to_best(ranked)[:SHOWN] if e.trial.change.any()]
    pair = possible_pair(search, ranked)
    pairs = []
    if pair is not None:
        seconds = [pair[0], *rivals_beside(search, ranked, pair)[: SHOWN - 1]]
        pairs = [(pair[1], second) for second in seconds]
    found = [Possible(NO_GAP, "no gap")]
    for entries in (*((entry,) for entry in singles), *pairs):
        effects = [entry.effect for entry in entries]
        title = wording.amid_all(effects, are_two=True)
        found.append(Possible("+".join(effect.name for effect in effects), title, tuple(entries)))
    return [*found, Possible(UNKNOWN, "an effect outside the library", has_patterns=True)]


def beliefs_of(search: Search, possible: Sequence[Possible], entries: Sequence[Ranked]) -> Beliefs:
    """Return what the data make of explanations.

    The parameters are the nuisances, in deviations of their priors, each entry's size, as a share
    of the one found, and the patterns, in deviations of theirs.
    """
    factor = search.least_factor
    place = {id(entry): k for k, entry in enumerate(entries)}
    nuisances, patterns = search.evidence.nuisance.shape[1], search.pattern_columns.shape[1]
    size = nuisances + len(entries) + patterns
    mean = np.zeros((len(possible), size))
    covariance = np.zeros((len(possible), size, size))
    logs = np.zeros(len(possible))
    for row, one in enumerate(possible):
        evidence = search.evidence
        places = [*range(nuisances)]
        if one.has_patterns:
            evidence = evidence.with_nuisances(search.pattern_columns)
            places += range(size - patterns, size)
        places += [nuisances + place[id(entry)] for entry in one.entries]
        mean[row, places], covariance[row][np.ix_(places, places)], logs[row] = _posterior(
            evidence, one.entries, factor
        )
    return Beliefs(weights_of(logs, LEAST_WEIGHT), mean, covariance)


def _posterior(
    evidence: Evidence, entries: Sequence[Ranked], factor: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return mean (m,) and covariance (m, m) of an explanation's parameters, the nuisances first,
    and the logarithm of the data's probability, where data count by one over a factor."""
    shape = (len(evidence.residual), len(entries))
    columns = np.reshape([entry.trial.change for entry in entries], shape[::-1]).T
    found = fit(evidence, columns, np.zeros(len(entries)), np.full(len(entries), np.inf))
    parameters = [entry.effect.parameters[0] for entry in entries]
    # Of sizes that may be anywhere in their ranges.
    precision = np.array(
        [
            12.0 * ((entry.trial.size - entry.trial.variant.absent) / (p.high - p.low)) ** 2
            for entry, p in zip(entries, parameters, strict=True)
        ]
    )
    design = np.concatenate([evidence.nuisance, columns], axis=1)
    weight = found.weight[evidence.trajectory] / factor
    prior = np.concatenate([np.ones(evidence.nuisance.shape[1]), precision])
    covariance = np.linalg.inv((design * weight[:, None]).T @ design + np.diag(prior))
    log = log_evidence(evidence, found, columns, precision) / factor
    return np.concatenate([found.nuisance, found.size]), covariance, log


def _expected(search: Search, skin: SkinMesh) -> tuple[list[Planned], Case]:
    """Return what can be recorded next, and the case of what the twin expects of it, in the same
    order.

    Raises:
        SolveError: the gel can be solved along none of it.
    """
    case, request = search.case, search.request
    measured = [t.recording for t in case.trajectories if not t.is_reference]
    indenters = {recording.press.indenter: recording.indenter for recording in measured}
    depths_m = {
        name: max(float(r.depth_m.max()) for r in measured if r.press.indenter == name)
        for name in list(indenters)[:INDENTERS]
    }
    end_s = max(r.session_s + float(np.ptp(r.press.stamp_s)) for r in measured)
    planned = catalogue(request.sensor.gel, depths_m)
    recordings = []
    for number, one in enumerate(planned):
        # What will be measured: all channels.
        still = np.repeat(skin.rest_position_m[None], len(one.poses), axis=0)
        press = Press(
            str(number), one.indenter, list(one.poses), one.stamp_s, still, 0.0 * still[:, 0]
        )
        recordings.append(
            recording_of(press, indenters[one.indenter], skin, session_s=end_s + OVERHEAD_S)
        )
    solved, _ = case.solver.run_each([EffectRequest(r, case.values) for r in recordings])
    expected: list[Recording] = [
        replace(r, press=replace(r.press, skin_position_m=e.skin_position_m, force_n=e.force_n))
        for r, e in zip(recordings, solved, strict=True)
        if e is not None
    ]
    result, _ = make_case(
        expected,
        (),
        values=case.values,
        nuisances=case.nuisances,
        library=case.library,
        solver=case.solver,
        skin=skin,
        noise=search.noise,
        discrepancy=search.discrepancy,
        channels=request.channels,
        progress=partial(search.progress, "next, 1 of 2"),
    )
    return [planned[int(t.recording.name)] for t in result.trajectories], result


def _designs(
    search: Search, entries: Sequence[Ranked], skin: SkinMesh
) -> tuple[list[Planned], dict[int, FloatArray]]:
    """Return what can be recorded next, and what the parameters of `beliefs_of` do to it, (m, p)
    by its place; what could not be solved with an effect has none."""
    try:
        planned, case = _expected(search, skin)
    except SolveError:
        return [], {}
    requests = [
        EffectRequest(
            t.recording,
            case.values,
            effects=[Active(e.effect, e.effect.checked(e.trial.variant.values(e.trial.size)))],
        )
        for t in case.trajectories
        for e in entries
    ]
    results, _ = case.solver.run_each(requests, partial(search.progress, "next, 2 of 2"))
    answers = iter(results)
    designs = {}
    for number, t in enumerate(case.trajectories):
        solved = [one for one in (next(answers) for _ in entries) if one is not None]
        if len(solved) < len(entries):
            continue
        shown = [observed_of(t.recording, t.places, one, case.rest_m) for one in solved]
        columns = [t.whitening.whiten(one - t.predicted) for one in shown]
        design = np.concatenate(
            [
                case.evidence([number]).nuisance,
                np.reshape(columns, (len(columns), t.whitening.size)).T,
                PATTERN_DEVIATION * case.pattern_columns([number]),
            ],
            axis=1,
        )
        designs[number] = reduced(design / np.sqrt(search.least_factor))
    return planned, designs
