# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `tactile_policy`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from dotsim_ros.control.safety_layer.arm_control import ControlSettings
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.parameters import READ_ONLY
from dotsim_ros.nodes.simulated_time.latency import LONGEST_S, check_quantiles

RAW, COMPRESSED = "raw", "compressed"
TOOL_FRAME, BASE_FRAME = "link_tcp", "link_base"
POLICY_RATE_HZ, CONTROL_RATE_HZ = 25.0, 100.0
TICKS = round(CONTROL_RATE_HZ / POLICY_RATE_HZ)


@dataclass(frozen=True)
class TactilePolicyParameters:
    """Parameters of `tactile_policy`; each field says what it is.

    None can be changed while the node runs: limits do not move under a moving arm.

    Raises:
        ValueError: a value out of its range, or two that contradict each other.
    """

    FIXED: ClassVar[str] = READ_ONLY

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
    command_frame: str = quantity(
        TOOL_FRAME,
        help="Axes of the commands: those of the tool, or those of the arm's base.",
        choices=(TOOL_FRAME, BASE_FRAME),
    )
    command_rate_hz: float = quantity(
        POLICY_RATE_HZ,
        help="25: each command of the policy is published once; 100: commands between them are "
        "interpolated linearly.",
        low=POLICY_RATE_HZ,
        high=CONTROL_RATE_HZ,
    )
    command_lead_s: float = quantity(
        0.0,
        help="How long after its image a command takes effect: the commands are extrapolated by as "
        "much. 0: they are published as they are.",
        low=0.0,
        high=0.2,
    )
    maximum_linear_m_s: float = quantity(0.05, help="Speed limit of the tool.", low=1e-4, high=1.0)
    maximum_angular_rad_s: float = quantity(
        0.4, help="Limit of the tool's angular speed.", low=1e-3, high=4.0
    )
    maximum_linear_m_s2: float = quantity(
        2.5, help="Limit of the tool's linear acceleration.", low=0.01, high=50.0
    )
    maximum_angular_rad_s2: float = quantity(
        20.0, help="Limit of the tool's angular acceleration.", low=0.1, high=500.0
    )
    workspace_m: tuple[float, float, float] = quantity(
        (0.12, 0.12, 0.04),
        help="Edges of the box that the tool may not leave, along the base's axes, around the pose "
        "at which the node was enabled.",
        low=1e-3,
        high=2.0,
    )
    maximum_turn_rad: float = quantity(
        0.35,
        help="Largest angle by which the tool may be turned from its orientation when the node was "
        "enabled.",
        low=1e-3,
        high=3.0,
    )
    reaction_s: float = quantity(
        0.1,
        help="How long the arm continues before a command takes effect; the margin kept to the "
        "workspace's border follows from it.",
        low=0.0,
        high=1.0,
    )
    stop_within_s: float = quantity(
        0.08,
        help="The commands are zero at the latest this long after the last image, pose or force.",
        low=0.06,
        high=1.0,
    )
    maximum_delay_s: float = quantity(
        0.25,
        help="A message that arrives later than this after its stamp stops the arm.",
        low=0.01,
        high=1e9,
    )
    clock_jump_s: float = quantity(
        0.5,
        help="Stamps that lie further in the future, and a clock that is set by more, stop the arm "
        "until it is enabled again; stamps that run back by more than 20 ms always do.",
        low=0.05,
        high=1e9,
    )
    resume_when_fresh: bool = quantity(
        True,
        help="Resume without a call once messages that were late arrive again; otherwise "
        "set_enabled is needed.",
    )
    force_limit_n: float = quantity(
        8.0,
        help="Force on the topic wrench above which the tool retreats. 0: the sensor measures no "
        "force, the topic is not read, and nothing limits the force.",
        low=0.0,
        high=1000.0,
    )
    force_release_share: float = quantity(
        0.8, help="The retreat ends below this share of the limit.", low=0.01, high=1.0
    )
    retreat_m_s: float = quantity(
        0.01, help="Speed of the retreat, along -z of the tool.", low=1e-4, high=1.0
    )
    retreat_m: float = quantity(
        0.02,
        help="If the force is still too large after a retreat of this length, the arm stops until "
        "it is enabled again.",
        low=1e-4,
        high=0.5,
    )
    hold_orientation: bool = quantity(
        True,
        help="Turn the tool back to its orientation when the node was enabled, which touch alone "
        "does not identify.",
    )
    orientation_gain_per_s: float = quantity(
        2.0,
        help="Gain of that rotation: angular speed for each radian of error.",
        low=0.01,
        high=20.0,
    )
    orientation_limit_rad_s: float = quantity(
        0.1, help="Limit of the angular speed of that rotation.", low=1e-3, high=4.0
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
        if self.command_rate_hz not in (POLICY_RATE_HZ, CONTROL_RATE_HZ):
            raise ValueError(
                f"command_rate_hz is {self.command_rate_hz:g}, expected {POLICY_RATE_HZ:g} or "
                f"{CONTROL_RATE_HZ:g}"
            )
        self.limits()

    def limits(self) -> SafetyLimits:
        """Return what the arm may do.

        Raises:
            ValueError: the limits contradict each other.
        """
        force_n = self.force_limit_n or np.inf
        return SafetyLimits(
            linear_m_s=self.maximum_linear_m_s,
            angular_rad_s=self.maximum_angular_rad_s,
            linear_m_s2=self.maximum_linear_m_s2,
            angular_rad_s2=self.maximum_angular_rad_s2,
            stop_within_s=self.stop_within_s,
            tick_s=1.0 / CONTROL_RATE_HZ,
            delay_s=self.maximum_delay_s,
            half_box_m=0.5 * np.array(self.workspace_m),
            turn_rad=self.maximum_turn_rad,
            reaction_s=self.reaction_s,
            force_n=force_n,
            release_n=self.force_release_share * force_n,
            retreat_m_s=self.retreat_m_s,
            retreat_m=self.retreat_m,
            resumes=self.resume_when_fresh,
        )

    def control(self) -> ControlSettings:
        """Return how commands are given."""
        return ControlSettings(
            along_tool=self.command_frame == TOOL_FRAME,
            interpolates=self.command_rate_hz == CONTROL_RATE_HZ,
            period_s=1.0 / POLICY_RATE_HZ,
            lead_s=self.command_lead_s,
            righting_gain_per_s=self.orientation_gain_per_s if self.hold_orientation else 0.0,
            righting_limit_rad_s=self.orientation_limit_rad_s,
        )
