# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is answered to requests of the standard for simulators."""

from __future__ import annotations

import pytest

from dotsim_ros.nodes.time_stepper.standard_answers import (
    DONE,
    Code,
    Scope,
    State,
    check_scope,
    check_state,
    check_steps,
    state_of,
)


def test_time_is_paused_or_plays() -> None:
    assert state_of(is_paused=True) is State.PAUSED
    assert state_of(is_paused=False) is State.PLAYING


@pytest.mark.parametrize(
    ("wanted", "is_paused", "code"),
    [
        (State.PLAYING, True, Code.OK),
        (State.PAUSED, False, Code.OK),
        (State.QUITTING, True, Code.OK),
        (State.QUITTING, False, Code.OK),
        (State.PLAYING, False, Code.ALREADY_IN_TARGET_STATE),
        (State.PAUSED, True, Code.ALREADY_IN_TARGET_STATE),
        (State.STOPPED, False, Code.FEATURE_UNSUPPORTED),
        (4, False, Code.OPERATION_FAILED),
        (255, True, Code.OPERATION_FAILED),
    ],
)
def test_states_that_can_be_gone_to(wanted: int, is_paused: bool, code: Code) -> None:
    answer = check_state(wanted, is_paused=is_paused)
    assert answer.code is code
    assert bool(answer.message) == (code is not Code.OK)


@pytest.mark.parametrize(
    ("steps", "is_paused", "reason"),
    [
        (1, False, "pause it first"),
        (0, True, "steps is 0, expected 1 to 1000000"),
        (2**64 - 1, True, "expected 1 to 1000000"),
    ],
)
def test_steps_that_cannot_be_taken(steps: int, is_paused: bool, reason: str) -> None:
    answer = check_steps(steps, is_paused=is_paused)
    assert answer.code is Code.OPERATION_FAILED
    assert reason in answer.message


def test_steps_are_taken_while_time_is_paused() -> None:
    assert check_steps(1, is_paused=True) == check_steps(1000, is_paused=True) == DONE


def test_only_the_state_can_be_reset() -> None:
    assert check_scope(Scope.STATE) == DONE
    for scope in (0, Scope.TIME, Scope.STATE | Scope.TIME, Scope.SPAWNED, Scope.ALL, 128):
        answer = check_scope(scope)
        assert answer.code is Code.FEATURE_UNSUPPORTED
        assert "time goes on here" in answer.message
