# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The rule on drawn data of known truth: one effect that shows in skin and force."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dotsim_ros.data.recording import Phase
from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter
from dotsim_ros.effects.overlay import FoundEffect, Overlay, active_effects
from dotsim_ros.gap import decision
from dotsim_ros.gap.decision import EXPLAINED
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.presses import answer as answer_module
from dotsim_ros.gap.presses import locate
from dotsim_ros.gap.presses.answer import (
    SearchAnswer,
    answer_of,
    decide,
    null_gains,
    screen,
    set_limits,
    size_beyond_range,
    sizes_by_channel,
    tried_again,
)
from dotsim_ros.gap.presses.assumptions import SHARED, PressNuisance
from dotsim_ros.gap.presses.certainty import estimates_of, stability_of
from dotsim_ros.gap.presses.conclusions import is_other_answer, leaves_open
from dotsim_ros.gap.presses.covariance import ChannelNoise, Discrepancy, Whitening
from dotsim_ros.gap.presses.evidence import Case, EvidenceTrajectory, Variant
from dotsim_ros.gap.presses.locate import Closed, Residuals, share_closed
from dotsim_ros.gap.presses.observables import PATCH_COUNT, SIZE
from dotsim_ros.gap.presses.search_state import GapRequest, Ranked, Search
from dotsim_ros.gap.report import wording
from studies.gap.baselines import bic_name

TRAJECTORIES, FRAMES, NULLS = 6, 3, 60
SHAPE = (FRAMES, SIZE)
OF_FORCE = np.arange(SIZE) >= 3 * PATCH_COUNT
DEVIATION = np.where(OF_FORCE, 3.0, 0.5)
"""Of what the effect does at its full size, in deviations of the noise."""
EFFECT = Effect(
    "late",
    "Late",
    (EffectParameter("size", "s", 0.0, 0.0, 1.0, (1.0,)),),
    (SKIN, FORCE),
    "",
    bool,
)


def trajectory_of(observed: np.ndarray, random: np.random.Generator) -> EvidenceTrajectory:
    used = np.ones(SHAPE, dtype=bool)
    return EvidenceTrajectory(
        recording=None,
        is_reference=False,
        places=None,
        observed=observed,
        predicted=np.zeros(SHAPE),
        whitening=Whitening(used, np.eye(used.sum())),
        nuisance=random.standard_normal((1, *SHAPE)),
        pattern=0.01 * random.standard_normal((2, *SHAPE)),
    )


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.fixture
def change(random: np.random.Generator) -> list[np.ndarray]:
    """Return (F, SIZE) of each trajectory: what the effect does at its full size."""
    return [DEVIATION * random.standard_normal(SHAPE) for _ in range(TRAJECTORIES)]


def variant_of(change: list[np.ndarray], effect: Effect = EFFECT) -> Variant:
    variant = Variant(effect, {})
    variant.put(0.0, [np.zeros(SHAPE) for _ in change])
    variant.put(1.0, change)
    return variant


def case_of(observed: list[np.ndarray], random: np.random.Generator) -> Case:
    trajectories = [trajectory_of(one, random) for one in observed]
    # Sizes are not refined: the effect is linear, and there is nothing to solve.
    nuisances = [PressNuisance("E", "log", 0.1, SHARED)]
    nothing = SimpleNamespace(asked_count=0)
    return Case(trajectories, nuisances, {EFFECT.name: EFFECT}, nothing, None, None)


def search_of(
    change: list[np.ndarray], skin: float, force: float, random: np.random.Generator
) -> Search:
    """Return a search of data that show the effect at one size in the skin, at one in the force."""
    share = np.where(OF_FORCE, force, skin)
    observed = [share * one + random.standard_normal(SHAPE) for one in change]
    return Search(
        GapRequest(Path(), None, Path(), budget=0),
        case_of(observed, random),
        list(range(TRAJECTORIES)),
        [],
        ChannelNoise(),
        Discrepancy(np.eye(SIZE), np.eye(SIZE), "drawn"),
        random,
        lambda step, done, total: None,
    )


