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

    participants: str = quantity("", is_path=True)
    """YAML file of the nodes that time waits for (empty: the shipped participants.yaml)"""
    period_s: float = quantity(0.01, low=SHORTEST_PERIOD_S, high=LONGEST_STEP_S)
    """simulated time of a step; a longer one leaves out what is due within it"""
    speed: float = quantity(0.0, low=0.0, high=1000.0)
    """simulated seconds for each real one; 0: as many as the machine gives"""
    start_s: float = quantity(1.0, low=1e-3, high=2e9)
    """simulated time to begin at; above zero, which means no time"""
    patience_s: float = quantity(120.0, low=0.1, high=3600.0)
    """how long a participant may take to come, or for one step, before all ends"""
    paused: bool = quantity(False)
    """begin paused: time goes on by ~/step only"""
    steps_per_call: int = quantity(1, low=1, high=LARGEST_STEP_COUNT)
    """steps that one call of ~/step takes"""
    diagnostics_period_s: float = quantity(1.0, low=0.05, high=60.0)
    """real time between two reports"""

    def __post_init__(self) -> None:
        check_fields("", self)

    def awaited(self) -> dict[str, Participant]:
        """Return whom time waits for, by name.

        Raises:
            OSError, ValueError: see `read_participants`.
        """
        return read_participants(self.participants or parameter_path(SHIPPED_PARTICIPANTS))
