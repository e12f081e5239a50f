# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Profiles: what they make of a solver, which are refused, and when the keeper changes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dotsim_ros.nodes.common.parameters import from_values
from dotsim_ros.nodes.tactile_sim.active_profile import ProfileKeeper, ladder_of
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters
from dotsim_ros.nodes.tactile_sim.profiles import (
    EXACT,
    FAST,
    PROFILES,
    REALTIME,
    resolve_profile,
    solver_of,
)
from dotsim_ros.specification import load_sensor

PERIOD_S = 0.04
COST_S = {"exact": 0.030, "realtime": 0.025, "fast": 0.015}


def test_the_defaults_are_those_of_the_clocks() -> None:
    assert resolve_profile("by_clock", is_lockstep=False) == "realtime"
    assert resolve_profile("by_clock", is_lockstep=True) == "exact"


def test_auto_is_realtime_in_simulated_time() -> None:
    assert resolve_profile("auto", is_lockstep=False) == "auto"
    assert resolve_profile("auto", is_lockstep=False, is_simulated_time=True) == "realtime"
    for name in PROFILES:
        assert resolve_profile(name, is_lockstep=False, is_simulated_time=True) == name


@pytest.mark.fault("node parameters", "`profile` is unknown")
def test_an_unknown_profile_is_refused(answered: Callable[[str], None]) -> None:
    with pytest.raises(ValueError, match=r"profile is 'quick', expected one of by_clock, exact"):
        resolve_profile("quick", is_lockstep=False)
    with pytest.raises(ValueError, match=r"profile is 'quick', expected one of") as refused:
        from_values(TactileSimParameters, {"profile": "quick"})
    answered(str(refused.value))


@pytest.mark.fault("node parameters", "a `profile` that lockstep does not know")
def test_lockstep_takes_the_exact_profile_alone(answered: Callable[[str], None]) -> None:
    for name in ("realtime", "fast", "auto"):
        with pytest.raises(ValueError, match="lockstep") as refused:
            from_values(
                TactileSimParameters, {"profile": name, "clock": "lockstep", "input": "pose"}
            )
    answered(str(refused.value))
    for name in ("by_clock", "exact"):
        from_values(TactileSimParameters, {"profile": name, "clock": "lockstep", "input": "pose"})


def test_the_profiles_bound_the_sensors_own_solver() -> None:
    sensor = load_sensor("densetact2")
    assert solver_of(EXACT, sensor) == sensor.solver
    realtime, fast = solver_of(REALTIME, sensor), solver_of(FAST, sensor)
    assert realtime == replace(sensor.solver, iterations=2, tolerance_m=30.0e-6)
    assert fast == replace(realtime, grid_spacing_m=0.0032)
    assert solver_of(FAST, sensor, grid_spacing_m=0.0028).grid_spacing_m == 0.0028
    # A sensor that asks for less has it.
    easy = replace(sensor, solver=replace(sensor.solver, iterations=1, tolerance_m=200.0e-6))
    assert solver_of(REALTIME, easy) == easy.solver


def test_auto_has_no_profile_that_saves_nothing() -> None:
    def names(sensor: str, **more: Any) -> list[str]:
        return [rung.profile.name for rung in ladder_of("auto", load_sensor(sensor), **more)]

    assert names("densetact2") == ["exact", "realtime", "fast"]
    # Two cells in its thickness are the fewest.
    assert names("flat_pad") == ["exact", "realtime"]
    assert names("densetact2", grid_spacing_m=0.0032) == ["exact", "realtime"]


def test_a_gel_that_remembers_keeps_one_profile() -> None:
    sensor = load_sensor("densetact2")
    relaxing = replace(
        sensor, material=replace(sensor.material, prony_shares=(0.2,), prony_times_s=(0.1,))
    )
    assert [rung.profile.name for rung in ladder_of("auto", relaxing)] == ["realtime"]


