# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the stepper answers to requests of the standard for simulators. Needs no ROS.

The numbers are those of the package simulation_interfaces (ros-simulation/simulation_interfaces,
version 2.0.0: msg/Result, msg/SimulationState, msg/SimulatorFeatures, srv/ResetSimulation,
srv/SetSimulationState).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag

from dotsim_ros.nodes.time_stepper.parameters import LARGEST_STEP_COUNT


class Code(IntEnum):
    """Result of a request."""

    FEATURE_UNSUPPORTED = 0
    OK = 1
    INCORRECT_STATE = 3
    OPERATION_FAILED = 4
    ALREADY_IN_TARGET_STATE = 101


class State(IntEnum):
    """State of a simulation."""

    STOPPED = 0
    PLAYING = 1
    PAUSED = 2
    QUITTING = 3


class Scope(IntFlag):
    """What a reset concerns; 0 stands for all."""

    TIME = 1
    STATE = 2
    SPAWNED = 4
    ALL = 255


class Feature(IntEnum):
    """What the stepper can do."""

    SIMULATION_RESET = 20
    SIMULATION_RESET_STATE = 22
    SIMULATION_STATE_GETTING = 24
    SIMULATION_STATE_SETTING = 25
    SIMULATION_STATE_PAUSE = 26
    STEP_SIMULATION_SINGLE = 31
    STEP_SIMULATION_MULTIPLE = 32


@dataclass(frozen=True)
class StandardAnswer:
    """A result and what it means.

    Attributes:
        code: the result.
        message: why; empty where all is well.
    """

    code: Code
    message: str = ""


DONE = StandardAnswer(Code.OK)


def state_of(*, is_paused: bool) -> State:
    """Return the state of the simulation."""
    return State.PAUSED if is_paused else State.PLAYING


def check_state(wanted: int, *, is_paused: bool) -> StandardAnswer:
    """Return whether a state can be gone to: DONE, or why not.

    Args:
        wanted: number of a state.
        is_paused: whether time is paused.
    """
    if wanted == State.STOPPED:
        return StandardAnswer(
            Code.FEATURE_UNSUPPORTED,
            "stopping would set the time back, and time goes on here: pause, and reset the state "
            "(scope 2)",
        )
    if wanted not in (State.PLAYING, State.PAUSED, State.QUITTING):
        return StandardAnswer(
            Code.OPERATION_FAILED,
            f"state is {wanted}, expected 1 (playing), 2 (paused) or 3 (quit)",
        )
    if wanted == state_of(is_paused=is_paused):
        return StandardAnswer(Code.ALREADY_IN_TARGET_STATE, f"is {State(wanted).name.lower()}")
    return DONE


def check_steps(steps: int, *, is_paused: bool) -> StandardAnswer:
    """Return whether steps can be taken: DONE, or why not."""
    if not is_paused:
        return StandardAnswer(Code.OPERATION_FAILED, "time runs: pause it first")
    if not 1 <= steps <= LARGEST_STEP_COUNT:
        return StandardAnswer(
            Code.OPERATION_FAILED, f"steps is {steps}, expected 1 to {LARGEST_STEP_COUNT}"
        )
    return DONE


def check_scope(scope: int) -> StandardAnswer:
    """Return whether a reset of a scope can be done: DONE, or why not."""
    if scope == Scope.STATE:
        return DONE
    return StandardAnswer(
        Code.FEATURE_UNSUPPORTED,
        f"scope is {scope}, expected 2 (state): time goes on here, and nothing is spawned",
    )
