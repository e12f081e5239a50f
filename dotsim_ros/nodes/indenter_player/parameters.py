# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `indenter_player`. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from dotsim_ros.data.trajectory import BASE_FRAME
from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.parameters import READ_ONLY


@dataclass(frozen=True)
class PlayerParameters:
    """Parameters of `indenter_player`.

    Raises:
        ValueError: a value out of its range, or parameters that do not go together.
    """

    FIXED: ClassVar[str] = READ_ONLY

    source: str = quantity("press", choices=("press", "slide", "twist", "presses", "bag"))
    """what to play: a scripted press-hold-release, slide or twist, recorded real presses, or the
    poses of a bag"""
    path: str = quantity("", is_path=True)
    """folder of the bag, or the .npz of real presses (empty: the dozen shipped ones)"""
    bag_topic: str = quantity("/indenter/pose")
    """topic of the bag to play (PoseStamped)"""
    bag_force_topic: str = quantity("")
    """topic of the bag (WrenchStamped) whose forces go out on indenter/wrench, one with the stamp
    of each pose, for a sensor with control: force; empty: none"""
    frame_id: str = quantity(BASE_FRAME)
    """frame of the published poses; those of a bag keep their own"""
    rate_hz: float = quantity(0.0, low=0.0, high=1000.0)
    """rate of the poses; 0: the recording's own stamps for a bag, 100 Hz otherwise"""
    loop: bool = quantity(False)
    """repeat the motion until stopped"""
    exit_at_end: bool = quantity(False)
    """exit with status 0 once everything has been played"""
    wait_for_subscriber_s: float = quantity(10.0, low=0.0, high=3600.0)
    """longest wait for subscribers before the first pose"""
    subscriber_count: int = quantity(1, low=1, high=100)
    """how many subscribers to wait for: 2 where a recorder listens next to the sensor"""
    wait_for_answer: bool = quantity(False)
    """hold each pose back until a wrench carries the stamp of the one before (lockstep)"""
    answer_timeout_s: float = quantity(10.0, low=0.01, high=3600.0)
    """longest wait for that wrench before the next pose"""
    sensor: str = quantity("densetact2")
    """sensor whose skin is met: a name below params/sensors, or the path of a YAML file; the poses
    of a bag are played as they are"""
    outer_radius_m: float = quantity(0.0, low=0.0, high=1.0)
    """radius of the dome's skin at rest; 0: that of the sensor"""
    tilt_deg: float = quantity(0.0, low=0.0, high=90.0)
    """place on a dome: angle from the apex; a pad is met in its middle"""
    azimuth_deg: float = quantity(0.0, low=-360.0, high=360.0)
    """place on a dome: angle about +z, from +x"""
    spin_deg: float = quantity(0.0, low=-360.0, high=360.0)
    """rotation of the indenter about its own axis"""
    clearance_m: float = quantity(0.002, low=1e-5, high=0.1)
    """gap between skin and tip before and after a press"""
    depth_m: float = quantity(0.002, low=1e-6, high=0.1)
    """depth of a scripted press"""
    speed_m_s: float = quantity(0.005, low=1e-5, high=1.0)
    """speed of presses"""
    hold_s: float = quantity(0.5, low=0.0, high=3600.0)
    """duration of the hold at the deepest point"""
    slide_distance_m: float = quantity(0.006, low=1e-5, high=0.1)
    """length of a slide on the skin"""
    slide_heading_deg: float = quantity(0.0, low=-360.0, high=360.0)
    """heading of a slide, from the indenter's +x towards its +y"""
    slide_speed_m_s: float = quantity(0.01, low=1e-5, high=1.0)
    """speed of a slide"""
    twist_angle_deg: float = quantity(30.0, low=-180.0, high=180.0)
    """angle of a twist, which then turns back"""
    twist_rate_deg_s: float = quantity(30.0, low=0.01, high=3600.0)
    """angular speed of a twist"""
    press_numbers: tuple[int, ...] = quantity((-1,), low=-1, high=1_000_000, any_length=True)
    """which recorded presses to play, in this order; [-1]: all"""
    indenter_radius_m: float = quantity(0.004, low=0.0, high=0.1)
    """distance from the indenter's tip to the point that was recorded: a sphere's radius"""
    depth_limit_m: float = quantity(0.0, low=0.0, high=0.1)
    """recorded presses turn at this depth; 0: as deep as they went"""

    def __post_init__(self) -> None:
        check_fields("", self)
        if self.loop and self.exit_at_end:
            raise ValueError("loop and exit_at_end exclude each other: a loop has no end")
        if self.source == "bag" and not self.path:
            raise ValueError("source 'bag' needs path: the folder of a ROS 2 bag")
        if self.bag_force_topic and self.source != "bag":
            raise ValueError(
                f"bag_force_topic is {self.bag_force_topic!r}, but source is {self.source!r}, "
                "which has no recorded forces: set source to bag, or leave bag_force_topic empty"
            )
