# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From screened effects to an answer, by the rule of `decision` (steps 5 to 8 of the method)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dotsim_ros.gap import decision
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.presses.certainty import stability_of
from dotsim_ros.gap.presses.evidence import Segment, Variant
from dotsim_ros.gap.presses.inference import (
    Evidence,
    Fit,
    draw_null,
    fit,
    fit_nuisances,
    log_evidence,
)
from dotsim_ros.gap.presses.locate import is_at_floor, is_off
from dotsim_ros.gap.presses.screening import Screen, Trial, best_trial, try_segment
from dotsim_ros.gap.presses.search_state import Ranked, Search
from dotsim_ros.io.arrays import FloatArray

ROUNDS = 2
"""How often the sizes of the best effects are refined by a solve at the size found."""
PAIR_ROUNDS = 2
SMALL_SHARE = 0.08
"""A size that is nearer to a node than this share of it needs no solve of its own."""


@dataclass(frozen=True)
class Decision:
    """What the rule decides.

    Attributes:
        verdict: the answer.
        named: effects to add.
        alternatives: those not distinguished from the first.
        doubted: what would be named if more bootstrap repetitions over trajectories asked for it:
            one effect, those of a set, or two that would act together.
        are_two: whether the latter.
        stability: share of the repetitions that give what is named, or would be; None without.
    """

    verdict: Verdict
    named: tuple[Ranked, ...] = ()
    alternatives: tuple[Ranked, ...] = ()
    doubted: tuple[Ranked, ...] = ()
    are_two: bool = False
    stability: float | None = None


@dataclass(frozen=True)
class SearchAnswer:
    """What the rule makes of a case.

    Attributes:
        decision: the answer.
        ranked: every effect that was tried, the best first.
        statistic, threshold, p_value: gain and limit of the effect that is named, or comes
            nearest to it.
    """

    decision: Decision
    ranked: list[Ranked]
    statistic: float
    threshold: float
    p_value: float


def set_limits(search: Search, ranked: Sequence[Ranked], gains: FloatArray) -> float:
    """Set the limits of effects; return the threshold of simulated nulls."""
    threshold = decision.threshold_of(gains.tolist(), search.request.alpha)
    for entry in ranked:
        factor = decision.limit_factor(
            entry.effect.name,
            search.discrepancy.limit_factors,
            is_representative=search.discrepancy.is_representative,
        )
        entry.limit = factor * threshold
    return threshold


def answer_of(
    search: Search, ranked: list[Ranked], gains: FloatArray, pattern_gains: FloatArray
) -> SearchAnswer:
    """Apply the rule to a case."""
    alpha = search.request.alpha
    threshold = set_limits(search, ranked, gains)
    heavier = decision.pattern_factor(
        search.discrepancy.pattern_factor,
        is_representative=search.discrepancy.is_representative,
    )
    pattern_threshold = heavier * decision.threshold_of(pattern_gains.tolist(), alpha)
    search.pattern_chance = heavier * float(np.median(pattern_gains))
    is_effect = any(entry.is_past_limit for entry in ranked)
    if is_effect:
        ranked = _refit_beside(search, _refit(search, ranked))
    decided = Decision(Verdict.NO_GAP)
    if is_effect or pattern_gain(search) > pattern_threshold:
        decided = decide(search, ranked)
        for entry in close_to_best(ranked):
            entry.held_out_gain = _held_out_gain(search, entry)
    nearest = decided.named or decided.doubted or ranked
    first = max(nearest, key=lambda entry: entry.trial.gain / entry.limit)
    scale = first.limit / threshold
    p_value = float(np.mean(scale * gains >= first.trial.gain))
    return SearchAnswer(decided, ranked, first.trial.gain, first.limit, p_value)


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


