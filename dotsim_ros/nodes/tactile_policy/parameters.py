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

    policy: str = quantity(
        "", help="The policy: a folder that train-policy wrote, or a name below params/policies."
    )
    path: str = quantity("", help="Which of the policy's paths to follow. Empty: its first.")
    idle_image: str = quantity(
        "",
        help="Image of the sensor at rest. Empty: call calibrate_idle before set_enabled.",
        is_path=True,
    )
    image_transport: str = quantity(
        RAW,
        help="raw: image_raw (Image); compressed: image_raw/compressed (CompressedImage).",
        choices=(RAW, COMPRESSED),
    )
    maximum_image_distance: float = quantity(
        0.0,
        help="An image whose distance from the training images is larger stops the arm, since it "
        "is taken for another sensor's. 0: the limit of the policy's card.",
        low=0.0,
        high=1e9,
    )
    clock_jump_s: float = quantity(
        0.5,
        help="Stamps that lie further in the future, and a clock that is set by more, stop the arm "
        "until it is enabled again; stamps that run back by more than 20 ms always do.",
        low=0.05,
        high=1e9,
    )
    inference_latency_s: tuple[float, ...] = quantity(
        (0.0,),
        help="In simulated time: from an image to the policy's command: one delay, or evenly "
        "spaced quantiles of it, the smallest first.",
        low=0.0,
        high=LONGEST_S,
        any_length=True,
    )
    latency_seed: int = quantity(0, help="Seed of inference_latency_s.", low=0, high=2**31 - 1)
    realtime_priority: int = quantity(
        0,
        help="Real-time priority (SCHED_RR) of the node's threads, which the system must permit. "
        "0: none.",
        low=0,
        high=99,
    )
    diagnostics_period_s: float = quantity(
        1.0, help="Period of the diagnostics.", low=0.05, high=60.0
    )

    def __post_init__(self) -> None:
        check_fields("", self)
        check_quantiles("inference_latency_s", self.inference_latency_s)
