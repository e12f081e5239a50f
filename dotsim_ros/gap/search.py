"""The search for a gap, from a measured data set to findings (steps 1 to 9 of the method)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.calibration.parameters import PARAMETERS, GelValues, values_of
from dotsim_ros.calibration.simulation import SolveError
from dotsim_ros.gap import decision, wording
from dotsim_ros.gap.assumptions import ABSOLUTE, DIFFERENTIAL, values_after
from dotsim_ros.gap.covariance import Discrepancy, Noise, load_discrepancy, noise_from_idle
from dotsim_ros.gap.effect import Active, Effect
from dotsim_ros.gap.evidence import Case, Segment, Variant, make_trajectories
from dotsim_ros.gap.findings import Candidate, ChannelGap, Estimate, Findings, Pair, Verdict
from dotsim_ros.gap.inference import Evidence, Fit, draw_null, fit, fit_nuisances, log_evidence
from dotsim_ros.gap.isolability import pairs_of
from dotsim_ros.gap.library import load_effects
from dotsim_ros.gap.locate import (
    Residuals,
    channel_gaps,
    places_of_gap,
    residuals_of,
    share_closed,
    worst_frame,
)
from dotsim_ros.gap.measurement import Measurement, one_of_each, protocol_of, read_measurement
from dotsim_ros.gap.overlay import FoundEffect, Overlay
from dotsim_ros.gap.screening import Screen, Trial, best_trial, excited_variants
from dotsim_ros.gap.simulate import open_solver, request_of
from dotsim_ros.geometry.specification import SensorSpecification
from dotsim_ros.sensor import skin_of

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

Progress = Callable[[str, int, int], None]
"""Told a step's name, and how much of it is done, of how much."""

PATTERN_DEVIATION = 20.0
"""Prior of a pattern, in its percents of the press."""
ROUNDS = 2
"""How often the sizes of the best effects are refined by a solve at the size found."""
BOOTSTRAPS = 20
INTERVAL_DRAWS = 100
PAIR_ROUNDS = 2
SMALL_SHARE = 0.08
"""A size that is nearer to a node than this share of it needs no solve of its own."""
SHOWN = 6
"""So many of the best effects are set against each other."""


@dataclass(frozen=True)
class Request:
    """What to search, and how.

    Attributes:
        measured: folder of the data set.
        sensor: the calibrated twin.
        directory: of the run: solves are kept there.
        reference: folder of the commissioning; None for the absolute mode.
        indenters: folder of the meshes; None looks beside the data.
        effects: folders of the user's effects.
        channels: that are used.
        candidates: names of the effects to look for; empty for all of the library.
        alpha: probability of a name on data without any effect.
        budget: most solves of a trajectory; None for no limit.
        seed: of all draws.
        workers: processes.
        discrepancy: file of the covariances; None for the shipped ones.
        optical_noise: file of what images show where nothing is missing; None for the shipped one.
    """

    measured: Path
    sensor: SensorSpecification
    directory: Path
    reference: Path | None = None
    indenters: Path | None = None
    effects: tuple[Path, ...] = ()
    channels: tuple[str, ...] = ("skin", "force")
    candidates: tuple[str, ...] = ()
    alpha: float = 0.02
    budget: int | None = None
    seed: int = 0
    workers: int = 2
    discrepancy: Path | None = None
    optical_noise: Path | None = None


@dataclass
class Ranked:
    """An effect during the search."""

    effect: Effect
    variants: list[Variant]
    trial: Trial
    estimates: tuple[Estimate, ...] = ()
    explained: float | None = None
    held_out_gain: float | None = None
    limit: float = np.inf

    @property
    def is_past_limit(self) -> bool:
        """Whether it gains more than data without any effect let it gain."""
        return self.trial.gain > self.limit