def answered(search: Search, change: list[np.ndarray], effect: Effect = EFFECT) -> SearchAnswer:
    ranked = screen(search, [variant_of(change, effect)])
    return answer_of(search, ranked, *null_gains(search, ranked, NULLS))


def test_an_effect_of_one_size_in_skin_and_force_is_named(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    search = search_of(change, 0.8, 0.8, random)
    answer = answered(search, change)
    assert answer.decision.verdict is Verdict.NAMED
    assert [entry.effect.name for entry in answer.decision.named] == ["late"]
    assert answer.decision.named[0].trial.size == pytest.approx(0.8, abs=0.1)
    assert answer.decision.named[0].explained == pytest.approx(1.0, abs=0.05)
    assert sizes_by_channel(search, answer.decision.named[0]) is None


def test_the_information_criterion_names_what_gains_more_than_its_price(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    for share, name in ((0.0, None), (0.8, "late")):
        search = search_of(change, share, share, random)
        assert bic_name(search, screen(search, [variant_of(change)])) == name


Direction = tuple[list[np.ndarray], list[np.ndarray]]


def shaped(direction: Direction, time: float) -> list[np.ndarray]:
    """Return what an effect does at its full size: its shape turns it to another direction."""
    along, across = np.cos(np.log(time)), np.sin(np.log(time))
    return [along * one + across * other for one, other in zip(*direction, strict=True)]


class ShapedCase(Case):
    """Effects that are simulated by a formula."""

    directions: dict[str, Direction]

    def _fill(self, wanted, progress=None):  # type: ignore[no-untyped-def]
        for variant, size, numbers in wanted:
            full = shaped(self.directions[variant.effect.name], variant.shape["time"])
            change = variant.change[variant.node.index(size)]
            for number in numbers:
                change[number] = size * full[number]
            self.solver.asked_count += len(numbers)
        return []


@pytest.mark.parametrize(("budget", "most"), [(None, 6), (1, 1), (0, 0)])
def test_a_shape_between_those_tried_is_simulated_where_there_is_budget_for_it(
    random: np.random.Generator, budget: int | None, most: int
) -> None:
    time = EffectParameter("time", "s", None, 0.1, 10.0, (0.3, 1.0, 3.0))
    names = ("first", "second")
    library = {
        name: replace(EFFECT, name=name, parameters=(*EFFECT.parameters, time)) for name in names
    }

    def drawn() -> list[np.ndarray]:
        return [DEVIATION * random.standard_normal(SHAPE) for _ in range(TRAJECTORIES)]

    directions = {name: (drawn(), drawn()) for name in names}
    first, second = (shaped(directions[name], 1.4) for name in names)
    observed = [
        0.8 * one + 0.4 * other + random.standard_normal(SHAPE)
        for one, other in zip(first, second, strict=True)
    ]
    solver = SimpleNamespace(asked_count=0)
    plain = case_of(observed, random)
    case = ShapedCase(plain.trajectories, plain.nuisances, library, solver, None, None)
    case.directions = directions
    variants = [variant for effect in library.values() for variant in case.variants(effect)]
    case.extend([(variant, 1.0) for variant in variants])
    solver.asked_count = 0
    search = replace(search_of(first, 0.0, 0.0, random), case=case)
    search.request = replace(search.request, budget=budget)
    ranked = screen(search, variants)
    answer = answer_of(search, ranked, *null_gains(search, ranked, NULLS))
    tried = [variant for entry in answer.ranked for variant in entry.variants]
    assert min(most, 1) <= len(tried) - len(variants) <= most
    assert all(len(variant.node) > 1 for variant in tried)
    assert answer.ranked[0].effect.name == "first"
    if budget != 0:
        assert answer.ranked[0].trial.variant.shape["time"] == pytest.approx(1.4, rel=0.2)


@pytest.mark.parametrize(("skin", "force"), [(0.8, 0.0), (0.0, 0.8)])
def test_what_looks_like_an_effect_in_one_channel_alone_is_unknown(
    change: list[np.ndarray], random: np.random.Generator, skin: float, force: float
) -> None:
    search = search_of(change, skin, force, random)
    answer = answered(search, change)
    assert answer.statistic > answer.threshold
    assert answer.decision.verdict is Verdict.UNKNOWN
    assert answer.decision.named == ()
    sizes = sizes_by_channel(search, answer.ranked[0])
    assert sizes == pytest.approx((skin, force), abs=0.1)
    reason = wording.disagreeing(EFFECT.parameters[0], *sizes)
    text = wording.unknown("the skin at the rim", [EFFECT], [reason])
    told, other = (f"{size:.2g} s" for size in sizes)
    assert f"late, but the skin gives size = {told} and the force {other}: they should" in text


@pytest.mark.parametrize(("size", "natural_ends"), [(1.01, ()), (1.3, ()), (1.3, (1.0,))])
def test_an_effect_is_not_named_where_the_data_ask_for_more_than_it_can_be(
    change: list[np.ndarray],
    random: np.random.Generator,
    size: float,
    natural_ends: tuple[float, ...],
) -> None:
    parameter = replace(EFFECT.parameters[0], natural_ends=natural_ends)
    effect = replace(EFFECT, parameters=(parameter,))
    search = search_of(change, size, size, random)
    search.case.library = {effect.name: effect}
    answer = answered(search, change, effect)
    nearest = answer.ranked[0]
    # Each explains enough.
    assert nearest.explained is not None
    assert nearest.explained > EXPLAINED
    assert nearest.trial.size == pytest.approx(min(size, 1.0), abs=0.05)
    beyond = size_beyond_range(search, nearest)
    if size < 1.2 or natural_ends:
        assert beyond is None
        assert answer.decision.verdict is Verdict.NAMED
        return
    assert beyond == pytest.approx(size, abs=0.1)
    assert answer.decision.verdict is Verdict.UNKNOWN
    assert answer.decision.named == ()
    text = wording.unknown("the skin", [effect], [wording.asked("data", parameter, beyond)])
    assert "The nearest is: late, but the data ask for size = 1.3 s, and its plausible" in text


@pytest.mark.parametrize(
    ("closed", "is_open"),
    [
        (Closed(0.3, -0.3, 0.8, 2.0, 2), True),
        (Closed(0.7, 0.3, 0.9, 2.0, 2), False),
        # All of it may be closed.
        (Closed(0.3, -0.3, 1.0, 2.0, 2), False),
        # One trajectory is no rule, whatever its interval, and it may have none.
        (Closed(-2.4, -2.4, -2.4, 1.4, 1), False),
        (Closed(-2.4, None, None, 1.4, 1), False),
        # There is hardly a gap.
        (Closed(0.3, -0.3, 0.8, 1.1, 2), False),
    ],
)
def test_a_clear_gap_of_held_out_trajectories_is_to_be_closed(
    closed: Closed, is_open: bool
) -> None:
    assert leaves_open(closed) is is_open


def test_the_share_that_is_closed_is_that_beyond_the_floor(random: np.random.Generator) -> None:
    def of(*sizes: float) -> list[np.ndarray]:
        return [np.full(SHAPE, size) for size in sizes]

    residuals = Residuals(of(3.0, 3.0), of(3.0, 3.0), of(2.0, 2.9), of(1.0, 1.0))
    closed = share_closed(residuals, [0], random)
    assert closed is not None
    assert closed.share == pytest.approx((9.0 - 4.0) / (9.0 - 1.0))
    assert closed.before == pytest.approx(3.0)
    # One trajectory tells nothing of how others differ from it.
    assert (closed.low, closed.high) == (None, None)
    # What the effects do not move says nothing of them.
    assert share_closed(residuals, [1], random) is None
    told = wording.unknown("the skin", [EFFECT], [wording.left_open(1, 0.28)])
    assert "The nearest is: late, but it closes 28% of the held-out trajectories' gap." in told
    both = [EFFECT, replace(EFFECT, title="Slip")]
    told = wording.unknown("the skin", both, [wording.left_open(2, 0.28)])
    assert "The nearest is: late and slip, but together they close 28% of the held-out" in told


def test_a_size_at_the_end_of_its_range_is_one_that_the_sensor_takes(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    parameter = EffectParameter("ratio", "", 1.0, 0.1, 5.0, (0.6, 1.6))
    effect = replace(EFFECT, parameters=(parameter,))
    search = search_of([-part for part in change], 1.5, 1.5, random)
    search.case.library = {effect.name: effect}
    variant = Variant(effect, {})
    for size in (0.6, 1.0, 1.6):
        variant.put(size, [(size - 1.0) * part for part in change])
    entry = screen(search, [variant])[0]
    # A node and a step: 0.6 + (0.1 - 0.6) is a rounding below 0.1.
    assert entry.trial.size < parameter.low
    estimates = estimates_of(search, entry, ())
    assert parameter.low <= estimates[0].low <= estimates[0].value <= estimates[0].high
    found = FoundEffect(effect.name, estimates)
    active = active_effects(Overlay("sensor", "", (found,)), {effect.name: effect})
    assert active[0].values == {"ratio": 0.1}


def test_a_run_that_finds_its_solves_on_disk_has_the_same_budget(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    search = search_of(change, 0.5, 0.5, random)
    search.request = replace(search.request, budget=20)
    for asked, solved in ((15 * TRAJECTORIES, 0), (15 * TRAJECTORIES, 90)):
        search.case.solver = SimpleNamespace(asked_count=asked, solve_count=solved)
        assert search.has_budget(5)
        assert not search.has_budget(6)


def test_a_name_is_stable_where_every_trajectory_shows_it_and_not_where_one_does(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    everywhere = answered(search_of(change, 0.8, 0.8, random), change)
    assert everywhere.decision.stability == 1.0
    # One trajectory of six shows it, however clearly: where that counts little it is not seen.
    search = search_of(change, 0.0, 0.0, random)
    shown = [one if k == 0 else np.zeros_like(one) for k, one in enumerate(change)]
    observed = [0.5 * one + random.standard_normal(SHAPE) for one in shown]
    search = replace(search, case=case_of(observed, random))
    ranked = screen(search, [variant_of(shown)])
    (entry,) = ranked
    # So far above its limit that only a small weight keeps it below.
    entry.limit = 0.3 * entry.trial.gain
    assert 0.5 < stability_of(search, ranked, [entry]) < 0.98


@pytest.mark.parametrize(("share", "expected"), [(0.5, {"early", "late"}), (0.8, {"early"})])
def test_two_effects_are_named_where_enough_repetitions_ask_for_both(
    change: list[np.ndarray],
    random: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    share: float,
    expected: set[str],
) -> None:
    # The second effect shows along one trajectory of six: in two thirds of the repetitions.
    other = [np.zeros(SHAPE) for _ in range(TRAJECTORIES)]
    other[3] = DEVIATION * random.standard_normal(SHAPE)
    early = replace(EFFECT, name="early")
    observed = [
        0.25 * first + 0.65 * second + random.standard_normal(SHAPE)
        for first, second in zip(change, other, strict=True)
    ]
    case = case_of(observed, random)
    case.library = {"late": EFFECT, "early": early}
    search = replace(search_of(change, 0.0, 0.0, random), case=case)
    ranked = screen(search, [variant_of(change), variant_of(other, early)])
    monkeypatch.setattr(decision, "LIKELY", share)
    answer = answer_of(search, ranked, *null_gains(search, ranked, NULLS))
    assert {entry.effect.name for entry in answer.decision.named} == expected


def test_what_too_few_repetitions_ask_for_is_told_as_undecided(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    # One trajectory of six shows it, hardly enough.
    shown = [one if k == 3 else np.zeros(SHAPE) for k, one in enumerate(change)]
    observed = [0.45 * one + random.standard_normal(SHAPE) for one in shown]
    search = replace(search_of(change, 0.0, 0.0, random), case=case_of(observed, random))
    answer = answered(search, shown)
    assert answer.statistic > answer.threshold
    assert answer.decision.stability is not None
    assert answer.decision.stability < decision.LIKELY
    assert (answer.decision.verdict, answer.decision.named) == (Verdict.UNKNOWN, ())
    doubted = answer.decision.doubted
    assert [entry.effect.name for entry in doubted] == ["late"]
    text = wording.not_decided(
        [entry.effect for entry in doubted],
        are_two=answer.decision.are_two,
        stability=answer.decision.stability,
        place="the rim",
    )
    assert text.startswith("Not decided")
    assert f"late. Only {answer.decision.stability:.0%} of bootstrap repetitions" in text


def test_a_symptom_does_not_compete_with_what_is_named_in_its_place(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    # The first may be 0.5 at most, where the data ask for more of it; the second, which does much
    # the same, gains nearly as much, and within its range.
    first = replace(EFFECT, parameters=(EffectParameter("size", "s", 0.0, 0.0, 0.5, (0.5,)),))
    second = replace(EFFECT, name="second")
    observed = [0.6 * one + random.standard_normal(SHAPE) for one in change]
    other = [one + 0.36 * DEVIATION * random.standard_normal(SHAPE) for one in change]
    case = case_of(observed, random)
    case.library = {"late": first, "second": second}
    search = replace(search_of(change, 0.0, 0.0, random), case=case)
    narrow = Variant(first, {})
    narrow.put(0.0, [np.zeros(SHAPE) for _ in change])
    narrow.put(0.5, [0.5 * one for one in change])
    ranked = screen(search, [narrow, variant_of(other, second)])
    answer = answer_of(search, ranked, *null_gains(search, ranked, NULLS))
    symptom, named = answer.ranked
    assert symptom.effect.name == "late"
    assert 0.0 < symptom.trial.gain - named.trial.gain < decision.SAME
    assert [entry.effect.name for entry in answer.decision.named] == ["second"]
    # Against the symptom it would win half of the repetitions.
    assert answer.decision.stability == 1.0
    assert stability_of(search, answer.ranked, [named]) < decision.LIKELY


class LinearCase(Case):
    """An effect that is simulated by a formula: what it does at its full size, times its size."""

    full: list[np.ndarray]

    def _fill(self, wanted, progress=None):  # type: ignore[no-untyped-def]
        for variant, size, numbers in wanted:
            change = variant.change[variant.node.index(size)]
            for number in numbers:
                change[number] = size * self.full[number]
        return []


@pytest.mark.parametrize(
    ("true", "nothing_left", "named"),
    [
        (1.6, True, 1.6),
        # As likely as what is beyond the opened range, by 3.1 deviations.
        (2.01, True, 2.0),
        (2.2, True, None),
        (1.6, False, None),
    ],
)
def test_a_size_beyond_the_usual_is_named_where_it_leaves_nothing_held_out(
    change: list[np.ndarray],
    random: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    true: float,
    nothing_left: bool,
    named: float | None,
) -> None:
    monkeypatch.setattr(answer_module, "is_at_floor", lambda search, entries: nothing_left)
    search = search_of(change, true, true, random)
    search.case.__class__ = LinearCase
    search.case.full = change
    search.held_out = [0]
    search.request = replace(search.request, budget=None)
    answer = answered(search, change)
    decided = answer.decision
    if named is None:
        assert (decided.verdict, decided.named) == (Verdict.UNKNOWN, ())
        return
    (entry,) = decided.named
    assert answer.ranked == [entry]
    assert entry.trial.size == pytest.approx(named, abs=0.05)
    assert "size is beyond the usual, 0 to 1 s" in wording.beyond_usual(EFFECT, entry.trial.size)
    # The live sensor takes it.
    entry.estimates = estimates_of(search, entry, ())
    overlay = Overlay("sensor", "", (FoundEffect("late", entry.estimates),))
    assert active_effects(overlay, {"late": EFFECT})[0].values["size"] == entry.trial.size


@pytest.mark.parametrize(
    ("before", "left", "is_off", "is_at_floor"),
    [(1.6, 1.4, True, True), (1.6, 1.6, True, False), (1.1, 1.0, False, True)],
)
def test_held_out_trajectories_are_off_and_at_the_floor_in_every_place(
    change: list[np.ndarray],
    random: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    before: float,
    left: float,
    is_off: bool,
    is_at_floor: bool,
) -> None:
    search = replace(search_of(change, 0.0, 0.0, random), held_out=[0, 1])
    phases = [Phase.LOAD, Phase.LOAD, Phase.SLIDE]
    search.case.trajectories = [
        replace(t, recording=SimpleNamespace(name=f"press_{k}", phase=phases))
        for k, t in enumerate(search.case.trajectories)
    ]
    ones = [np.ones(SHAPE) for _ in range(TRAJECTORIES)]
    after = [0.5 * one for one in ones]
    # In one phase of the force alone, of one trajectory.
    after[0][2, OF_FORCE] = left
    gap = [before * one for one in ones]
    residuals = Residuals(gap, gap, after, ones)
    monkeypatch.setattr(locate, "with_effects", lambda search, entries: (residuals, None))
    assert locate.is_off(search, []) is is_off
    assert locate.is_at_floor(search, []) is is_at_floor


def two_effects(
    change: list[np.ndarray], random: np.random.Generator
) -> tuple[Search, list[Ranked]]:
    """Return a search of a large effect, and of one that gains hardly a tenth as much."""
    other = [DEVIATION * random.standard_normal(SHAPE) for _ in change]
    observed = [
        one + 0.2 * second + random.standard_normal(SHAPE)
        for one, second in zip(change, other, strict=True)
    ]
    early = replace(EFFECT, name="early")
    case = case_of(observed, random)
    case.library = {"late": EFFECT, "early": early}
    search = replace(search_of(change, 0.0, 0.0, random), case=case)
    return search, screen(search, [variant_of(change), variant_of(other, early)])


@pytest.mark.parametrize("nothing_left", [True, False])
def test_two_are_named_in_place_of_one_that_fails_where_they_leave_nothing_held_out(
    change: list[np.ndarray],
    random: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    nothing_left: bool,
) -> None:
    monkeypatch.setattr(answer_module, "is_off", lambda search, entries: True)
    monkeypatch.setattr(answer_module, "is_at_floor", lambda search, entries: nothing_left)
    search, ranked = two_effects(change, random)
    # The second does not gain a tenth of the first.
    assert len(answer_of(search, ranked, *null_gains(search, ranked, NULLS)).decision.named) == 1
    assert answer_module.pair_instead(search, ranked) is None
    search.held_out = [0]
    both = answer_module.pair_instead(search, ranked)
    if not nothing_left:
        assert both is None
        return
    assert both is not None
    assert {entry.effect.name for entry in both.named} == {"late", "early"}


class CurvedCase(Case):
    """Two effects of which one is simulated as linear in its size, the other as quadratic."""

    full: dict[str, list[np.ndarray]]

    def _fill(self, wanted, progress=None):  # type: ignore[no-untyped-def]
        for variant, size, numbers in wanted:
            name = variant.effect.name
            for number in numbers:
                done = size**2 if name == "early" else size
                variant.change[variant.node.index(size)][number] = done * self.full[name][number]
        return []


def test_the_smaller_of_two_is_simulated_at_the_size_that_it_has_next_to_the_other(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    search, ranked = two_effects(change, random)
    variants = [entry.variants[0] for entry in ranked]
    # Alone, these gain more than the smaller one.
    for name in ("first", "second", "third"):
        alike = [one + 0.5 * DEVIATION * random.standard_normal(SHAPE) for one in change]
        variants.append(variant_of(alike, replace(EFFECT, name=name)))
        search.case.library[name] = variants[-1].effect
    search.request = replace(search.request, budget=None)
    search.case.__class__ = CurvedCase
    search.case.full = {variant.effect.name: variant.change[1] for variant in variants}
    ranked = screen(search, variants)
    assert "early" not in {entry.effect.name for entry in ranked[: decision.SCREENED]}
    answer = answer_of(search, ranked, *null_gains(search, ranked, NULLS))
    early = next(entry for entry in answer.ranked if entry.effect.name == "early")
    pair = answer_module.possible_pair(search, answer.ranked)
    assert pair is not None
    assert pair[0].effect is early.effect
    assert pair[0].trial.size == pytest.approx(np.sqrt(0.2), abs=0.05)


def test_the_smaller_of_two_comes_with_what_cannot_be_distinguished_from_it(
    change: list[np.ndarray], random: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(answer_module, "is_off", lambda search, entries: True)
    monkeypatch.setattr(answer_module, "is_at_floor", lambda search, entries: True)
    search, ranked = two_effects(change, random)
    early = next(entry for entry in ranked if entry.effect.name == "early")
    full = [one + 0.1 * random.standard_normal(SHAPE) for one in early.variants[0].change[1]]
    echo = variant_of(full, replace(EFFECT, name="echo", title="Echo"))
    search.case.library["echo"] = echo.effect
    ranked = screen(search, [*(entry.variants[0] for entry in ranked), echo])
    set_limits(search, ranked, np.full(NULLS, 1.0))
    search.held_out = [0]
    both = answer_module.pair_instead(search, ranked)
    assert both is not None
    assert both.verdict is Verdict.SET
    smaller, larger = both.named
    assert larger.effect.name == "late"
    assert {smaller.effect.name, both.alternatives[0].effect.name} == {"early", "echo"}
    # Each of the two takes repetitions from the other.
    assert both.stability == 1.0
    assert stability_of(search, ranked, both.named) < 0.9
    sentence = wording.missing(
        [(entry.effect, ()) for entry in both.named], [echo.effect], [], is_held_out=True
    )
    assert sentence.endswith("The data do not distinguish late from: Echo.")


def test_an_answer_hangs_on_the_one_trajectory_that_shows_it(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    shown = [one if k == 3 else np.zeros(SHAPE) for k, one in enumerate(change)]
    observed = [0.9 * one + random.standard_normal(SHAPE) for one in shown]
    search = replace(search_of(change, 0.0, 0.0, random), case=case_of(observed, random))
    ranked = screen(search, [variant_of(shown)])
    answer = answer_of(search, ranked, *null_gains(search, ranked, NULLS))
    assert [entry.effect.name for entry in answer.decision.named] == ["late"]
    hinges = []
    for number in search.chosen:
        part = search.without(number)
        if is_other_answer(answer.decision, decide(part, tried_again(part, ranked))):
            hinges.append(number)
    assert hinges == [3]
    other, rival = (replace(EFFECT, title=title) for title in ("Slip", "Echo"))
    others = {"press_3": [[other], [EFFECT, rival]], "press_4": [], "press_5": []}
    assert wording.hinges(others) == (
        "the answer hangs on single trajectories (without press_3: slip with late or echo; without "
        "press_4 or press_5: no effect is named): record each again"
    )
