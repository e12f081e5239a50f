# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of `time_stepper`. Needs no ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.common.options import check_options, option
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

    participants: str = option(
        "",
        "YAML file of the nodes that time waits for (empty: the shipped participants.yaml)",
        is_path=True,
        read_only=True,
    )
    period_s: float = option(0.01, "simulated time of a step, 0.001 to 1 s", read_only=True)
    speed: float = option(
        0.0,
        "simulated seconds for each real one; 0: as many as the machine gives",
        minimum=0.0,
        maximum=1000.0,
        read_only=True,
    )
    start_s: float = option(
        1.0,
        "simulated time to begin at; above zero, which means no time",
        minimum=1e-3,
        maximum=2e9,
        read_only=True,
    )
    patience_s: float = option(
        120.0,
        "how long a participant may take to come, or for one step, before all ends",
        minimum=0.1,
        maximum=3600.0,
        read_only=True,
    )
    paused: bool = option(False, "begin paused: time goes on by ~/step only", read_only=True)
    steps_per_call: int = option(
        1,
        "steps that one call of ~/step takes",
        minimum=1,
        maximum=LARGEST_STEP_COUNT,
        read_only=True,
    )
    diagnostics_period_s: float = option(
        1.0, "real time between two reports", minimum=0.05, maximum=60.0, read_only=True
    )

    def __post_init__(self) -> None:
        # Not a range that ROS knows: it would refuse without saying why.
        if not (
            math.isfinite(self.period_s) and SHORTEST_PERIOD_S <= self.period_s <= LONGEST_STEP_S
        ):
            raise ValueError(
                f"period_s is {self.period_s:g}, expected the simulated time of a step, "
                f"{SHORTEST_PERIOD_S:g} to {LONGEST_STEP_S:g} s: time stands still in a step of "
                "zero, and a longer one leaves out what is due within it"
            )
        check_options(self)

    def awaited(self) -> dict[str, Participant]:
        """Return whom time waits for, by name.

        Raises:
            OSError, ValueError: see `read_participants`.
        """
        return read_participants(self.participants or parameter_path(SHIPPED_PARTICIPANTS))