def null_gains(
    search: Search, ranked: Sequence[Ranked], count: int
) -> tuple[FloatArray, FloatArray]:
    """Return, of `count` data without an effect, the largest gain of any, and that of patterns."""
    evidence = search.evidence
    segments = [s for entry in ranked for s in search.segments(entry.variants)]
    effects = Screen(evidence, segments)
    widened = Screen(evidence.with_nuisances(search.pattern_columns))
    gains, patterns = np.zeros(count), np.zeros(count)
    for k in range(count):
        residual = draw_null(evidence, search.random)
        base, by_segment, _ = effects.tries(residual)
        gains[k] = by_segment.max()
        patterns[k] = base - widened.tries(residual)[0]
        search.progress("nulls", k + 1, count)
    return gains, patterns


def pattern_gain(search: Search) -> float:
    """Return what all patterns together gain over the recalibrated twin."""
    widened = search.evidence.with_nuisances(search.pattern_columns)
    return search.base.objective - fit_nuisances(widened).objective


def _refit_beside(search: Search, ranked: list[Ranked]) -> list[Ranked]:
    """Simulate what gains most next to the larger of two effects at the sizes found there; return
    all effects in order. Between sizes that were tried alone, one rival gains more by chance."""
    pair = possible_pair(search, ranked)
    if pair is None:
        return ranked
    _, larger = pair
    others = [entry for entry in ranked if entry.effect.name != larger.effect.name]
    _refit(search, _all_beside(search, larger, others), larger)
    return tried_again(search, ranked)


def _refit(search: Search, ranked: list[Ranked], beside: Ranked | None = None) -> list[Ranked]:
    """Simulate the best effects, alone or beside another one, at the sizes found, again and again;
    return them in order."""
    evidence = search.evidence if beside is None else search.evidence.without(beside.trial.change)
    base = search.base.objective if beside is None else fit_nuisances(evidence).objective

    def tried(variants: Sequence[Variant]) -> Trial:
        return best_trial(evidence, search.segments(variants), base)

    for _ in range(ROUNDS):
        close = close_to_best(ranked)
        wanted: list[tuple[Ranked, Variant, float]] = []
        for entry in close:
            variant, size = _better_variant(search, entry, tried), entry.trial.size
            nearest = min(abs(size - node) for node in variant.node)
            if nearest > SMALL_SHARE * max(abs(size - variant.absent), 1e-12):
                wanted.append((entry, variant, size))
        within = [one for k, one in enumerate(wanted) if search.has_budget(k + 1)]
        if len(within) < len(wanted):
            _warn_once(
                search,
                f"the budget of {search.request.budget} solves of a trajectory was spent before "
                "the best effects were simulated at the sizes found: these are interpolated",
            )
            wanted = within
        if not wanted:
            break
        search.case.extend(
            [(variant, size) for _, variant, size in wanted],
            progress=lambda done, total: search.progress("refit", done, total),
            among=search.chosen,
        )
        for entry, variant, _ in wanted:
            if all(variant is not known for known in entry.variants):
                entry.variants.append(variant)
        for entry in close:
            entry.trial = tried(entry.variants)
        ranked = sorted(ranked, key=lambda entry: entry.trial.gain, reverse=True)
    return ranked


def _warn_once(search: Search, text: str) -> None:
    if text not in search.warnings:
        search.warnings.append(text)


def close_to_best(ranked: Sequence[Ranked]) -> list[Ranked]:
    """Return the effects that are worth a refit."""
    least = ranked[0].trial.gain - decision.CLOSE
    return [
        entry
        for place, entry in enumerate(ranked)
        if place < decision.SCREENED or entry.trial.gain > least
    ]


def _better_variant(
    search: Search, entry: Ranked, tried: Callable[[Sequence[Variant]], Trial]
) -> Variant:
    """Return the variant to simulate next: a new one between the shapes tried, where a parabola
    through their gains has its top; the best one tried where there is no such place."""
    best = entry.trial.variant
    names = list(best.shape)
    if len(names) != 1:
        return best
    name = names[0]
    gains = {variant.shape[name]: tried([variant]).gain for variant in entry.variants}
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
    return variant


