"""The search for a gap, from a measured data set to findings (steps 1 to 9 of the method)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.calibration.parameters import PARAMETERS, GelValues, values_of
from dotsim_ros.calibration.simulation import SolveError
from dotsim_ros.gap import decision, wording
from dotsim_ros.gap.assumptions import ABSOLUTE, DIFFERENTIAL, Nuisance, values_after
from dotsim_ros.gap.covariance import Discrepancy, Noise, load_discrepancy, noise_from_idle
from dotsim_ros.gap.effect import Active, Effect
from dotsim_ros.gap.evidence import Case, Segment, Variant, make_trajectories
from dotsim_ros.gap.findings import Candidate, Estimate, Findings, Pair, Verdict
from dotsim_ros.gap.inference import Evidence, Fit, cosines, draw_null, fit, lengths
from dotsim_ros.gap.library import load_effects
from dotsim_ros.gap.locate import (
    channel_gaps,
    places_of_gap,
    residuals_of,
    share_closed,
    worst_frame,
)
from dotsim_ros.gap.measurement import Measurement, protocol_of, read_measurement
from dotsim_ros.gap.overlay import FoundEffect, Overlay
from dotsim_ros.gap.screening import Trial, best_trial, excited_variants
from dotsim_ros.gap.simulate import Solver, open_solver, request_of
from dotsim_ros.geometry.specification import SensorSpecification
from dotsim_ros.sensor import skin_of

Array = NDArray[np.float64]

Progress = Callable[[str, int, int], None]
"""Told a step's name, and how much of it is done, of how much."""

PATTERN_DEVIATION = 20.0
"""Prior of a pattern, in its percents of the press."""
ROUNDS = 2
"""How often the sizes of the best effects are refined by a solve at the size found."""
BOOTSTRAPS = 20
INTERVAL_DRAWS = 100
SMALL_SHARE = 0.08
"""A size that is nearer to a node than this share of it needs no solve of its own."""
LOCKED_SHARE = 0.4


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


@dataclass
class Ranked:
    """An effect during the search."""

    effect: Effect
    variants: list[Variant]
    trial: Trial
    first_gain: float
    estimates: tuple[Estimate, ...] = ()
    held_out_gain: float | None = None
    explained: float | None = None


@dataclass
class Search:
    """What the steps share."""

    request: Request
    case: Case
    chosen: list[int]
    locked: list[int]
    evidence: Evidence
    base: Fit
    noise: Noise
    discrepancy: Discrepancy
    random: np.random.Generator
    progress: Progress
    solver: Solver
    warnings: list[str] = field(default_factory=list)
    pattern_chance: float = 0.0

    @cached_property
    def pattern_columns(self) -> Array:
        """(n, K) what a pattern does when it moves by one deviation of its prior."""
        return PATTERN_DEVIATION * self.case.pattern_columns(self.chosen)

    def segments(self, variants: Sequence[Variant]) -> list[Segment]:
        return [s for variant in variants for s in self.case.segments(variant, self.chosen)]

    def has_budget(self, variants: int) -> bool:
        """Return whether so many variants may be simulated along the measured trajectories."""
        if self.request.budget is None:
            return True
        measured = sum(not t.is_reference for t in self.case.trajectories)
        return self.solver.solve_count + variants * measured <= self.request.budget


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
        evidence = case.evidence(chosen)
        base = fit(evidence, _nothing(evidence))
        search = Search(
            request, case, chosen, locked, evidence, base, noise, discrepancy, random, progress,
            solver, warnings,
        )  # fmt: skip
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
    groups: dict[str, list[int]] = {}
    for number, t in enumerate(case.trajectories):
        if not t.is_reference:
            groups.setdefault(protocol_of(t.recording), []).append(number)
    measured = sum(len(members) for members in groups.values())
    repeated = sorted(
        (members for members in groups.values() if len(members) > 1), key=len, reverse=True
    )
    most = int(LOCKED_SHARE * measured + 0.5)
    locked = sorted(int(random.choice(members)) for members in repeated[:most])
    chosen = [n for n in range(len(case.trajectories)) if n not in locked]
    return chosen, locked


def _nothing(evidence: Evidence) -> Array:
    return np.zeros((len(evidence.residual), 0))


