# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gap study's halves, sizes and figures; what it scores comes from made-up cases."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros.gap.findings import Verdict
from studies.gap.baselines import Left
from studies.gap.presses import halves
from studies.gap.rates import clustered_rate, rate
from studies.gap.same_law import SameLaw, same_law_figures
from studies.gap.study import StudyCase, figures

NAMES = [f"{kind}_{k}" for kind in ("1_sphere", "2_cone") for k in range(4)]


def case(
    truth: tuple[tuple[str, float], ...],
    verdict: Verdict,
    *named: str,
    alternatives: tuple[str, ...] = (),
    size: float = 15.0,
    left: Left | None = None,
    presses: tuple[str, ...] = ("1_sphere_0",),
) -> StudyCase:
    left = left or Left(1.0, 1.0, 1.0, 1.0)
    return StudyCase(
        truth, presses, verdict, named, alternatives, size, size, 0.5, left, None, None, None
    )


def test_halves_share_nothing_and_each_has_repeats_of_every_protocol() -> None:
    for seed in range(5):
        known, tested = halves(NAMES, seed)
        assert sorted((*known, *tested)) == NAMES
        for half in (known, tested):
            assert {name.rsplit("_", 1)[0] for name in half} == {"1_sphere", "2_cone"}
    assert len({halves(NAMES, seed) for seed in range(5)}) > 1


def test_cases_that_share_presses_count_as_those_that_do_not() -> None:
    outcomes = [True, False, True, True, False, True, True, False, True, True]
    own = [(f"press_{k}",) for k in range(10)]
    alone = clustered_rate(outcomes, own)
    assert alone["share"] == pytest.approx(0.7)
    independent, narrower = rate(outcomes), rate(outcomes * 10)
    assert alone["low"] == pytest.approx(independent["low"], abs=0.02)
    again = clustered_rate(outcomes * 10, own * 10)
    assert (again["low"], again["high"]) == (alone["low"], alone["high"])
    assert again["of"] == 100
    assert narrower["low"] > again["low"] + 0.1


def test_where_all_cases_agree_only_draws_without_a_common_press_count() -> None:
    random = np.random.default_rng(0)
    drawn = [
        tuple(f"press_{k}" for k in random.choice(14, 8, replace=False) + 14 * half)
        for half in (0, 1)
        for _ in range(100)
    ]
    found = clustered_rate([False] * 200, drawn)
    assert found["of"] == 200
    # Wilson's of none of 28 / 8.
    assert found["high"] == pytest.approx(1.96**2 / (3.5 + 1.96**2), abs=1e-3)
    assert clustered_rate([], [])["share"] is None


def test_an_answer_is_right_if_it_names_all_that_is_hidden_and_nothing_else() -> None:
    late, off = (("late", 1.0),), (("mounted_off", 1.0),)
    assert case((), Verdict.NO_GAP).is_right
    assert not case((), Verdict.NAMED, "latency").is_right
    assert case(late, Verdict.NAMED, "latency").is_right
    assert not case(late, Verdict.NAMED, "latency", "backlash").is_right
    assert case(late, Verdict.SET, "backlash", alternatives=("latency",)).is_right
    assert not case(late, Verdict.SET, "backlash", alternatives=("latency", "gamma")).is_right
    # An offset lies along all axes.
    assert case(off, Verdict.NAMED, "pose_offset", "pose_offset_x").is_right
    assert case(off, Verdict.NAMED, "pose_offset_x").is_right
    assert not case(off, Verdict.NAMED, "pose_offset_x", "latency").is_right
    assert not case((*late, *off), Verdict.NAMED, "pose_offset", "pose_offset_x").is_right
    assert case((("leaning_base", 1.0),), Verdict.UNKNOWN).is_right
    assert not case((*late, *off), Verdict.NAMED, "latency").is_right
    assert case((*late, *off), Verdict.NAMED, "latency", "pose_offset").is_right


def test_the_figures_are_shares_of_the_cases() -> None:
    late = (("late", 1.0),)
    cases = [
        *(case((), Verdict.NO_GAP, presses=(f"press_{k}",)) for k in range(9)),
        case((), Verdict.NAMED, "backlash"),
        case(late, Verdict.NAMED, "latency", left=Left(5.0, 1.5, 1.4, 1.0)),
        case(late, Verdict.NO_GAP),
        case((*late, ("set", 1.0)), Verdict.NAMED, "latency", left=Left(4.0, 4.0, 3.0, 2.0)),
    ]
    found = figures(cases)
    assert found["nulls"]["false_names"]["share"] == pytest.approx(0.1)
    assert found["nulls"]["wrong_names"] == ["backlash"]
    assert found["named_right_by_whitened_size"]["10 to 20"]["share"] == pytest.approx(0.5)
    assert found["both_of_two"]["share"] == 0.0
    assert found["one_of_two"]["share"] == 1.0
    assert found["after_adding"]["median_share_closed"] == pytest.approx(0.7)
    assert found["after_adding"]["median_share_closed_single"] == pytest.approx(0.9)
    same = same_law_figures(
        [
            SameLaw("latency", 0.1, 20.0, ("latency",), 0.11, 0.09, 0.12),
            SameLaw("latency", 0.1, 20.0, ("latency",), 0.13, 0.12, 0.14),
            SameLaw("latency", 0.1, 5.0, ()),
        ]
    )
    assert same["median_relative_error"] == pytest.approx(0.2)
    assert same["interval_covers"]["share"] == 0.5