@dataclass
class Search:
    """What the steps share."""

    request: Request
    case: Case
    chosen: list[int]
    locked: list[int]
    noise: Noise
    discrepancy: Discrepancy
    random: np.random.Generator
    progress: Progress
    warnings: list[str] = field(default_factory=list)
    pattern_chance: float = 0.0
    _segments: dict[tuple[int, int], list[Segment]] = field(default_factory=dict)

    @cached_property
    def evidence(self) -> Evidence:
        """What the chosen trajectories show."""
        return self.case.evidence(self.chosen)

    @cached_property
    def base(self) -> Fit:
        """The twin recalibrated, without any effect."""
        return fit_nuisances(self.evidence)

    @cached_property
    def pattern_columns(self) -> Array:
        """(n, K) what a pattern does when it moves by one deviation of its prior."""
        return PATTERN_DEVIATION * self.case.pattern_columns(self.chosen)

    @cached_property
    def misfit_limit(self) -> float:
        """Largest objective of an observable that data without any effect leave, as the
        commissioning tells where there is one."""
        reference = [
            place for place, k in enumerate(self.chosen) if self.case.trajectories[k].is_reference
        ]
        if not reference:
            return self.discrepancy.misfit_limit + decision.MISFIT_OF_UNITS
        known = self.evidence.of(reference)
        return fit_nuisances(known).objective / len(known.residual) + decision.MISFIT_SINCE

    def segments(self, variants: Sequence[Variant]) -> list[Segment]:
        """Return the segments of variants; they are whitened once for each set of nodes."""
        result = []
        for variant in variants:
            key = id(variant), len(variant.node)
            if key not in self._segments:
                self._segments[key] = self.case.segments(variant, self.chosen)
            result += self._segments[key]
        return result

    def has_budget(self, variants: int) -> bool:
        """Return whether so many variants may be simulated along the measured trajectories."""
        if self.request.budget is None:
            return True
        measured = sum(not t.is_reference for t in self.case.trajectories)
        return self.case.solver.solve_count + variants * measured <= self.request.budget

    def resampled(self) -> tuple[Evidence, IntArray]:
        """Return the evidence of trajectories drawn with replacement, and which rows it takes."""
        drawn = self.random.integers(len(self.chosen), size=len(self.chosen)).tolist()
        return self.evidence.of(drawn), self.evidence.rows_of(drawn)


def find_gap(request: Request, progress: Progress) -> tuple[Findings, Overlay | None]:
    """Search a data set; return what was found, and the overlay if an effect was named.

    Raises:
        FileNotFoundError: a data set, an indenter or a file that is not there.
        ValueError: data that cannot be used; the text says why and what to do.
    """
    begun_s = time.monotonic()
    if not 0.0 < request.alpha < 1.0:
        raise ValueError(f"alpha is {request.alpha}, expected between 0 and 1")
    measurement, reference = _read(request)
    library = load_effects(request.effects)
    unknown = sorted(set(request.candidates) - set(library))
    if unknown:
        raise ValueError(f"no effect {', '.join(unknown)}; known are {', '.join(library)}")
    noise = noise_from_idle(measurement.recordings, measurement.skin.rest_position_m, Noise())
    discrepancy = load_discrepancy(request.discrepancy)
    values = values_of(request.sensor)
    warnings = [
        *measurement.warnings,
        *wording.data_warnings(measurement, request.channels, reference is not None),
    ]
    if noise.source == "declared":
        warnings.append("no frame is without contact: the declared noise is used")
    random = np.random.default_rng(request.seed)
    with open_solver(
        request.sensor,
        measurement.skin,
        request.directory / "solves",
        folders=request.effects,
        workers=request.workers,
    ) as solver:
        nuisances = ABSOLUTE if reference is None else DIFFERENTIAL
        trajectories, left_out = make_trajectories(
            measurement.recordings,
            () if reference is None else reference.recordings,
            values=values,
            nuisances=nuisances,
            library=library,
            solver=solver,
            skin=measurement.skin,
            noise=noise,
            discrepancy=discrepancy,
            channels=request.channels,
            progress=lambda done, total: progress("calibrate", done, total),
        )
        warnings += left_out
        case = Case(
            trajectories, nuisances, library, solver, values, measurement.skin.rest_position_m
        )
        chosen, locked = _lock(case, random)
        if not locked:
            warnings.append(
                "no protocol was repeated: nothing could be kept locked, so the gain is shown on "
                "the data that the effect was found in; repeat each protocol"
            )
        search = Search(
            request, case, chosen, locked, noise, discrepancy, random, progress, warnings
        )
        findings, overlay = _run(search, measurement, reference)
    seconds = time.monotonic() - begun_s
    return replace(findings, solve_count=solver.solve_count, seconds=seconds), overlay