def decide(search: Search, ranked: list[Ranked]) -> Decision:
    """Return what the rule makes of effects. One that is named beyond its usual size takes its own
    place in the ranking."""
    for entry in close_to_best(ranked):
        entry.explained = _explained(search, [entry])
    able = [entry for entry in ranked if entry.is_past_limit]
    if not able:
        return Decision(Verdict.UNKNOWN)
    best = able[0]
    doubted = Decision(Verdict.UNKNOWN)
    pair = best_pair(search, ranked)
    if pair is not None:
        further = _gain(search, pair) - _gain(search, [best])
        if further > decision.FURTHER * _left(search, [best]):
            stability = stability_of(search, ranked, pair)
            if stability >= decision.LIKELY:
                return _two(search, pair, stability)
            # Two that too few repetitions ask for are one, and what its law is off by.
            doubted = Decision(
                Verdict.UNKNOWN, doubted=tuple(pair), are_two=True, stability=stability
            )
    single = _single(search, ranked, able, doubted)
    both = pair_instead(search, ranked) if single.verdict is Verdict.UNKNOWN else None
    return both or single


def tried_again(search: Search, ranked: Sequence[Ranked]) -> list[Ranked]:
    """Return effects in their order on another search's evidence, at sizes between those that were
    simulated."""
    evidence, base = search.evidence, search.base.objective
    tried = [
        replace(entry, trial=best_trial(evidence, search.segments(entry.variants), base))
        for entry in ranked
    ]
    return sorted(tried, key=lambda entry: entry.trial.gain, reverse=True)


def pair_instead(search: Search, ranked: Sequence[Ranked]) -> Decision | None:
    """Return two effects to name where a single one fails a check, None where no two do: next to
    each other each gains more than its limit, both explain the gap, most repetitions ask for them,
    and they leave nothing of a gap that held-out trajectories have. The smaller one comes first,
    with those that are not distinguished from it there."""
    pair = possible_pair(search, ranked) if search.held_out else None
    if pair is None:
        return None
    smaller, larger = pair
    rivals = [smaller, *rivals_beside(search, ranked, pair)]
    # As for one effect: what asks for a size beyond its range is a symptom.
    possible = [one for one in rivals if size_beyond_range(search, one, larger) is None]
    if not possible:
        return None
    named, *alternatives = possible
    symptoms = {one.effect.name for one in rivals} - {one.effect.name for one in possible}
    contest = [entry for entry in ranked if entry.effect.name not in symptoms]
    stability = stability_of(search, contest, [named, larger], alternatives)
    if stability < decision.LIKELY:
        return None
    both = _two(search, [named, larger], stability)
    if both.named and alternatives:
        both = replace(both, verdict=Verdict.SET, alternatives=tuple(alternatives))
    # Where there is no gap, two more effects leave none either.
    is_shown = both.named and is_off(search, both.named) and is_at_floor(search, both.named)
    return both if is_shown else None


def _single(
    search: Search, ranked: list[Ranked], able: Sequence[Ranked], doubted: Decision
) -> Decision:
    """Return whether one of the effects past their limits can be named, or a set; what is doubted
    where none can."""
    best = able[0]
    close = [best, *_rivals(search, best, able)]
    # One that asks for a size beyond its range is a symptom; what explains as much may stand.
    possible = [entry for entry in close if size_beyond_range(search, entry) is None]
    if not possible:
        opened = _opened(search, best)
        if opened is not None:
            ranked[ranked.index(best)] = opened
            possible = [opened]
    if not possible or (possible[0].explained or 0.0) < decision.EXPLAINED:
        return doubted
    named, *alternatives = possible
    contest = [entry for entry in ranked if entry not in close or entry in possible]
    stability = stability_of(search, contest, [named], alternatives)
    if stability < decision.LIKELY:
        return Decision(Verdict.UNKNOWN, doubted=tuple(possible), stability=stability)
    verdict = Verdict.SET if alternatives else Verdict.NAMED
    return Decision(verdict, (named,), tuple(alternatives), stability=stability)


def _two(search: Search, pair: Sequence[Ranked], stability: float) -> Decision:
    """Return whether two effects can be named together."""
    first, second = pair
    is_implausible = any(
        size_beyond_range(search, entry, other) is not None
        for entry, other in ((first, second), (second, first))
    )
    if is_implausible or _explained(search, pair) < decision.EXPLAINED:
        return Decision(Verdict.UNKNOWN)
    return Decision(Verdict.NAMED, tuple(pair), stability=stability)


