# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is answered to requests of the standard for simulators."""

from __future__ import annotations

import pytest

from dotsim_ros.nodes.time_stepper.standard_services import (
    DONE,
    STATE_SCOPE,
    Code,
    State,
    check_scope,
    check_state,
    check_steps,
)


@pytest.mark.parametrize(
    ("wanted", "is_paused", "code"),
    [
        (State.PLAYING, True, Code.OK),
        (State.PAUSED, False, Code.OK),
        (State.QUITTING, False, Code.OK),
        (State.PLAYING, False, Code.ALREADY_IN_TARGET_STATE),
        (State.PAUSED, True, Code.ALREADY_IN_TARGET_STATE),
        (State.STOPPED, False, Code.FEATURE_UNSUPPORTED),
        (255, True, Code.OPERATION_FAILED),
    ],
)
def test_states_that_can_be_gone_to(wanted: int, is_paused: bool, code: Code) -> None:
    answer, message = check_state(wanted, is_paused=is_paused)
    assert answer is code
    assert bool(message) == (code is not Code.OK)


def test_steps_are_taken_while_time_is_paused_and_the_state_alone_is_reset() -> None:
    assert check_steps(1000, is_paused=True) == DONE
    for steps, is_paused in ((1, False), (0, True), (2**64 - 1, True)):
        assert check_steps(steps, is_paused=is_paused)[0] is Code.OPERATION_FAILED
    assert check_scope(STATE_SCOPE) == DONE
    for scope in (0, 1, STATE_SCOPE | 1, 4, 255):
        assert check_scope(scope)[0] is Code.FEATURE_UNSUPPORTED