def _read(request: Request) -> tuple[Measurement, Measurement | None]:
    own = skin_of(request.sensor.gel)
    measurement = read_measurement(request.measured, own_skin=own, indenters=request.indenters)
    if request.reference is None:
        return measurement, None
    reference = read_measurement(request.reference, own_skin=own, indenters=request.indenters)
    if reference.skin.vertex_count != measurement.skin.vertex_count:
        raise ValueError(
            f"{request.reference} lists {reference.skin.vertex_count} points of the skin, "
            f"{request.measured} {measurement.skin.vertex_count}; record both in the same way"
        )
    return measurement, reference


def _lock(case: Case, random: np.random.Generator) -> tuple[list[int], list[int]]:
    """Return trajectories to search, and to keep locked: one of each repeated protocol."""
    measured = [n for n, t in enumerate(case.trajectories) if not t.is_reference]
    places = one_of_each([protocol_of(case.trajectories[n].recording) for n in measured], random)
    locked = [measured[place] for place in places]
    return [n for n in range(len(case.trajectories)) if n not in locked], locked


@dataclass(frozen=True)
class Answer:
    """What the rule makes of a case.

    Attributes:
        verdict: the answer.
        named, alternatives: effects.
        ranked: every effect that was tried, the best first.
        statistic, threshold, p_value: gain and limit of the effect that is named, or comes
            nearest to it.
    """

    verdict: Verdict
    named: list[Ranked]
    alternatives: list[Ranked]
    ranked: list[Ranked]
    statistic: float
    threshold: float
    p_value: float


def answer_of(search: Search, ranked: list[Ranked], gains: Array, pattern_gains: Array) -> Answer:
    """Apply the rule to a case.

    Args:
        search: the case.
        ranked: its effects, screened.
        gains, pattern_gains: of data without any effect, as `null_gains` returns them.
    """
    alpha = search.request.alpha
    threshold = decision.threshold_of(gains.tolist(), alpha)
    for entry in ranked:
        factor = decision.limit_factor(entry.effect.name, search.discrepancy.limit_factors)
        entry.limit = factor * threshold
    pattern_threshold = decision.PATTERNS_HEAVIER * decision.threshold_of(
        pattern_gains.tolist(), alpha
    )
    search.pattern_chance = decision.PATTERNS_HEAVIER * float(np.median(pattern_gains))
    is_effect = any(entry.is_past_limit for entry in ranked)
    pattern_gain = _pattern_gain(search, search.evidence, search.base.objective)
    if is_effect:
        ranked = _refit(search, ranked)
    verdict = Verdict.NO_GAP
    named: list[Ranked] = []
    alternatives: list[Ranked] = []
    if is_effect or pattern_gain > pattern_threshold:
        verdict, named, alternatives = _decide(search, ranked)
    first = max(named or ranked, key=lambda entry: entry.trial.gain / entry.limit)
    scale = first.limit / threshold
    p_value = float(np.mean(scale * gains >= first.trial.gain))
    return Answer(verdict, named, alternatives, ranked, first.trial.gain, first.limit, p_value)


def _run(
    search: Search, measurement: Measurement, reference: Measurement | None
) -> tuple[Findings, Overlay | None]:
    variants, silent = simulate_effects(search)
    ranked = screen(search, variants)
    gains, pattern_gains = null_gains(search, ranked, decision.NULL_DRAWS)
    answer = answer_of(search, ranked, gains, pattern_gains)
    named = answer.named
    for entry in named:
        others = [other for other in named if other is not entry]
        entry.estimates = estimates_of(search, entry, others)
    stability = _stability(search, answer.ranked, named[0].effect.name) if named else None
    return _findings(
        search, measurement, reference, answer=answer, silent=silent, stability=stability
    )


def simulate_effects(search: Search) -> tuple[list[Variant], list[str]]:
    """Simulate every effect that is excited at its probes; return them, and the others' names.

    Raises:
        ValueError: nothing is excited.
    """
    variants, silent = excited_variants(search.case, search.request.candidates)
    if not variants:
        raise ValueError(
            "no trajectory excites any effect of the library: nothing can be concluded; record "
            "presses with force or skin, holds, slides and releases"
        )
    wanted = [
        (variant, probe) for variant in variants for probe in variant.effect.parameters[0].probes
    ]
    failures = search.case.extend(
        wanted, progress=lambda done, total: search.progress("screen", done, total)
    )
    search.warnings += [f"an effect could not be simulated: {text}" for text in failures]
    return variants, silent