@dataclass(frozen=True)
class Answer:
    """What the rule makes of a case.

    Attributes:
        verdict: the answer.
        named, alternatives: effects.
        ranked: every effect that was tried, the best first.
        statistic, threshold, p_value: of the best effect.
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
    threshold = decision.threshold_of(gains.tolist(), alpha, heavier=decision.HEAVIER)
    pattern_threshold = decision.threshold_of(
        pattern_gains.tolist(), alpha, heavier=decision.HEAVIER
    )
    statistic = ranked[0].trial.gain
    p_value = float(np.mean(decision.HEAVIER * gains >= statistic))
    search.pattern_chance = decision.HEAVIER * float(np.median(pattern_gains))
    is_effect = statistic > threshold
    is_gap = is_effect or _pattern_gain(search, search.evidence) > pattern_threshold
    if is_effect:
        ranked = _refit(search, ranked)
    verdict = Verdict.NO_GAP
    named: list[Ranked] = []
    alternatives: list[Ranked] = []
    if is_gap:
        verdict, named, alternatives = _decide(search, ranked, threshold if is_effect else np.inf)
    statistic = max(statistic, ranked[0].trial.gain)
    return Answer(verdict, named, alternatives, ranked, statistic, threshold, p_value)


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
        entry.estimates = _estimates(search, entry, others)
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
        ranked.append(Ranked(search.case.library[name], members, trial, trial.gain))
    return sorted(ranked, key=lambda entry: entry.trial.gain, reverse=True)


def _pattern_gain(search: Search, evidence: Evidence) -> float:
    """Return what all patterns together gain."""
    columns = search.pattern_columns
    widened = Evidence(
        evidence.residual,
        np.concatenate([evidence.nuisance, columns], axis=1),
        evidence.trajectory,
    )
    base = fit(evidence, _nothing(evidence)).objective
    return base - fit(widened, _nothing(evidence)).objective


def null_gains(search: Search, ranked: Sequence[Ranked], count: int) -> tuple[Array, Array]:
    """Return, of `count` data without an effect, the largest gain of any, and that of patterns."""
    evidence = search.evidence
    groups = [search.segments(entry.variants) for entry in ranked]
    gains, patterns = np.zeros(count), np.zeros(count)
    for k in range(count):
        drawn = evidence.with_residual(draw_null(evidence, search.random))
        base = fit(drawn, _nothing(drawn)).objective
        gains[k] = max(best_trial(drawn, group, base).gain for group in groups)
        patterns[k] = _pattern_gain(search, drawn)
        search.progress("nulls", k + 1, count)
    return gains, patterns


def _refit(search: Search, ranked: list[Ranked]) -> list[Ranked]:
    """Simulate the best effects at the sizes found, again and again; return them in order."""
    for _ in range(ROUNDS):
        close = [
            entry
            for place, entry in enumerate(ranked)
            if place < decision.SCREENED
            or entry.trial.gain > ranked[0].trial.gain - 3.0 * decision.SAME
        ]
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


def _decide(
    search: Search, ranked: list[Ranked], threshold: float
) -> tuple[Verdict, list[Ranked], list[Ranked]]:
    """Return the verdict, the effects to add, and those that the first is not told from."""
    for entry in ranked[: decision.SCREENED]:
        entry.explained = _explained(search, [entry])
    best = ranked[0]
    if best.trial.gain <= threshold:
        return Verdict.UNKNOWN, [], []
    named = [best]
    explained = best.explained or 0.0
    if explained < decision.EXPLAINED:
        second = _second(search, best, ranked[1:], threshold)
        if second is not None:
            both = _explained(search, [best, second])
            if both - explained > decision.FURTHER * (1.0 - explained):
                named.append(second)
                explained = both
    if explained < decision.EXPLAINED:
        return Verdict.UNKNOWN, [], []
    alternatives = [
        entry
        for entry in ranked[1:]
        if entry not in named and best.trial.gain - entry.trial.gain < decision.SAME
    ]
    if len(named) > 1:
        alternatives = []
    return (Verdict.SET if alternatives else Verdict.NAMED), named, alternatives


def _explained(search: Search, entries: Sequence[Ranked]) -> float:
    """Return the share that effects have of what patterns and they together could remove."""
    evidence = search.evidence
    columns = np.stack([entry.trial.change for entry in entries], axis=1)
    low, high = np.zeros(columns.shape[1]), np.full(columns.shape[1], 1.3)
    patterns = search.pattern_columns
    widened = Evidence(
        evidence.residual,
        np.concatenate([evidence.nuisance, patterns], axis=1),
        evidence.trajectory,
    )
    everything = fit(widened, columns, low, high)
    own = fit(evidence, columns, low, high)
    # What patterns remove of noise alone is no gap.
    left = own.objective - everything.objective - search.pattern_chance
    gained = search.base.objective - own.objective
    return float(np.clip(gained / max(gained + max(left, 0.0), 1e-9), 0.0, 1.0))


def _second(
    search: Search, best: Ranked, others: Sequence[Ranked], threshold: float
) -> Ranked | None:
    """Return the effect that gains most beside the best one, if it gains enough."""
    evidence = search.evidence.with_residual(search.evidence.residual - best.trial.change)
    base = fit(evidence, _nothing(evidence)).objective
    found: list[tuple[float, Ranked]] = []
    for entry in others:
        trial = best_trial(evidence, search.segments(entry.variants), base)
        found.append((trial.gain, Ranked(entry.effect, entry.variants, trial, entry.first_gain)))
    if not found:
        return None
    gain, second = max(found, key=lambda pair: pair[0])
    return second if gain > threshold else None


def _estimates(search: Search, entry: Ranked, others: Sequence[Ranked]) -> tuple[Estimate, ...]:
    """Return an effect's parameters, intervals by a bootstrap over trajectories."""
    segments = search.segments(entry.variants)
    count = len(search.chosen)
    change = sum((other.trial.change for other in others), np.zeros(len(search.evidence.residual)))
    sizes, shapes = [], []
    for _ in range(INTERVAL_DRAWS):
        drawn = search.random.integers(count, size=count).tolist()
        rows = search.evidence.rows_of(drawn)
        evidence = search.evidence.of(drawn)
        evidence = evidence.with_residual(evidence.residual - change[rows])
        base = fit(evidence, _nothing(evidence)).objective
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