def size_beyond_range(search: Search, entry: Ranked, other: Ranked | None = None) -> float | None:
    """Return the size beyond its plausible range that the data ask an effect for, None where they
    are explained as well within.

    Args:
        search: the case.
        entry: the effect, as it was found within its range.
        other: another one that acts, too; None for none.
    """
    end = entry.end
    if end is None:
        return None
    evidence = search.evidence if other is None else search.evidence.without(other.trial.change)
    variant = entry.trial.variant
    above = end > variant.absent
    outermost = search.segments([variant])[-1 if above else 0]
    further = variant.effect.parameters[0].beyond(end) - end
    opened = replace(
        outermost,
        low=outermost.low + min(further, 0.0),
        high=outermost.high + max(further, 0.0),
    )
    base = fit_nuisances(evidence).objective
    found = try_segment(evidence, opened, base)
    within = try_segment(evidence, outermost, base)
    return found.size if found.gain - within.gain > decision.SAME else None


def _opened(search: Search, entry: Ranked) -> Ranked | None:
    """Return an effect that is simulated at the size beyond its plausible range that the data ask
    for; None where that does not explain the gap or leaves something of the held-out trajectories,
    where the data ask for yet more, and where nothing can be simulated or is held out."""
    if not search.held_out or not search.has_budget(1):
        return None
    size, *shape = entry.effect.parameters
    effect = replace(entry.effect, parameters=(size.opened, *shape))
    known = entry.trial.variant
    variant = Variant(effect, known.shape, [*known.node], [*known.change])
    trial = best_trial(search.evidence, search.segments([variant]), search.base.objective)
    (found,) = _refit(search, [replace(entry, effect=effect, variants=[variant], trial=trial)])
    if size_beyond_range(search, found) is not None:
        return None
    found.explained = _explained(search, [found])
    is_whole = found.explained >= decision.EXPLAINED and is_at_floor(search, [found])
    return found if is_whole else None


def _explained(search: Search, entries: Sequence[Ranked]) -> float:
    """Return the share that effects have of what they gain and of the gap that they leave."""
    gained = _gain(search, entries)
    return float(np.clip(gained / max(gained + _left(search, entries), 1e-9), 0.0, 1.0))


def _gain(search: Search, entries: Sequence[Ranked]) -> float:
    """Return what effects gain together, each at up to 1.3 of the size found."""
    return search.base.objective - _fit_of(search.evidence, entries).objective


def _left(search: Search, entries: Sequence[Ranked]) -> float:
    """Return the gap that effects leave: what patterns could remove next to them, if skin and force
    need not agree about an effect's size, or by how much more the data differ than data without any
    effect, whichever is more."""
    evidence = search.evidence
    own = _fit_of(evidence, entries).objective
    widened = evidence.with_nuisances(search.pattern_columns)
    everything = _fit_by_channel(widened, _by_channel(search, entries)).objective
    # What patterns remove of noise alone is not a gap.
    by_patterns = own - everything - search.pattern_chance
    misfit = own - search.misfit_limit * len(evidence.residual)
    return max(by_patterns, misfit, 0.0)


def _fit_of(evidence: Evidence, entries: Sequence[Ranked]) -> Fit:
    columns = np.stack([entry.trial.change for entry in entries], axis=1)
    return fit(evidence, columns, np.zeros(len(entries)), np.full(len(entries), 1.3))


def _by_channel(search: Search, entries: Sequence[Ranked]) -> FloatArray:
    """Return (n, 2 k) what k effects of the size found do to the skin alone and to the force alone,
    in turn."""
    columns = [
        search.case.channel_columns(entry.trial.variant, entry.trial.size, search.chosen)
        for entry in entries
    ]
    return np.concatenate(columns, axis=1)


def _fit_by_channel(evidence: Evidence, columns: FloatArray) -> Fit:
    """Return the fit of effects whose sizes in the skin need not be those in the force."""
    high = np.full(columns.shape[1], decision.LARGEST_IN_CHANNEL)
    return fit(evidence, columns, np.zeros(len(high)), high)