def screen(search: Search, variants: Sequence[Variant]) -> list[Ranked]:
    """Return the effects by their gain."""
    groups: dict[str, list[Variant]] = {}
    for variant in variants:
        groups.setdefault(variant.effect.name, []).append(variant)
    ranked = []
    for name, members in groups.items():
        trial = best_trial(search.evidence, search.segments(members), search.base.objective)
        ranked.append(Ranked(search.case.library[name], members, trial))
    return sorted(ranked, key=lambda entry: entry.trial.gain, reverse=True)


def _pattern_gain(search: Search, evidence: Evidence, base: float) -> float:
    """Return what all patterns together gain over an objective."""
    return base - fit_nuisances(evidence.with_nuisances(search.pattern_columns)).objective


def null_gains(search: Search, ranked: Sequence[Ranked], count: int) -> tuple[Array, Array]:
    """Return, of `count` data without an effect, the largest gain of any, and that of patterns."""
    evidence = search.evidence
    segments = [s for entry in ranked for s in search.segments(entry.variants)]
    effects = Screen(evidence, segments)
    widened = Screen(evidence.with_nuisances(search.pattern_columns))
    gains, patterns = np.zeros(count), np.zeros(count)
    for k in range(count):
        residual = draw_null(evidence, search.random)
        base, by_segment = effects.gains(residual)
        gains[k] = by_segment.max()
        patterns[k] = base - widened.gains(residual)[0]
        search.progress("nulls", k + 1, count)
    return gains, patterns


def _refit(search: Search, ranked: list[Ranked]) -> list[Ranked]:
    """Simulate the best effects at the sizes found, again and again; return them in order."""
    for _ in range(ROUNDS):
        close = _close(ranked)
        wanted: list[tuple[Variant, float]] = []
        for entry in close:
            variant, size = _better_variant(search, entry), entry.trial.size
            nearest = min(abs(size - node) for node in variant.node)
            if nearest > SMALL_SHARE * max(abs(size - variant.absent), 1e-12):
                wanted.append((variant, size))
        wanted = [pair for k, pair in enumerate(wanted) if search.has_budget(k + 1)]
        if not wanted:
            break
        search.case.extend(
            wanted, progress=lambda done, total: search.progress("refit", done, total)
        )
        for entry in close:
            segments = search.segments(entry.variants)
            entry.trial = best_trial(search.evidence, segments, search.base.objective)
        ranked = sorted(ranked, key=lambda entry: entry.trial.gain, reverse=True)
    return ranked


def _close(ranked: Sequence[Ranked]) -> list[Ranked]:
    """Return the effects that are worth a refit."""
    least = ranked[0].trial.gain - decision.CLOSE
    return [
        entry
        for place, entry in enumerate(ranked)
        if place < decision.SCREENED or entry.trial.gain > least
    ]


def _better_variant(search: Search, entry: Ranked) -> Variant:
    """Return the variant to simulate next: between the shapes tried, where a parabola through their
    gains has its top; the best one tried where there is no such place."""
    best = entry.trial.variant
    names = list(best.shape)
    if len(names) != 1:
        return best
    name = names[0]
    gains = {
        variant.shape[name]: best_trial(
            search.evidence, search.segments([variant]), search.base.objective
        ).gain
        for variant in entry.variants
    }
    shapes = sorted(gains)
    place = shapes.index(best.shape[name])
    if not 0 < place < len(shapes) - 1 or min(shapes) <= 0.0:
        return best
    x = np.log(shapes[place - 1 : place + 2])
    curve = np.polyfit(x, [gains[s] for s in shapes[place - 1 : place + 2]], 2)
    if curve[0] >= 0.0:
        return best
    top = float(np.exp(np.clip(-curve[1] / (2.0 * curve[0]), x[0], x[2])))
    if min(abs(np.log(top / s)) for s in shapes) < 0.15:
        return best
    variant = search.case.variants(entry.effect)[0]
    variant.shape = {name: top}
    entry.variants.append(variant)
    return variant


