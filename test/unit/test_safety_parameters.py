# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the policy's node, its deadlines and its counters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import yaml

from dotsim_ros.control.policy.network import load_policy
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.common.beat import Beat
from dotsim_ros.nodes.common.counters import MissCounter, RateMeter, Spread
from dotsim_ros.nodes.common.parameters import READ_ONLY, known_parameters
from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters
from dotsim_ros.nodes.xarm_adapter.parameters import XarmAdapterParameters


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"command_rate_hz": 50.0}, "expected 25 or 100"),
        ({"command_frame": "world"}, "expected one of link_tcp, link_base"),
        ({"image_transport": "theora"}, "expected one of raw, compressed"),
        ({"workspace_m": (0.1, 0.1)}, "workspace_m is .* expected 3 numbers"),
        ({"workspace_m": (0.1, 0.1, 0.0)}, "workspace_m"),
        ({"maximum_linear_m_s2": 1.0}, "brakes for"),
        ({"retreat_m_s": 0.2}, "faster than the arm's"),
        ({"maximum_linear_m_s": float("nan")}, "maximum_linear_m_s"),
    ],
)
def test_bad_values_and_contradictions_are_refused_with_the_reason(changes, reason):
    with pytest.raises(ValueError, match=reason):
        dataclasses.replace(TactilePolicyParameters(), **changes)


def test_the_defaults_are_those_of_the_limits():
    ours, theirs = TactilePolicyParameters().limits(), SafetyLimits()
    for field in dataclasses.fields(SafetyLimits):
        np.testing.assert_allclose(getattr(ours, field.name), getattr(theirs, field.name))


def test_no_guard_of_an_arm_is_off_by_default():
    for limits in (TactilePolicyParameters().limits(), XarmAdapterParameters().limits()):
        for field in dataclasses.fields(limits):
            value = getattr(limits, field.name)
            assert np.isfinite(value).all(), field.name
            assert np.all(np.asarray(value) > 0.0), field.name
    # The arm's own watchdog; an image's distance has its limit in the policy's card.
    assert XarmAdapterParameters().duration_s > 0.0
    assert load_policy(parameter_path("policies/densetact2_sphere"), "").largest_distance < 100.0


def test_every_parameter_says_what_it_is_and_stays():
    for name, (_, parameter) in known_parameters(TactilePolicyParameters).items():
        assert parameter.help.endswith("."), name
        assert parameter.fixed == READ_ONLY, name


def test_the_shipped_file_holds_the_defaults():
    content = yaml.safe_load(parameter_path("tactile_policy.yaml").read_text())
    values = content["/**"]["ros__parameters"]
    plain = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    assert TactilePolicyParameters(**plain) == TactilePolicyParameters()
    assert set(plain) == {field.name for field in dataclasses.fields(TactilePolicyParameters)}


def test_the_force_is_limited_unless_a_user_says_that_there_is_none():
    assert np.isfinite(TactilePolicyParameters().limits().force_n)
    without = dataclasses.replace(TactilePolicyParameters(), force_limit_n=0.0).limits()
    assert np.isinf(without.force_n)
    limits = dataclasses.replace(TactilePolicyParameters(), force_limit_n=2.0).limits()
    assert (limits.force_n, limits.release_n) == (2.0, pytest.approx(1.6))


@pytest.mark.parametrize("phase_s", [0.0, 0.007, 0.013, 0.021, 0.03, 0.039])
def test_the_beat_leans_to_where_images_have_just_come_and_keeps_its_rate(phase_s):
    beat = Beat(0.04, ticks=4, start_s=0.0, margin_s=0.005)
    generator = np.random.default_rng(1)
    waited_s = []
    for cycle in range(1500):
        deadline_s = beat.cycle_s(cycle)
        newest_s = phase_s + 0.04 * np.floor((deadline_s - phase_s) / 0.04)
        waited_s.append(deadline_s - newest_s)
        beat.lean(waited_s[-1] + generator.normal(0.0, 0.003))
    assert np.median(waited_s[-500:]) == pytest.approx(0.005, abs=0.002)
    rates_hz = 1.0 / np.diff([beat.cycle_s(cycle) for cycle in range(1490, 1500)])
    np.testing.assert_allclose(rates_hz, 25.0, atol=0.01)


def test_the_rate_stays_whatever_the_images_do():
    beat = Beat(0.04, ticks=4, start_s=0.0, margin_s=0.005)
    for _ in range(1000):
        beat.lean(0.02)
    assert 1000 / (beat.cycle_s(1000) - 0.0) == pytest.approx(25.0, abs=0.2)


def test_ticks_and_cycles_share_their_deadlines():
    beat = Beat(0.04, ticks=4, start_s=3.0, margin_s=0.005)
    assert beat.tick_s(8) == beat.cycle_s(2)
    assert beat.tick_s(9) - beat.tick_s(8) == pytest.approx(0.01)


def test_a_loop_that_begins_late_begins_with_the_next_cycle():
    beat = Beat(0.04, ticks=4, start_s=3.0, margin_s=0.005)
    assert [beat.next_cycle(now_s) for now_s in (2.0, 3.0, 3.001, 3.1)] == [0, 0, 1, 3]


def test_every_miss_over_40_ms_is_on_a_line_or_counted_on_the_next():
    misses = MissCounter("inference", period_s=1.0)
    lines = [misses.note(late_s, 0.1 * tick) for tick, late_s in enumerate([0.01, 0.05] * 10)]
    told = [line for line in lines if line is not None]
    assert (misses.count, misses.reported) == (20, 10)
    assert [line.unlogged for line in told] == [0, 4]
    assert misses.worst_s == 0.05


def test_rates_are_those_of_the_last_seconds():
    meter = RateMeter()
    for tick in range(1000):
        meter.note(0.01 * tick)
    assert meter.rate_hz(9.99) == pytest.approx(100.0, rel=1e-6)
    assert meter.rate_hz(20.0) == 0.0


def test_a_spread_of_nothing_is_nan():
    spread = Spread()
    assert np.isnan(spread.percentiles(50.0)).all()
    for value in range(101):
        spread.note(float(value))
    assert spread.percentiles(50.0, 99.0) == [50.0, 99.0]
