# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `tactile_policy`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.control.safety_layer.arm_control import ControlSettings
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.nodes.common.options import check_options, option
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

    policy: str = option(
        "",
        "The policy: a folder that train-policy wrote, or a name below params/policies.",
        read_only=True,
    )
    path: str = option(
        "", "Which of the policy's paths to follow. Empty: its first.", read_only=True
    )
    idle_image: str = option(
        "",
        "Image of the sensor at rest. Empty: call calibrate_idle before set_enabled.",
        is_path=True,
        read_only=True,
    )
    image_transport: str = option(
        RAW,
        "raw: image_raw (Image); compressed: image_raw/compressed (CompressedImage).",
        choices=(RAW, COMPRESSED),
        read_only=True,
    )
    maximum_image_distance: float = option(
        0.0,
        "An image whose distance from the training images is larger stops the arm, since it is "
        "taken for another sensor's. 0: the limit of the policy's card.",
        minimum=0.0,
        maximum=1e9,
        read_only=True,
    )
    command_frame: str = option(
        TOOL_FRAME,
        "Axes of the commands: those of the tool, or those of the arm's base.",
        choices=(TOOL_FRAME, BASE_FRAME),
        read_only=True,
    )
    command_rate_hz: float = option(
        POLICY_RATE_HZ,
        "25: each command of the policy is published once; 100: commands between them are "
        "interpolated linearly.",
        minimum=POLICY_RATE_HZ,
        maximum=CONTROL_RATE_HZ,
        read_only=True,
    )
    command_lead_s: float = option(
        0.0,
        "How long after its image a command takes effect: the commands are extrapolated by as "
        "much. 0: they are published as they are.",
        minimum=0.0,
        maximum=0.2,
        read_only=True,
    )
    maximum_linear_m_s: float = option(
        0.05, "Speed limit of the tool.", minimum=1e-4, maximum=1.0, read_only=True
    )
    maximum_angular_rad_s: float = option(
        0.4, "Limit of the tool's angular speed.", minimum=1e-3, maximum=4.0, read_only=True
    )
    maximum_linear_m_s2: float = option(
        2.5, "Limit of the tool's linear acceleration.", minimum=0.01, maximum=50.0, read_only=True
    )
    maximum_angular_rad_s2: float = option(
        20.0,
        "Limit of the tool's angular acceleration.",
        minimum=0.1,
        maximum=500.0,
        read_only=True,
    )
    workspace_m: tuple[float, float, float] = option(
        (0.12, 0.12, 0.04),
        "Edges of the box that the tool may not leave, along the base's axes, around the pose at "
        "which the node was enabled.",
        minimum=1e-3,
        maximum=2.0,
        read_only=True,
    )
    maximum_turn_rad: float = option(
        0.35,
        "Largest angle by which the tool may be turned from its orientation when the node was "
        "enabled.",
        minimum=1e-3,
        maximum=3.0,
        read_only=True,
    )
    reaction_s: float = option(
        0.1,
        "How long the arm continues before a command takes effect; the margin kept to the "
        "workspace's border follows from it.",
        minimum=0.0,
        maximum=1.0,
        read_only=True,
    )
    stop_within_s: float = option(
        0.08,
        "The commands are zero at the latest this long after the last image, pose or force.",
        minimum=0.06,
        maximum=1.0,
        read_only=True,
    )
    maximum_delay_s: float = option(
        0.25,
        "A message that arrives later than this after its stamp stops the arm.",
        minimum=0.01,
        maximum=1e9,
        read_only=True,
    )
    clock_jump_s: float = option(
        0.5,
        "Stamps that lie further in the future, and a clock that is set by more, stop the arm "
        "until it is enabled again; stamps that run back by more than 20 ms always do.",
        minimum=0.05,
        maximum=1e9,
        read_only=True,
    )
    resume_when_fresh: bool = option(
        True,
        "Resume without a call once messages that were late arrive again; otherwise set_enabled is "
        "needed.",
        read_only=True,
    )
    force_limit_n: float = option(
        8.0,
        "Force on the topic wrench above which the tool retreats. 0: the sensor measures no force, "
        "the topic is not read, and nothing limits the force.",
        minimum=0.0,
        maximum=1000.0,
        read_only=True,
    )
    force_release_share: float = option(
        0.8,
        "The retreat ends below this share of the limit.",
        minimum=0.01,
        maximum=1.0,
        read_only=True,
    )
    retreat_m_s: float = option(
        0.01,
        "Speed of the retreat, along -z of the tool.",
        minimum=1e-4,
        maximum=1.0,
        read_only=True,
    )
    retreat_m: float = option(
        0.02,
        "If the force is still too large after a retreat of this length, the arm stops until it is "
        "enabled again.",
        minimum=1e-4,
        maximum=0.5,
        read_only=True,
    )
    hold_orientation: bool = option(
        True,
        "Turn the tool back to its orientation when the node was enabled, which touch alone does "
        "not identify.",
        read_only=True,
    )
    orientation_gain_per_s: float = option(
        2.0,
        "Gain of that rotation: angular speed for each radian of error.",
        minimum=0.01,
        maximum=20.0,
        read_only=True,
    )
    orientation_limit_rad_s: float = option(
        0.1,
        "Limit of the angular speed of that rotation.",
        minimum=1e-3,
        maximum=4.0,
        read_only=True,
    )
    inference_latency_s: tuple[float, ...] = option(
        (0.0,),
        "In simulated time: from an image to the policy's command: one delay, or evenly spaced "
        "quantiles of it, the smallest first.",
        minimum=0.0,
        maximum=LONGEST_S,
        read_only=True,
    )
    latency_seed: int = option(
        0, "Seed of inference_latency_s.", minimum=0, maximum=2**31 - 1, read_only=True
    )
    realtime_priority: int = option(
        0,
        "Real-time priority (SCHED_RR) of the node's threads, which the system must permit. 0: "
        "none.",
        minimum=0,
        maximum=99,
        read_only=True,
    )
    diagnostics_period_s: float = option(
        1.0, "Period of the diagnostics.", minimum=0.05, maximum=60.0, read_only=True
    )

    def __post_init__(self) -> None:
        check_options(self)
        check_quantiles("inference_latency_s", self.inference_latency_s)
        if len(self.workspace_m) != 3:
            raise ValueError(f"workspace_m needs 3 numbers, got {len(self.workspace_m)}")
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
