# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `indenter_player` plays, as parameters, and the motion that they ask for. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from dotsim_ros.data.motion import Motion, joined
from dotsim_ros.data.scripted import (
    Site,
    in_sequence,
    press_hold_release,
    slide,
    travel,
    twist,
)
from dotsim_ros.data.shipped_presses import ShippedPress, read_presses
from dotsim_ros.data.trajectory import BASE_FRAME, Topics, read_trajectory
from dotsim_ros.io.documents import value_text
from dotsim_ros.io.files import parameter_path
from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.parameters import READ_ONLY
from dotsim_ros.nodes.indenter_player.forces import PlayedForces
from dotsim_ros.nodes.indenter_player.pad import pad_site, pad_slide
from dotsim_ros.specification import GelSpecification, load_sensor

SHIPPED_PRESSES = "presses/densetact_presses.npz"
DEFAULT_RATE_HZ = 100.0
DOME = "dome"


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


@dataclass(frozen=True)
class Program:
    """What is played: a motion, the frame of its poses, and at which times.

    Attributes:
        motion: the poses of one pass, and of the way back to the start where it is looped.
        frame_id: of the published poses.
        rate_hz: steady rate, or 0 for the motion's own times.
        forces: that go out with the poses; None for none.
    """

    motion: Motion
    frame_id: str
    rate_hz: float
    forces: PlayedForces | None = None


def _radius_m(parameters: PlayerParameters, gel: GelSpecification) -> float:
    return parameters.outer_radius_m or gel.outer_radius_m


def _met(parameters: PlayerParameters) -> tuple[GelSpecification, Site]:
    """Return the gel that a scripted motion meets, and where."""
    gel = load_sensor(parameters.sensor).gel
    site = Site(
        outer_radius_m=_radius_m(parameters, gel),
        tilt_rad=float(np.deg2rad(parameters.tilt_deg)),
        azimuth_rad=float(np.deg2rad(parameters.azimuth_deg)),
        spin_rad=float(np.deg2rad(parameters.spin_deg)),
        clearance_m=parameters.clearance_m,
    )
    if gel.shape != DOME:
        site = pad_site(gel, site, depth_m=parameters.depth_m)
    return gel, site


def _press(parameters: PlayerParameters) -> Motion:
    _, site = _met(parameters)
    return press_hold_release(
        site,
        depth_m=parameters.depth_m,
        hold_s=parameters.hold_s,
        speed_m_s=parameters.speed_m_s,
    )


def _slide(parameters: PlayerParameters) -> Motion:
    gel, site = _met(parameters)
    move = slide if gel.shape == DOME else partial(pad_slide, gel)
    return move(
        site,
        depth_m=parameters.depth_m,
        distance_m=parameters.slide_distance_m,
        heading_rad=float(np.deg2rad(parameters.slide_heading_deg)),
        speed_m_s=parameters.speed_m_s,
        slide_speed_m_s=parameters.slide_speed_m_s,
    )


def _twist(parameters: PlayerParameters) -> Motion:
    _, site = _met(parameters)
    return twist(
        site,
        depth_m=parameters.depth_m,
        angle_rad=float(np.deg2rad(parameters.twist_angle_deg)),
        speed_m_s=parameters.speed_m_s,
        rotation_rate_rad_s=float(np.deg2rad(parameters.twist_rate_deg_s)),
    )


def _chosen(presses: tuple[ShippedPress, ...], numbers: tuple[int, ...]) -> list[ShippedPress]:
    if numbers == (-1,):
        return list(presses)
    wrong = [number for number in numbers if not 0 <= number < len(presses)]
    if wrong or not numbers:
        raise ValueError(
            f"press_numbers holds {list(numbers)}; the recording has presses 0 to "
            f"{len(presses) - 1}"
        )
    return [presses[number] for number in numbers]


def _presses(parameters: PlayerParameters) -> Motion:
    gel = load_sensor(parameters.sensor).gel
    if gel.shape != DOME:
        raise ValueError(
            f"source is presses, which were recorded on a dome, but the sensor "
            f"{value_text(parameters.sensor)} has a pad: set source to press, slide or twist"
        )
    path = parameters.path or parameter_path(SHIPPED_PRESSES)
    motions = [
        press.motion(
            outer_radius_m=_radius_m(parameters, gel),
            indenter_radius_m=parameters.indenter_radius_m,
            speed_m_s=parameters.speed_m_s,
            hold_s=parameters.hold_s,
            depth_limit_m=parameters.depth_limit_m or np.inf,
            clearance_m=parameters.clearance_m,
        )
        for press in _chosen(read_presses(path), parameters.press_numbers)
    ]
    return in_sequence(motions)


SCRIPTS = {"press": _press, "slide": _slide, "twist": _twist, "presses": _presses}


def _bag(parameters: PlayerParameters) -> Program:
    force_topic = parameters.bag_force_topic
    topics = Topics(pose=parameters.bag_topic, wrench=force_topic)
    channels = ["pose", "wrench"] if force_topic else ["pose"]
    recording = read_trajectory(parameters.path, topics=topics, channels=channels)
    channel, wrench = recording.pose, recording.wrench
    if channel is None or (force_topic and wrench is None):
        absent = parameters.bag_topic if channel is None else force_topic
        raise ValueError(f"{parameters.path} holds no message on {absent}: name the bag's topic")
    times_s = (channel.stamp_ns - channel.stamp_ns[0]) * 1e-9
    return Program(
        Motion(times_s, tuple(channel.poses())),
        channel.frame_id,
        parameters.rate_hz,
        None if wrench is None else PlayedForces.recorded(wrench, int(channel.stamp_ns[0])),
    )


def program_of(parameters: PlayerParameters) -> Program:
    """Return what the parameters ask to play.

    Raises:
        FileNotFoundError: no file or bag at `path`, or no such sensor.
        ValueError: it cannot be read, or the motion is impossible.
    """
    if parameters.source == "bag":
        program = _bag(parameters)
    else:
        motion = SCRIPTS[parameters.source](parameters)
        program = Program(motion, parameters.frame_id, parameters.rate_hz or DEFAULT_RATE_HZ)
    if parameters.loop:
        back = travel(program.motion.poses[-1], program.motion.poses[0])
        program = replace(program, motion=joined(program.motion, back))
    return program
