"""The rule on drawn data of known truth: one effect that shows in skin and force."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap.decision import EXPLAINED
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.presses.answer import (
    SearchAnswer,
    answer_of,
    null_gains,
    screen,
    sizes_by_channel,
)
from dotsim_ros.gap.presses.assumptions import SHARED, PressNuisance
from dotsim_ros.gap.presses.covariance import ChannelNoise, Discrepancy, Whitening
from dotsim_ros.gap.presses.evidence import Case, EvidenceTrajectory, Variant
from dotsim_ros.gap.presses.observables import PATCH_COUNT, SIZE
from dotsim_ros.gap.presses.search_state import GapRequest, Search
from dotsim_ros.gap.report.wording import reaches_end, sentence

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
    nothing = SimpleNamespace(solve_count=0)
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
    assert answer.verdict is Verdict.NAMED
    assert [entry.effect.name for entry in answer.named] == ["late"]
    assert answer.named[0].trial.size == pytest.approx(0.8, abs=0.1)
    assert answer.named[0].explained == pytest.approx(1.0, abs=0.05)
    assert sizes_by_channel(search, answer.named[0]) is None


@pytest.mark.parametrize(("skin", "force"), [(0.8, 0.0), (0.0, 0.8)])
def test_what_looks_like_an_effect_in_one_channel_alone_is_unknown(
    change: list[np.ndarray], random: np.random.Generator, skin: float, force: float
) -> None:
    search = search_of(change, skin, force, random)
    answer = answered(search, change)
    assert answer.statistic > answer.threshold
    assert answer.verdict is Verdict.UNKNOWN
    assert answer.named == []
    sizes = sizes_by_channel(search, answer.ranked[0])
    assert sizes == pytest.approx((skin, force), abs=0.1)
    text = sentence(
        answer.verdict,
        [],
        [],
        [],
        nearest=EFFECT,
        sizes=sizes,
        end=None,
        place="the skin at the rim",
    )
    told, other = (f"{size:.2g} s" for size in sizes)
    assert f"late, but the skin gives size = {told} and the force {other}: they should" in text


@pytest.mark.parametrize("size", [0.9, 1.2])
@pytest.mark.parametrize("natural_ends", [(), (1.0,)])
def test_an_effect_at_an_end_of_its_range_is_named_only_if_nothing_can_be_beyond(
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
    # Either explains enough.
    assert nearest.explained is not None
    assert nearest.explained > EXPLAINED
    assert nearest.trial.size == pytest.approx(min(size, 1.0), abs=0.05)
    if size < 1.0 or natural_ends:
        assert answer.verdict is Verdict.NAMED
        return
    assert answer.verdict is Verdict.UNKNOWN
    assert answer.named == []
    text = sentence(
        answer.verdict, [], [], [], nearest=effect, sizes=None, end=nearest.end, place="the skin"
    )
    assert "The nearest is: late, at the end of its range (size = 1 s)." in text


@pytest.mark.parametrize(("low", "high"), [(0.6, 0.9), (0.6, 1.0), (0.0, 0.4)])
def test_an_interval_that_reaches_the_end_of_a_range_is_told(low: float, high: float) -> None:
    told = reaches_end(EFFECT, Estimate("size", "s", 0.5 * (low + high), low, high))
    if high < 1.0:  # that of the absent effect is no such end
        assert told is None
        return
    assert told is not None
    assert "the interval of late.size reaches the end of its range, 1 s" in told


def test_without_anything_there_is_no_gap(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    search = search_of(change, 0.0, 0.0, random)
    assert answered(search, change).verdict is Verdict.NO_GAP


def test_the_parts_of_a_change_in_each_channel_add_up_to_it(
    change: list[np.ndarray], random: np.random.Generator
) -> None:
    case = case_of(change, random)
    variant, chosen = variant_of(change), [0, 3, 4]
    columns = case.channel_columns(variant, 0.4, chosen)
    whole = case.whitened(case.change_at(variant, 0.4), chosen)
    assert np.allclose(columns.sum(axis=1), whole)
    in_force = np.tile(OF_FORCE, FRAMES * len(chosen))
    assert not columns[in_force, 0].any()
    assert not columns[~in_force, 1].any()
