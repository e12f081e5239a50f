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

    source: str = quantity(
        "press",
        help="what to play: a scripted press-hold-release, slide or twist, recorded real presses, "
        "or the poses of a bag",
        choices=("press", "slide", "twist", "presses", "bag"),
    )
    path: str = quantity(
        "",
        help="folder of the bag, or the .npz of real presses (empty: the dozen shipped ones)",
        is_path=True,
    )
    bag_topic: str = quantity("/indenter/pose", help="topic of the bag to play (PoseStamped)")
    bag_force_topic: str = quantity(
        "",
        help="topic of the bag (WrenchStamped) whose forces go out on indenter/wrench, one with "
        "the stamp of each pose, for a sensor with control: force; empty: none",
    )
    frame_id: str = quantity(
        BASE_FRAME, help="frame of the published poses; those of a bag keep their own"
    )
    rate_hz: float = quantity(
        0.0,
        help="rate of the poses; 0: the recording's own stamps for a bag, 100 Hz otherwise",
        low=0.0,
        high=1000.0,
    )
    loop: bool = quantity(False, help="repeat the motion until stopped")
    exit_at_end: bool = quantity(False, help="exit with status 0 once everything has been played")
    wait_for_subscriber_s: float = quantity(
        10.0, help="longest wait for subscribers before the first pose", low=0.0, high=3600.0
    )
    subscriber_count: int = quantity(
        1,
        help="how many subscribers to wait for: 2 where a recorder listens next to the sensor",
        low=1,
        high=100,
    )
    wait_for_answer: bool = quantity(
        False,
        help="hold each pose back until a wrench carries the stamp of the one before (lockstep)",
    )
    answer_timeout_s: float = quantity(
        10.0, help="longest wait for that wrench before the next pose", low=0.01, high=3600.0
    )
    sensor: str = quantity(
        "densetact2",
        help="sensor whose skin is met: a name below params/sensors, or the path of a YAML file; "
        "the poses of a bag are played as they are",
    )
    outer_radius_m: float = quantity(
        0.0, help="radius of the dome's skin at rest; 0: that of the sensor", low=0.0, high=1.0
    )
    tilt_deg: float = quantity(
        0.0,
        help="place on a dome: angle from the apex; a pad is met in its middle",
        low=0.0,
        high=90.0,
    )
    azimuth_deg: float = quantity(
        0.0, help="place on a dome: angle about +z, from +x", low=-360.0, high=360.0
    )
    spin_deg: float = quantity(
        0.0, help="rotation of the indenter about its own axis", low=-360.0, high=360.0
    )
    clearance_m: float = quantity(
        0.002, help="gap between skin and tip before and after a press", low=1e-5, high=0.1
    )
    depth_m: float = quantity(0.002, help="depth of a scripted press", low=1e-6, high=0.1)
    speed_m_s: float = quantity(0.005, help="speed of presses", low=1e-5, high=1.0)
    hold_s: float = quantity(
        0.5, help="duration of the hold at the deepest point", low=0.0, high=3600.0
    )
    slide_distance_m: float = quantity(
        0.006, help="length of a slide on the skin", low=1e-5, high=0.1
    )
    slide_heading_deg: float = quantity(
        0.0,
        help="heading of a slide, from the indenter's +x towards its +y",
        low=-360.0,
        high=360.0,
    )
    slide_speed_m_s: float = quantity(0.01, help="speed of a slide", low=1e-5, high=1.0)
    twist_angle_deg: float = quantity(
        30.0, help="angle of a twist, which then turns back", low=-180.0, high=180.0
    )
    twist_rate_deg_s: float = quantity(30.0, help="angular speed of a twist", low=0.01, high=3600.0)
    press_numbers: tuple[int, ...] = quantity(
        (-1,),
        help="which recorded presses to play, in this order; [-1]: all",
        low=-1,
        high=1_000_000,
        any_length=True,
    )
    indenter_radius_m: float = quantity(
        0.004,
        help="distance from the indenter's tip to the point that was recorded: a sphere's radius",
        low=0.0,
        high=0.1,
    )
    depth_limit_m: float = quantity(
        0.0, help="recorded presses turn at this depth; 0: as deep as they went", low=0.0, high=0.1
    )

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