def sizes_by_channel(search: Search, entry: Ranked) -> tuple[float, float] | None:
    """Return the size of an effect as the skin gives it and as the force does, None where they do
    not disagree, or one of them says nothing of it."""
    columns = _by_channel(search, [entry])
    if not columns.any(axis=0).all():
        return None
    found = _fit_by_channel(search.evidence, columns)
    if _fit_of(search.evidence, [entry]).objective - found.objective < decision.SAME:
        return None
    variant, size = entry.trial.variant, entry.trial.size
    skin, force = (variant.absent + share * (size - variant.absent) for share in found.size)
    return float(skin), float(force)


def best_pair(
    search: Search, ranked: Sequence[Ranked], other_law: float = decision.OTHER_LAW
) -> list[Ranked] | None:
    """Return the two effects that gain most together, None unless each gains more next to the other
    than its limit and what the other's law may be off by, a share of the other's gain.

    The one that gains most alone need not be of them: it may be what the two look like together.
    """
    if len(ranked) < 2:
        return None
    pairs = []
    for first in close_to_best(ranked):
        second = _beside(search, first, [entry for entry in ranked if entry is not first])
        pair = [first, second]
        for _ in range(PAIR_ROUNDS):
            # Each at the size that it has next to the other.
            pair = [_beside(search, pair[1], [pair[0]]), _beside(search, pair[0], [pair[1]])]
        pairs.append(pair)
    best = max(pairs, key=lambda pair: _gain(search, pair))
    first, second = best
    is_needed = all(
        entry.trial.gain > entry.limit + other_law * other.trial.gain
        for entry, other in ((first, second), (second, first))
    )
    return best if is_needed else None


def possible_pair(search: Search, ranked: Sequence[Ranked]) -> list[Ranked] | None:
    """Return the two effects that gain most together, each more than its limit, the one that gains
    less first; None where there are none."""
    pair = best_pair(search, ranked, other_law=0.0)
    return None if pair is None else sorted(pair, key=lambda entry: entry.trial.gain)


def rivals_beside(search: Search, ranked: Sequence[Ranked], pair: Sequence[Ranked]) -> list[Ranked]:
    """Return the effects past their limits that are not distinguished from the first of a pair next
    to the second, as they do there, the best first."""
    _, second = pair
    others = [entry for entry in ranked if entry.effect.name != second.effect.name]
    return _rivals(search, pair[0], _all_beside(search, second, others))


def _rivals(search: Search, named: Ranked, tried: Sequence[Ranked]) -> list[Ranked]:
    """Return those past their limits that are not distinguished from an effect, the best first: by
    as much as true data gain more than simulated ones, their gains differ by more."""
    least = named.trial.gain - decision.SAME * search.least_factor
    return [
        entry
        for entry in tried
        if entry.is_past_limit
        and entry.trial.gain > least
        and entry.effect.name != named.effect.name
    ]


def _beside(search: Search, known: Ranked, others: Sequence[Ranked]) -> Ranked:
    """Return that of the others which gains most next to a known effect, as it does there."""
    return _all_beside(search, known, others)[0]


def _all_beside(search: Search, known: Ranked, others: Sequence[Ranked]) -> list[Ranked]:
    """Return others as they are next to a known effect, the one that gains most first."""
    evidence = search.evidence.without(known.trial.change)
    base = fit_nuisances(evidence).objective
    tried = [
        replace(entry, trial=best_trial(evidence, search.segments(entry.variants), base))
        for entry in others
    ]
    return sorted(tried, key=lambda entry: entry.trial.gain, reverse=True)


def _held_out_gain(search: Search, entry: Ranked) -> float:
    """Return what an effect gains of the log score, in nats, of trajectories that were left out,
    each in turn, its size and the nuisances as uncertain as the others leave them.

    The score of one trajectory is the log of the probability of all data less that of the others
    (Dawid 1984). A size that the others do not identify costs little, one that they contradict
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
            [s.of_rows(search.evidence.rows_of(kept)) for s in segments],
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
