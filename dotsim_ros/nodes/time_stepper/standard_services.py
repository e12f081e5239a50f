# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Services of the standard for simulators, where the package simulation_interfaces is installed.

The numbers are those of its version 2.0.0 (ros-simulation/simulation_interfaces: msg/Result,
msg/SimulationState, msg/SimulatorFeatures, srv/ResetSimulation). It is not on PyPI:
`has_standard_services` looks for it.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import msg_adapters
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.time_stepper.parameters import LARGEST_STEP_COUNT

PACKAGE = "simulation_interfaces"
ABOUT = "dotsim_ros time_stepper: time goes on in steps that its participants take together"
STATE_SCOPE = 2
"""Scope of a reset that concerns the state of the simulation alone."""

Outcome = tuple[bool, str]
"""Whether a request did what it should, and what came of it, in words."""


class Code(IntEnum):
    """Result of a request."""

    FEATURE_UNSUPPORTED = 0
    OK = 1
    OPERATION_FAILED = 4
    ALREADY_IN_TARGET_STATE = 101


class State(IntEnum):
    """State of a simulation."""

    STOPPED = 0
    PLAYING = 1
    PAUSED = 2
    QUITTING = 3


class Feature(IntEnum):
    """What the stepper can do."""

    SIMULATION_RESET = 20
    SIMULATION_RESET_STATE = 22
    SIMULATION_STATE_GETTING = 24
    SIMULATION_STATE_SETTING = 25
    SIMULATION_STATE_PAUSE = 26
    STEP_SIMULATION_SINGLE = 31
    STEP_SIMULATION_MULTIPLE = 32


Answer = tuple[Code, str]
"""A result, and why; empty where all is well."""
DONE: Answer = (Code.OK, "")


def check_state(wanted: int, *, is_paused: bool) -> Answer:
    """Return DONE where a simulation that plays, or is paused, can go to a state, or why not."""
    if wanted == State.STOPPED:
        return (
            Code.FEATURE_UNSUPPORTED,
            "stopping would set the time back, and time goes on here: pause, and reset the state "
            "(scope 2)",
        )
    if wanted not in (State.PLAYING, State.PAUSED, State.QUITTING):
        return (
            Code.OPERATION_FAILED,
            f"state is {wanted}, expected 1 (playing), 2 (paused) or 3 (quit)",
        )
    if wanted == _state_of(is_paused):
        return Code.ALREADY_IN_TARGET_STATE, f"is {State(wanted).name.lower()}"
    return DONE


def check_steps(steps: int, *, is_paused: bool) -> Answer:
    """Return DONE where so many steps can be taken, or why not."""
    if not is_paused:
        return Code.OPERATION_FAILED, "time runs: pause it first"
    if not 1 <= steps <= LARGEST_STEP_COUNT:
        return Code.OPERATION_FAILED, f"steps is {steps}, expected 1 to {LARGEST_STEP_COUNT}"
    return DONE


def check_scope(scope: int) -> Answer:
    """Return DONE where what a scope concerns can be reset, or why not."""
    if scope == STATE_SCOPE:
        return DONE
    return (
        Code.FEATURE_UNSUPPORTED,
        f"scope is {scope}, expected 2 (state): time goes on here, and nothing is spawned",
    )


@dataclass(frozen=True)
class StepperActions:
    """What the services can ask the stepper for: whether time is paused, to stop time or let it
    run, to take so many steps, to reset the participants, and to end the node."""

    is_paused: Callable[[], bool]
    pause: Callable[[bool], None]
    step: Callable[[int], Awaitable[Outcome]]
    reset: Callable[[], Awaitable[Outcome]]
    leave: Callable[[], None]


def has_standard_services() -> bool:
    """Return whether the package with the services is installed."""
    try:
        msg_adapters.message_class(f"{PACKAGE}/srv/StepSimulation")
    except ImportError:
        return False
    return True


def offer_standard_services(node: WorkingNode, actions: StepperActions) -> None:
    """Offer the services below the node's name, such as ~/step_simulation.

    Raises:
        ImportError: the package is not installed.
    """

    async def step(request: Any, response: Any) -> Any:
        answer = check_steps(request.steps, is_paused=actions.is_paused())
        if answer == DONE:
            answer = _answer_of(await actions.step(request.steps))
        return _filled(response, answer)

    async def reset(request: Any, response: Any) -> Any:
        answer = check_scope(request.scope)
        if answer == DONE:
            answer = _answer_of(await actions.reset())
        return _filled(response, answer)

    def set_state(request: Any, response: Any) -> Any:
        wanted = request.state.state
        answer = check_state(wanted, is_paused=actions.is_paused())
        if answer == DONE and wanted == State.QUITTING:
            actions.leave()
        elif answer == DONE:
            actions.pause(wanted == State.PAUSED)
        return _filled(response, answer)

    def get_state(_request: Any, response: Any) -> Any:
        response.state.state = int(_state_of(actions.is_paused()))
        return _filled(response, DONE)

    def get_features(_request: Any, response: Any) -> Any:
        response.features.features = [int(feature) for feature in Feature]
        response.features.custom_info = ABOUT
        return response

    for kind, name, callback in (
        ("StepSimulation", "step_simulation", step),
        ("ResetSimulation", "reset_simulation", reset),
        ("SetSimulationState", "set_simulation_state", set_state),
        ("GetSimulationState", "get_simulation_state", get_state),
        ("GetSimulatorFeatures", "get_simulator_features", get_features),
    ):
        service = msg_adapters.message_class(f"{PACKAGE}/srv/{kind}")
        node.create_service(service, f"~/{name}", callback)


def _state_of(is_paused: bool) -> State:
    return State.PAUSED if is_paused else State.PLAYING


def _answer_of(outcome: Outcome) -> Answer:
    is_done, words = outcome
    return DONE if is_done else (Code.OPERATION_FAILED, words)


def _filled(response: Any, answer: Answer) -> Any:
    code, response.result.error_message = answer
    response.result.result = int(code)
    return response
