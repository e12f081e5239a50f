# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Services of the standard for simulators, where the package simulation_interfaces is installed.

It is not on PyPI: `has_standard_services` looks for it. What is answered is decided in
`standard_answers`.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

import msg_adapters
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.time_stepper.standard_answers import (
    DONE,
    Code,
    Feature,
    StandardAnswer,
    State,
    check_scope,
    check_state,
    check_steps,
    state_of,
)

PACKAGE = "simulation_interfaces"
ABOUT = "dotsim_ros time_stepper: time goes on in steps that its participants take together"

Outcome = tuple[bool, str]
"""Whether a request did what it should, and what came of it, in words."""


@dataclass(frozen=True)
class StepperActions:
    """What the services can ask the stepper for.

    Attributes:
        is_paused: returns whether time is paused.
        pause: stops time, or lets it run.
        step: takes so many steps.
        reset: resets the participants.
        leave: ends the node.
    """

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
        response.state.state = int(state_of(is_paused=actions.is_paused()))
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


def _answer_of(outcome: Outcome) -> StandardAnswer:
    is_done, words = outcome
    return DONE if is_done else StandardAnswer(Code.OPERATION_FAILED, words)


def _filled(response: Any, answer: StandardAnswer) -> Any:
    response.result.result = int(answer.code)
    response.result.error_message = answer.message
    return response
