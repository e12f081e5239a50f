# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What happens in simulated time, and when, on any machine: without ROS."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from dotsim_ros.nodes.common.pace import FramePace
from dotsim_ros.nodes.simulated_time.latency import LONGEST_S, Latency
from dotsim_ros.nodes.simulated_time.schedule import (
    LONGEST_STEP_S,
    SimulatedSchedule,
)
from dotsim_ros.nodes.simulated_time.stepper import LARGEST_LAG_S, SpeedLimit


def test_each_thing_is_done_at_its_own_time_in_the_order_asked_for() -> None:
    schedule, done = SimulatedSchedule(), []
    for name, due_s in (("c", 0.013), ("a", 0.001), ("b", 0.007), ("b again", 0.007)):
        schedule.at(due_s, lambda name=name: done.append((name, schedule.now_s)))
    schedule.advance(0.01)
    assert done == [("a", 0.001), ("b", 0.007), ("b again", 0.007)]
    assert schedule.now_s == 0.01
    # What is asked for late is done at once: time never runs back.
    schedule.at(0.005, lambda: done.append(("late", schedule.now_s)))
    schedule.advance(0.02)
    assert done[3:] == [("late", 0.01), ("c", 0.013)]


@pytest.mark.parametrize("step_s", [0.01, 0.003, 0.1])
def test_a_pace_is_kept_whatever_the_steps(step_s: float) -> None:
    schedule, seen = SimulatedSchedule(), []
    pace = FramePace(rate_hz=25.0, start_s=0.0)
    schedule.pace(pace.deadline_s, lambda now_s: (pace.begin(now_s), seen.append(now_s)))
    for index in range(round(1.0 / step_s)):
        schedule.advance((index + 1) * step_s)
    assert len(seen) >= 25
    np.testing.assert_allclose(seen, np.arange(len(seen)) * 0.04, atol=1e-9)
    assert pace.late == pace.dropped == 0


def test_how_long_it_is_until_something_is_due() -> None:
    schedule = SimulatedSchedule()
    assert schedule.until_next_s() == LONGEST_STEP_S
    schedule.advance(0.5)
    schedule.at(0.7, lambda: None)
    assert schedule.until_next_s() == pytest.approx(0.2)
    schedule.at(0.1, lambda: None)
    assert schedule.until_next_s() == 0.0


def test_a_pace_is_over_when_it_is_ended_and_another_may_begin() -> None:
    schedule, seen = SimulatedSchedule(), []
    for end_s in (0.015, 0.03):
        pace = FramePace(rate_hz=100.0, start_s=schedule.now_s)
        end = schedule.pace(
            pace.deadline_s, lambda now_s, pace=pace: (pace.begin(now_s), seen.append(pace))
        )
        schedule.advance(end_s)
        end()
    first, second = seen[0], seen[-1]
    assert first is not second
    assert seen == [first, first, second, second]


def test_what_is_computed_can_be_settled_dropped_and_cleared() -> None:
    schedule, taken, is_done = SimulatedSchedule(), [], threading.Event()
    schedule.every(0.01, lambda: taken.append("every"))
    schedule.compute(0.01, lambda: (time.sleep(0.05), is_done.set()), taken.append)
    schedule.settle()
    assert is_done.is_set()
    assert taken == []
    schedule.clear()
    schedule.compute(0.01, lambda: "before", taken.append)
    schedule.drop_computed()
    schedule.at(0.02, lambda: taken.append("later"))
    schedule.compute(0.02, lambda: "computed", taken.append)
    schedule.advance(0.1)
    assert taken == ["later", "computed"]
    schedule.compute(0.01, lambda: "too late", taken.append)
    schedule.close()
    schedule.advance(1.0)
    assert taken == ["later", "computed"]


def test_every_comes_first_after_one_period() -> None:
    schedule, seen = SimulatedSchedule(), []
    schedule.advance(0.3)
    schedule.every(0.1, lambda: seen.append(round(schedule.now_s, 9)))
    for index in range(30):
        schedule.advance(0.3 + 0.01 * (index + 1))
    assert seen == [0.4, 0.5, 0.6]


def test_what_is_computed_is_taken_after_its_delay_in_the_order_asked_for() -> None:
    schedule, taken = SimulatedSchedule(), []

    def take(name: str) -> None:
        taken.append((name, round(schedule.now_s, 9)))

    schedule.compute(0.05, lambda: time.sleep(0.05) or "slow", take)
    # Its own delay is over before that of the first.
    schedule.compute(0.01, lambda: "quick", take)
    schedule.advance(0.04)
    assert taken == []
    schedule.advance(0.06)
    assert taken == [("slow", 0.05), ("quick", 0.05)]
    schedule.close()


def test_what_was_computed_in_vain_is_raised_where_it_is_taken() -> None:
    schedule = SimulatedSchedule()
    schedule.compute(0.01, lambda: 1 / 0, lambda _: None)
    with pytest.raises(ZeroDivisionError):
        schedule.advance(0.01)
    schedule.close()


def test_the_same_seed_draws_the_same_delays() -> None:
    quantiles_s = (0.01, 0.02, 0.08)
    draws = [[Latency(quantiles_s, seed=seed).draw_s() for _ in range(1)] for seed in (1, 1, 2)]
    assert draws[0] == draws[1] != draws[2]
    first, second = Latency(quantiles_s, seed=3), Latency(quantiles_s, seed=3)
    assert [first.draw_s() for _ in range(100)] == [second.draw_s() for _ in range(100)]


def test_delays_follow_their_quantiles() -> None:
    latency = Latency((0.01, 0.02, 0.08), seed=1)
    drawn = np.array([latency.draw_s() for _ in range(4000)])
    assert 0.01 <= drawn.min() < 0.0105
    assert 0.079 < drawn.max() <= 0.08
    assert abs(np.mean(drawn < 0.02) - 0.5) < 0.04
    assert {Latency((0.03,), seed=1).draw_s() for _ in range(5)} == {0.03}


@pytest.mark.parametrize(
    ("quantiles_s", "reason"),
    [
        ((), "is empty"),
        ((-0.1,), "expected delays from 0"),
        ((0.1, float("nan")), "expected delays from 0"),
        ((2.0 * LONGEST_S,), "expected delays from 0 to 2 s"),
        ((0.2, 0.1), "rising order"),
    ],
)
def test_delays_that_make_no_sense_are_refused(quantiles_s: tuple[float, ...], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Latency(quantiles_s, seed=1)


def test_time_runs_no_faster_than_it_may() -> None:
    limit = SpeedLimit(2.0, now_s=100.0)
    assert limit.delay_s(0.01, 100.001) == pytest.approx(0.004)
    assert limit.delay_s(0.01, 100.005) == pytest.approx(0.005)
    # A little is made up for, a long wait is not.
    assert limit.delay_s(0.01, 100.05) == 0.0
    assert limit.delay_s(0.02, 105.0) == 0.0
    assert limit.delay_s(2.0 * LARGEST_LAG_S, 105.0) == 0.0
    assert limit.delay_s(0.02, 105.0) == pytest.approx(0.01)
    assert SpeedLimit(0.0, now_s=0.0).delay_s(1000.0, 0.0) == 0.0