def _decide(search: Search, ranked: list[Ranked]) -> tuple[Verdict, list[Ranked], list[Ranked]]:
    """Return the verdict, the effects to add, and those that the first is not told from."""
    for entry in _close(ranked):
        entry.explained = _explained(search, [entry])
        entry.held_out_gain = _held_out_gain(search, entry)
    able = [entry for entry in ranked if entry.is_past_limit]
    if not able:
        return Verdict.UNKNOWN, [], []
    best = able[0]
    pair = _pair(search, ranked)
    if pair is not None:
        further = _gain(search, pair) - _gain(search, [best])
        if further > decision.FURTHER * _left(search, [best]):
            if _explained(search, pair) < decision.EXPLAINED:
                return Verdict.UNKNOWN, [], []
            return Verdict.NAMED, pair, []
    if (best.explained or 0.0) < decision.EXPLAINED:
        return Verdict.UNKNOWN, [], []
    least = best.trial.gain - decision.SAME
    alternatives = [entry for entry in able[1:] if entry.trial.gain > least]
    return (Verdict.SET if alternatives else Verdict.NAMED), [best], alternatives


def _explained(search: Search, entries: Sequence[Ranked]) -> float:
    """Return the share that effects have of what they gain and of the gap that they leave."""
    gained = _gain(search, entries)
    return float(np.clip(gained / max(gained + _left(search, entries), 1e-9), 0.0, 1.0))


def _gain(search: Search, entries: Sequence[Ranked]) -> float:
    """Return what effects gain together, each at up to 1.3 of the size found."""
    return search.base.objective - _fit_of(search.evidence, entries).objective


def _left(search: Search, entries: Sequence[Ranked]) -> float:
    """Return the gap that effects leave: what patterns could remove beside them, or by how much
    more the data differ than data without any effect, whichever is more."""
    own = _fit_of(search.evidence, entries).objective
    everything = _fit_of(search.evidence.with_nuisances(search.pattern_columns), entries).objective
    # What patterns remove of noise alone is no gap.
    by_patterns = own - everything - search.pattern_chance
    misfit = own - search.misfit_limit * len(search.evidence.residual)
    return max(by_patterns, misfit, 0.0)


def _fit_of(evidence: Evidence, entries: Sequence[Ranked]) -> Fit:
    columns = np.stack([entry.trial.change for entry in entries], axis=1)
    return fit(evidence, columns, np.zeros(len(entries)), np.full(len(entries), 1.3))


def _held_out_gain(search: Search, entry: Ranked) -> float:
    """Return what an effect gains of the log score, in nats, of trajectories that were left out,
    each in turn, its size and the nuisances as uncertain as the others leave them.

    The score of one trajectory is the log of the probability of all data less that of the others
    (Dawid 1984). A size that the others cannot tell costs little, one that they tell otherwise
    costs much.
    """
    places = range(len(search.chosen))
    segments = search.segments(entry.variants)
    whole = _evidence_gain(search.evidence, segments, entry)
    left_out = [[place for place in places if place != out] for out in places]
    return sum(
        whole
        - _evidence_gain(
            search.evidence.of(kept),
            [_rows(s, search.evidence.rows_of(kept)) for s in segments],
            entry,
        )
        for kept in left_out
        if kept
    )


def _evidence_gain(evidence: Evidence, segments: Sequence[Segment], entry: Ranked) -> float:
    """Return by how much an effect raises the log of the data's probability."""
    base = fit_nuisances(evidence)
    trial = best_trial(evidence, segments, base.objective)
    parameter = entry.effect.parameters[0]
    # Of a size that may be anywhere in its range.
    precision = np.array([12.0 / (parameter.high - parameter.low) ** 2])
    remaining = evidence.without(trial.segment.offset)
    with_effect = log_evidence(remaining, trial.fit, trial.segment.column[:, None], precision)
    without = log_evidence(evidence, base, np.zeros((len(evidence.residual), 0)), np.zeros(0))
    return with_effect - without


