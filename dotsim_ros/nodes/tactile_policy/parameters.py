# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `tactile_policy`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from dotsim_ros.control.safety_layer.arm_control import ControlSettings
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.parameters import READ_ONLY
from dotsim_ros.nodes.simulated_time.latency import LONGEST_S, check_quantiles

RAW, COMPRESSED = "raw", "compressed"


@dataclass(frozen=True)
class TactilePolicyParameters:
    """Parameters of `tactile_policy`; each field says what it is.

    None can be changed while the node runs: limits do not move under a moving arm.

    Raises:
        ValueError: a value out of its range, or two that contradict each other.
    """

    FIXED: ClassVar[str] = READ_ONLY

    limits: SafetyLimits = field(default=SafetyLimits())
    control: ControlSettings = field(default=ControlSettings())

    policy: str = quantity("")
    """The policy: a folder that train-policy wrote, or a name below params/policies."""
    path: str = quantity("")
    """Which of the policy's paths to follow. Empty: its first."""
    idle_image: str = quantity("", is_path=True)
    """Image of the sensor at rest. Empty: call calibrate_idle before set_enabled."""
    image_transport: str = quantity(RAW, choices=(RAW, COMPRESSED))
    """raw: image_raw (Image); compressed: image_raw/compressed (CompressedImage)."""
    maximum_image_distance: float = quantity(0.0, low=0.0, high=1e9)
    """An image whose distance from the training images is larger stops the arm, since it is taken
    for another sensor's. 0: the limit of the policy's card."""
    clock_jump_s: float = quantity(0.5, low=0.05, high=1e9)
    """Stamps that lie further in the future, and a clock that is set by more, stop the arm until it
    is enabled again; stamps that run back by more than 20 ms always do."""
    inference_latency_s: tuple[float, ...] = quantity(
        (0.0,), low=0.0, high=LONGEST_S, any_length=True
    )
    """In simulated time: from an image to the policy's command: one delay, or evenly spaced
    quantiles of it, the smallest first."""
    latency_seed: int = quantity(0, low=0, high=2**31 - 1)
    """Seed of inference_latency_s."""
    realtime_priority: int = quantity(0, low=0, high=99)
    """Real-time priority (SCHED_RR) of the node's threads, which the system must permit. 0:
    none."""
    diagnostics_period_s: float = quantity(1.0, low=0.05, high=60.0)
    """Period of the diagnostics."""

    def __post_init__(self) -> None:
        check_fields("", self)
        check_quantiles("inference_latency_s", self.inference_latency_s)
