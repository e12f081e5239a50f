# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of `time_stepper`. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dotsim_ros.io.files import parameter_path
from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.parameters import READ_ONLY
from dotsim_ros.nodes.simulated_time.participants import (
    SHORTEST_PERIOD_S,
    Participant,
    read_participants,
)
from dotsim_ros.nodes.simulated_time.schedule import LONGEST_STEP_S

SHIPPED_PARTICIPANTS = "participants.yaml"
LARGEST_STEP_COUNT = 1_000_000


@dataclass(frozen=True)
class TimeStepperParameters:
    """Parameters of `time_stepper`.

    Raises:
        ValueError: a value out of its range.
    """

    FIXED: ClassVar[str] = READ_ONLY

    participants: str = quantity(
        "",
        help="YAML file of the nodes that time waits for (empty: the shipped participants.yaml)",
        is_path=True,
    )
    period_s: float = quantity(
        0.01,
        help="simulated time of a step; a longer one leaves out what is due within it",
        low=SHORTEST_PERIOD_S,
        high=LONGEST_STEP_S,
    )
    speed: float = quantity(
        0.0,
        help="simulated seconds for each real one; 0: as many as the machine gives",
        low=0.0,
        high=1000.0,
    )
    start_s: float = quantity(
        1.0, help="simulated time to begin at; above zero, which means no time", low=1e-3, high=2e9
    )
    patience_s: float = quantity(
        120.0,
        help="how long a participant may take to come, or for one step, before all ends",
        low=0.1,
        high=3600.0,
    )
    paused: bool = quantity(False, help="begin paused: time goes on by ~/step only")
    steps_per_call: int = quantity(
        1, help="steps that one call of ~/step takes", low=1, high=LARGEST_STEP_COUNT
    )
    diagnostics_period_s: float = quantity(
        1.0, help="real time between two reports", low=0.05, high=60.0
    )

    def __post_init__(self) -> None:
        check_fields("", self)

    def awaited(self) -> dict[str, Participant]:
        """Return whom time waits for, by name.

        Raises:
            OSError, ValueError: see `read_participants`.
        """
        return read_participants(self.participants or parameter_path(SHIPPED_PARTICIPANTS))