def _pair(search: Search, ranked: Sequence[Ranked]) -> list[Ranked] | None:
    """Return the two effects that gain most together, None unless each gains more beside the other
    than its limit and what the other's law may be off by.

    The one that gains most alone need not be of them: it may be what the two look like together.
    """
    if len(ranked) < 2:
        return None
    pairs = []
    for first in _close(ranked):
        second = _beside(search, first, [entry for entry in ranked if entry is not first])
        pair = [first, second]
        for _ in range(PAIR_ROUNDS):
            # Each at the size that it has beside the other.
            pair = [_beside(search, pair[1], [pair[0]]), _beside(search, pair[0], [pair[1]])]
        pairs.append(pair)
    best = max(pairs, key=lambda pair: _gain(search, pair))
    first, second = best
    is_needed = all(
        entry.trial.gain > entry.limit + decision.OTHER_LAW * other.trial.gain
        for entry, other in ((first, second), (second, first))
    )
    return best if is_needed else None


def _beside(search: Search, known: Ranked, others: Sequence[Ranked]) -> Ranked:
    """Return that of the others which gains most beside a known effect, as it does there."""
    evidence = search.evidence.without(known.trial.change)
    base = fit_nuisances(evidence).objective
    tried = [
        replace(entry, trial=best_trial(evidence, search.segments(entry.variants), base))
        for entry in others
    ]
    return max(tried, key=lambda entry: entry.trial.gain)


def estimates_of(search: Search, entry: Ranked, others: Sequence[Ranked]) -> tuple[Estimate, ...]:
    """Return an effect's parameters, intervals by a bootstrap over trajectories."""
    segments = search.segments(entry.variants)
    change = sum((other.trial.change for other in others), np.zeros(len(search.evidence.residual)))
    sizes, shapes = [], []
    for _ in range(INTERVAL_DRAWS):
        drawn, rows = search.resampled()
        evidence = drawn.without(change[rows])
        base = fit_nuisances(evidence).objective
        trial = best_trial(evidence, [_rows(s, rows) for s in segments], base)
        sizes.append(trial.size)
        shapes.append(list(trial.variant.shape.values()))
    first = entry.effect.parameters[0]
    low, high = np.percentile(sizes, [2.5, 97.5]).tolist()
    size = entry.trial.size
    estimates = [Estimate(first.name, first.unit, size, min(low, size), max(high, size))]
    for place, parameter in enumerate(entry.effect.parameters[1:]):
        value = entry.trial.variant.shape[parameter.name]
        low, high = np.percentile([s[place] for s in shapes], [2.5, 97.5]).tolist()
        estimates.append(
            Estimate(parameter.name, parameter.unit, value, min(low, value), max(high, value))
        )
    return tuple(estimates)


def _rows(segment: Segment, rows: IntArray) -> Segment:
    return replace(segment, offset=segment.offset[rows], column=segment.column[rows])


def _stability(search: Search, ranked: Sequence[Ranked], name: str) -> float:
    """Return the share of bootstrap repetitions over trajectories that find the same effect."""
    groups = {e.effect.name: search.segments(e.variants) for e in ranked[:SHOWN]}
    same = 0
    for _ in range(BOOTSTRAPS):
        evidence, rows = search.resampled()
        base = fit_nuisances(evidence).objective
        gains = {
            other: best_trial(evidence, [_rows(s, rows) for s in group], base).gain
            for other, group in groups.items()
        }
        same += max(gains, key=lambda other: gains[other]) == name
    return same / BOOTSTRAPS


def _pairs(search: Search, ranked: Sequence[Ranked]) -> tuple[Pair, ...]:
    """Return the pairs of the best effects that are close to each other."""
    top = [e for e in ranked[:SHOWN] if np.any(e.trial.change)]
    if len(top) < 2:
        return ()
    columns = np.stack([entry.trial.change for entry in top], axis=1)
    recordings = [search.case.trajectories[k].recording for k in search.chosen]
    pairs = pairs_of(search.evidence, [e.effect for e in top], columns, recordings)
    return tuple(
        p for p in pairs if p.separation < decision.APART or abs(p.cosine) > decision.ALIKE
    )


def change_by_trajectory(search: Search, entries: Sequence[Ranked]) -> list[Array]:
    """Return (F, SIZE) of each trajectory by effects at the sizes found."""
    total = [np.zeros_like(t.predicted) for t in search.case.trajectories]
    for entry in entries:
        for number, part in enumerate(search.case.change_at(entry.trial.variant, entry.trial.size)):
            total[number] = total[number] + part
    return total