def run(
    keeper: ProfileKeeper, load: Callable[[float], float], *, until_s: float, start_s: float = 0.0
) -> list[tuple[float, str]]:
    """Play frames of a machine that takes `load(now)` times the usual; return the changes."""
    changes, now_s = [], start_s
    while now_s < until_s:
        spent_s = load(now_s) * COST_S[keeper.name]
        now_s += max(PERIOD_S, spent_s)
        name = keeper.note(spent_s, now_s, period_s=PERIOD_S)
        if name is not None:
            keeper.moved(name, now_s)
            changes.append((now_s, name))
    return changes


@pytest.mark.parametrize(
    ("factor", "expected"), [(0.5, "exact"), (1.2, "realtime"), (2.0, "fast"), (9.0, "fast")]
)
def test_it_begins_with_the_finest_that_the_machine_affords(factor: float, expected: str) -> None:
    keeper = ProfileKeeper({k: factor * v for k, v in COST_S.items()}, period_s=PERIOD_S)
    assert keeper.name == expected
    assert keeper.changes == 0
    assert "warming up" in keeper.reason


LOADS: dict[str, tuple[float, Callable[[float], float], int]] = {
    "steady": (1.0, lambda now_s: 1.0, 0),
    "one slow frame a second": (1.0, lambda now_s: 5.0 if now_s % 1.0 < PERIOD_S else 1.0, 0),
    "too much for the finer profile": (2.0, lambda now_s: 1.7, 0),
    # 90 in an hour, each worth four changes if followed.
    "coming and going": (1.0, lambda now_s: 1.7 if now_s % 40.0 < 5.0 else 0.6, 60),
    "random, at the limit": (
        1.0,
        lambda now_s: float(np.random.default_rng(int(25 * now_s)).lognormal(0.2, 0.25)),
        60,
    ),
}
"""Cost of a frame when warming up, and at each time; the most changes in an hour."""


@pytest.mark.parametrize("what", LOADS)
def test_no_load_makes_it_flap(what: str) -> None:
    factor, load, most = LOADS[what]
    keeper = ProfileKeeper({k: factor * v for k, v in COST_S.items()}, period_s=PERIOD_S)
    assert len(run(keeper, load, until_s=3600.0 if most else 600.0)) <= most


def test_misses_lead_down_within_half_a_second_and_quiet_leads_up_slowly() -> None:
    keeper = ProfileKeeper(COST_S, period_s=PERIOD_S)
    changes = run(keeper, lambda now_s: 1.7 if 5.0 < now_s < 60.0 else 0.8, until_s=100.0)
    assert [name for _, name in changes] == ["realtime", "fast", "realtime", "exact"]
    assert changes[1][0] < 5.5
    assert changes[2][0] > 60.0
    assert changes[3][0] - changes[2][0] > 9.9
    assert "expected within" in keeper.reason


def test_a_finer_profile_that_proves_too_dear_is_tried_ever_more_rarely() -> None:
    # The machine is worse at the finer one than when it was timed.
    keeper = ProfileKeeper(COST_S, period_s=PERIOD_S)
    changes = run(keeper, lambda now_s: 1.0 if keeper.name == "fast" else 2.0, until_s=3600.0)
    up_s = [now_s for now_s, name in changes if name == "realtime"][1:]
    assert len(changes) < 24
    assert np.all(np.diff(up_s)[:5] > 1.8 * np.r_[10.0, np.diff(up_s)[:4]])


def test_what_is_refused_is_not_tried_again_at_once() -> None:
    keeper = ProfileKeeper(COST_S, period_s=PERIOD_S)
    asked_s = []
    for frame in range(250):
        now_s = frame * 0.06
        if keeper.note(0.06, now_s, period_s=PERIOD_S) is not None:
            asked_s.append(now_s)
            keeper.refused(now_s)
    assert keeper.name == "exact"
    assert len(asked_s) > 3
    assert np.diff(asked_s).min() >= 2.0


def test_a_new_rate_counts_from_the_next_frame() -> None:
    keeper = ProfileKeeper(COST_S, period_s=PERIOD_S)
    told = [keeper.note(0.03, 0.02 * frame, period_s=0.02) for frame in range(3)]
    assert told == [None, None, "realtime"]
