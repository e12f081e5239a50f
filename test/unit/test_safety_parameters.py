# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the nodes of an arm, the policy's deadlines and counters, joint states."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_typestore

from dotsim_ros.control.policy.network import load_policy
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.common.beat import Beat
from dotsim_ros.nodes.common.counters import MissCounter, RateMeter, Spread
from dotsim_ros.nodes.common.parameters import FREE, READ_ONLY, from_values, known_parameters
from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters
from dotsim_ros.nodes.xarm_adapter.parameters import XarmAdapterParameters
from dotsim_ros.nodes.xarm_sim.parameters import XarmSimParameters
from msg_adapters import BagTypes, decode_joint_state, encode_joint_state

NAMES = ("joint1", "joint2", "joint3")


BAD: list[tuple[type[Any], dict[str, Any], str]] = [
    (TactilePolicyParameters, {"command_rate_hz": 50.0}, "expected 25 or 100"),
    (TactilePolicyParameters, {"command_frame": "world"}, "expected one of link_tcp, link_base"),
    (TactilePolicyParameters, {"workspace_m": (0.1, 0.1)}, "expected 3 numbers"),
    (TactilePolicyParameters, {"workspace_m": (0.1, 0.1, 0.0)}, "workspace_m"),
    (TactilePolicyParameters, {"maximum_linear_m_s2": 1.0}, "brakes for"),
    (TactilePolicyParameters, {"maximum_linear_m_s": float("nan")}, "maximum_linear_m_s"),
    (XarmSimParameters, {"start_pose": (0.0, 0.0)}, "expected 7 numbers"),
    (XarmSimParameters, {"tool_from_sensor": (0.0,) * 7}, "quaternion_xyzw has length 0"),
    (XarmSimParameters, {"indenter_pose": (np.nan,) + (0.0,) * 6}, "indenter_pose"),
    (XarmSimParameters, {"tool_frame": "link_base"}, "must differ"),
    (XarmSimParameters, {"base_frame": ""}, "must not be empty"),
    (XarmSimParameters, {"fail_delay_s": 3.0}, "fail_delay_s"),
    (XarmAdapterParameters, {"duration_s": 0.0}, "duration_s"),
    (XarmAdapterParameters, {"duration_s": 0.02}, "the arm would stop between two calls"),
    (XarmAdapterParameters, {"tool_frame": "link_base"}, "must differ"),
    (XarmAdapterParameters, {"service": ""}, "must not be empty"),
]


@pytest.mark.parametrize(("kind", "changes", "reason"), BAD)
def test_bad_values_and_contradictions_are_refused_with_the_reason(kind, changes, reason):
    with pytest.raises(ValueError, match=reason):
        from_values(kind, changes)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("tactile_policy", TactilePolicyParameters),
        ("xarm_sim", XarmSimParameters),
        ("xarm_adapter", XarmAdapterParameters),
    ],
)
def test_the_shipped_file_holds_the_defaults(name, kind):
    content = yaml.safe_load(parameter_path(f"{name}.yaml").read_text())
    values = content["/**"]["ros__parameters"]
    plain = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    assert from_values(kind, plain) == kind()
    assert set(plain) == set(known_parameters(kind))


def test_faults_of_an_arm_are_set_while_it_runs_and_limits_of_a_policy_are_not():
    arm, policy = known_parameters(XarmSimParameters), known_parameters(TactilePolicyParameters)
    assert {name for name, (_, known) in arm.items() if known.fixed == FREE} == {
        "fail_drop_feedback",
        "fail_delay_s",
        "fail_stop",
        "indenter_pose",
        "publish_indenter",
    }
    assert {known.fixed for _, known in policy.values()} == {READ_ONLY}


def test_no_guard_of_an_arm_is_off_by_default():
    adapter, limits = XarmAdapterParameters(), SafetyLimits()
    guards = [getattr(limits, field.name) for field in fields(limits)]
    # The arm's own watchdog among them; an image's distance has its limit in the policy's card.
    guards += [adapter.duration_s, adapter.stale_s, adapter.silence_s, adapter.answer_s]
    guards += [adapter.speed_limit_m_s, adapter.angular_speed_limit_rad_s]
    for guard in guards:
        assert np.isfinite(guard).all()
        assert np.all(np.asarray(guard) > 0.0)
    assert load_policy(parameter_path("policies/densetact2_sphere"), "").largest_distance < 100.0


def test_the_force_is_limited_unless_a_user_says_that_there_is_none():
    assert np.isfinite(SafetyLimits().force_n)
    assert np.isinf(SafetyLimits(force_limit_n=0.0).force_n)
    limits = SafetyLimits(force_limit_n=2.0)
    assert (limits.force_n, limits.release_n) == (2.0, pytest.approx(1.6))


@pytest.mark.parametrize("phase_s", [0.0, 0.013, 0.039])
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


def test_cycles_and_their_ticks():
    beat = Beat(0.04, ticks=4, start_s=3.0, margin_s=0.005)
    assert beat.tick_s(8) == beat.cycle_s(2)
    assert beat.tick_s(9) - beat.tick_s(8) == pytest.approx(0.01)
    # A loop that begins late begins with the next cycle.
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


def test_joint_states_come_back_in_any_order():
    types = BagTypes(get_typestore(Stores.ROS2_JAZZY).types)
    message = encode_joint_state(
        NAMES, (0.1, 0.2, 0.3), (1.0, 2.0, 3.0), stamp_ns=5, frame_id="link_base", types=types
    )
    positions, velocities = decode_joint_state(message, ("joint3", "joint1"))
    np.testing.assert_array_equal(positions, [0.3, 0.1])
    np.testing.assert_array_equal(velocities, [3.0, 1.0])
    assert len(message.effort) == 0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"name": ["joint1"], "position": [0.0], "velocity": [0.0]}, "lacks joint2, joint3"),
        ({"position": [0.0, np.nan, 0.0]}, "joint positions holds"),
        ({"velocity": []}, "joint velocities needs 3"),
    ],
)
def test_joint_states_that_are_broken_are_refused(changes, reason):
    whole = {"name": list(NAMES), "position": [0.0] * 3, "velocity": [0.0] * 3}
    with pytest.raises(ValueError, match=reason):
        decode_joint_state(SimpleNamespace(**{**whole, **changes}), NAMES)