def _findings(
    search: Search,
    measurement: Measurement,
    reference: Measurement | None,
    *,
    answer: Answer,
    silent: Sequence[str],
    stability: float | None,
) -> tuple[Findings, Overlay | None]:
    case, request = search.case, search.request
    named, ranked, verdict = answer.named, answer.ranked, answer.verdict
    change = change_by_trajectory(search, named)
    refitted = fit_nuisances(search.evidence.without(case.whitened(change, search.chosen)))
    residuals = residuals_of(
        case,
        recalibrated=search.base.nuisance,
        refitted=refitted.nuisance,
        change=change,
        noise=search.noise,
        discrepancy=search.discrepancy,
    )
    measured = [k for k, t in enumerate(case.trajectories) if not t.is_reference]
    judged = search.locked or measured
    closed: tuple[float, float, float] | None = None
    if named:
        closed = share_closed(residuals, judged, search.random)
        if not np.isfinite(closed[0]):
            closed = None
            search.warnings.append("the locked trajectories show no gap that could be closed")
    if stability is not None and stability < 0.9:
        search.warnings.append(
            f"the name is not stable: {stability:.0%} of {BOOTSTRAPS} bootstrap repetitions over "
            "trajectories agree; record more trajectories"
        )
    worst = worst_frame(
        case,
        residuals,
        measured,
        lambda number: _skins(search, number, named),
        measurement.skin.rest_position_m,
    )
    shared = case.shared_nuisances()
    fallback: tuple[ChannelGap, ...] = ()
    if verdict is Verdict.UNKNOWN:
        fallback = channel_gaps(_fallback(search), judged)
    fitted = values_after(case.values, shared, refitted.nuisance[: len(shared)])
    gaps = channel_gaps(residuals, judged)
    places = places_of_gap(case, residuals, measured, search.random)
    findings = Findings(
        verdict=verdict,
        sentence=wording.sentence(
            verdict,
            [(e.effect, e.estimates) for e in named],
            [e.effect for e in answer.alternatives],
            gaps,
            nearest=ranked[0].effect if ranked else None,
            place=wording.largest_place(places),
        ),
        named=tuple(e.effect.name for e in named),
        alternatives=tuple(e.effect.name for e in answer.alternatives),
        statistic=answer.statistic,
        threshold=answer.threshold,
        alpha=request.alpha,
        p_value=answer.p_value,
        mode="absolute" if reference is None else "differential",
        candidates=_candidates(search, ranked, silent),
        calibrated=_calibrated(case, fitted, refitted),
        places=places,
        gaps=gaps,
        share_closed=None if closed is None else closed[0],
        share_closed_low=None if closed is None else closed[1],
        share_closed_high=None if closed is None else closed[2],
        fallback=fallback,
        stability=stability,
        pairs=_pairs(search, ranked),
        worst=worst,
        warnings=tuple(search.warnings),
        trajectories=tuple(case.trajectories[k].recording.name for k in search.chosen),
        locked=tuple(case.trajectories[k].recording.name for k in search.locked),
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


def _fallback(search: Search) -> Residuals:
    """Return what patterns leave when they stand in for an effect: a Gaussian process with the
    patterns as its functions, fitted beside the nuisances."""
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
    """Return the nuisances as fitted; the interval is that of their priors."""
    result = []
    for (nuisance, _), name, moved in zip(
        case.columns(), case.column_names(), refitted.nuisance.tolist(), strict=True
    ):
        reach = 1.96 * nuisance.deviation
        if nuisance.name in PARAMETERS:
            parameter = PARAMETERS[nuisance.name]
            at = parameter.to_coordinate(getattr(case.values, parameter.field))
            ends = sorted(parameter.to_value(at + side * reach) for side in (-1.0, 1.0))
            value = float(getattr(fitted, parameter.field))
            result.append(Estimate(name, parameter.unit, value, ends[0], ends[1]))
        else:
            value = moved * nuisance.deviation
            result.append(Estimate(name, nuisance.unit, value, -reach, reach))
    return tuple(result)


def _skins(search: Search, number: int, named: Sequence[Ranked]) -> tuple[Array, Array] | None:
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
        search.warnings.append(f"no picture of {recording.name}: {error}")
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
    library = search.case.library
    result += [
        Candidate(name, library[name].title, False, 0.0, library[name].parameters[0].none or 0.0)
        for name in silent
    ]
    return tuple(result)