def _rows(segment: Segment, rows: NDArray[np.int64]) -> Segment:
    return Segment(
        segment.variant,
        segment.begin,
        segment.offset[rows],
        segment.column[rows],
        segment.low,
        segment.high,
    )


def _stability(search: Search, ranked: Sequence[Ranked], name: str) -> float:
    """Return the share of bootstrap repetitions over trajectories that find the same effect."""
    count = len(search.chosen)
    groups = {e.effect.name: search.segments(e.variants) for e in ranked[:6]}
    same = 0
    for _ in range(BOOTSTRAPS):
        drawn = search.random.integers(count, size=count).tolist()
        rows = search.evidence.rows_of(drawn)
        evidence = search.evidence.of(drawn)
        base = fit(evidence, _nothing(evidence)).objective
        gains = {
            other: best_trial(evidence, [_rows(s, rows) for s in group], base).gain
            for other, group in groups.items()
        }
        same += max(gains, key=lambda other: gains[other]) == name
    return same / BOOTSTRAPS


def _pairs(search: Search, ranked: Sequence[Ranked]) -> tuple[Pair, ...]:
    """Return the pairs of the best effects that are close to each other."""
    top = [e for e in ranked[:6] if np.any(e.trial.change)]
    if len(top) < 2:
        return ()
    columns = np.stack([entry.trial.change for entry in top], axis=1)
    rho, size = cosines(search.evidence, columns), lengths(search.evidence, columns)
    pairs = []
    for i in range(len(top)):
        for j in range(i + 1, len(top)):
            cosine = float(rho[i, j])
            separation = float(max(size[i], size[j]) * np.sqrt((1.0 - abs(cosine)) / 2.0))
            if separation < 3.1 or abs(cosine) > 0.9:
                remedy = "; or ".join(
                    dict.fromkeys((top[i].effect.protocol, top[j].effect.protocol))
                )
                pairs.append(
                    Pair(top[i].effect.name, top[j].effect.name, cosine, separation, remedy)
                )
    return tuple(pairs)


def _change_by_trajectory(search: Search, entries: Sequence[Ranked]) -> list[Array]:
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
    change = _change_by_trajectory(search, named)
    columns = search.case.whitened(change, search.chosen)
    refitted = fit(
        search.evidence.with_residual(search.evidence.residual - columns),
        _nothing(search.evidence),
    )
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
        case, residuals, measured, _skins(search, measured, named), measurement.skin.rest_position_m
    )
    fitted = values_after(case.values, _shared(case), refitted.nuisance[: len(_shared(case))])
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


def _shared(case: Case) -> list[Nuisance]:
    return [n for n in case.nuisances if n.belongs != "own"]


def _calibrated(case: Case, fitted: GelValues, refitted: Fit) -> tuple[Estimate, ...]:
    """Return the nuisances as fitted; the interval is that of their priors."""
    result = []
    for name, moved in zip(case.column_names(), refitted.nuisance.tolist(), strict=True):
        plain = name.removesuffix(" (reference)")
        nuisance = next(n for n in case.nuisances if n.name == plain)
        reach = 1.96 * nuisance.deviation
        if plain in PARAMETERS:
            parameter = PARAMETERS[plain]
            at = parameter.to_coordinate(getattr(case.values, parameter.field))
            ends = sorted(parameter.to_value(at + side * reach) for side in (-1.0, 1.0))
            value = float(getattr(fitted, parameter.field))
            result.append(Estimate(name, parameter.unit, value, ends[0], ends[1]))
        else:
            value = moved * nuisance.deviation
            result.append(Estimate(name, nuisance.unit, value, -reach, reach))
    return tuple(result)


def _skins(
    search: Search, measured: Sequence[int], named: Sequence[Ranked]
) -> Mapping[int, tuple[Array, Array]]:
    """Return skins of the measured trajectories, without and with the effects."""
    effects = [
        Active(e.effect, e.effect.checked(e.trial.variant.values(e.trial.size))) for e in named
    ]
    found = {}
    for number in measured:
        recording = search.case.trajectories[number].recording
        plain = request_of(recording, search.case.values)
        try:
            without = search.solver.run([plain])[0].skin_position_m
            with_effects = without
            if effects:
                request = request_of(recording, search.case.values, effects=effects)
                with_effects = search.solver.run([request])[0].skin_position_m
        except SolveError as error:
            search.warnings.append(f"no picture of {recording.name}: {error}")
            continue
        found[number] = (without, with_effects)
    return found


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
        )
        for e in ranked
    ]
    library = search.case.library
    result += [
        Candidate(name, library[name].title, False, 0.0, library[name].parameters[0].none or 0.0)
        for name in silent
    ]
    return tuple(result)
