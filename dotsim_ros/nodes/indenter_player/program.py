# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `indenter_player` plays: the motion that its parameters ask for, and recorded forces.

Scripted motions meet a pad in its middle, along the base frame's z axis. There a pad is as the apex
of a dome as high as the pad is thick, for all but a slide. Needs no ROS.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dotsim_ros.data.motion import Motion, at_speed, joined
from dotsim_ros.data.scripted import (
    Site,
    in_sequence,
    press_hold_release,
    slide,
    travel,
    twist,
)
from dotsim_ros.data.shipped_presses import ShippedPress, read_presses
from dotsim_ros.data.trajectory import Topics, read_trajectory
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import value_text
from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.indenter_player.parameters import PlayerParameters
from dotsim_ros.specification import GelSpecification, load_sensor

SHIPPED_PRESSES = "presses/densetact_presses.npz"
DEFAULT_RATE_HZ = 100.0
DOME = "dome"


@dataclass(frozen=True)
class PlayedForces:
    """Forces of the gel on the indenter, at increasing times of a motion.

    Attributes:
        time_s: (N,) from the first pose of the motion.
        force_n: (N, 3).
        frame_id: the frame they are expressed in.
    """

    time_s: FloatArray
    force_n: FloatArray
    frame_id: str

    def at(self, time_s: float) -> FloatArray:
        """Return the force (3,) at a time: between two it is linear, outside of them the nearest
        holds."""
        return np.array([np.interp(time_s, self.time_s, share_n) for share_n in self.force_n.T])


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


def _pad_site(gel: GelSpecification, site: Site, *, depth_m: float) -> Site:
    """Return a place of a dome as that of a pad.

    Raises:
        ValueError: it is not the middle, or the press is as deep as the pad is thick.
    """
    if site.tilt_rad != 0.0:
        raise ValueError(
            f"tilt_deg is {np.rad2deg(site.tilt_rad):g}, but the sensor has a pad, which is met in "
            "its middle: leave tilt_deg at 0"
        )
    if not depth_m < gel.thickness_m:
        raise ValueError(
            f"depth_m is {depth_m}, expected less than the thickness of the sensor's pad, "
            f"{gel.thickness_m} m"
        )
    return replace(site, outer_radius_m=gel.thickness_m)


def _pad_slide(
    gel: GelSpecification,
    site: Site,
    *,
    depth_m: float,
    distance_m: float,
    heading_rad: float,
    speed_m_s: float,
    slide_speed_m_s: float,
) -> Motion:
    """Return a press in the middle of a pad, a straight slide across its face, and the release.

    The heading is in the indenter's frame, from its +x towards its +y.

    Raises:
        ValueError: the slide leaves the pad.
    """
    clear, deep = site.pose(-site.clearance_m), site.pose(depth_m)
    heading = deep.rotation() @ np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    away_m = distance_m * heading
    upper_m = np.array(gel.bounds_m[1])
    if (np.abs(away_m[:2]) > upper_m[:2]).any():
        raise ValueError(
            f"the slide of {distance_m} m leaves the pad, which reaches {upper_m[0]} m along x and "
            f"{upper_m[1]} m along y from its middle; shorten it or change its heading"
        )
    end, off = (Pose(pose.position_m + away_m, pose.quaternion_xyzw) for pose in (deep, clear))
    return joined(
        at_speed([clear, deep], speed_m_s=speed_m_s),
        at_speed([deep, end], speed_m_s=slide_speed_m_s),
        at_speed([end, off], speed_m_s=speed_m_s),
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


def _presses(parameters: PlayerParameters, gel: GelSpecification) -> Motion:
    if gel.shape != DOME:
        raise ValueError(
            f"source is presses, which were recorded on a dome, but the sensor "
            f"{value_text(parameters.sensor)} has a pad: set source to press, slide or twist"
        )
    path = parameters.path or parameter_path(SHIPPED_PRESSES)
    motions = [
        press.motion(
            outer_radius_m=parameters.outer_radius_m or gel.outer_radius_m,
            indenter_radius_m=parameters.indenter_radius_m,
            speed_m_s=parameters.speed_m_s,
            hold_s=parameters.hold_s,
            depth_limit_m=parameters.depth_limit_m or np.inf,
            clearance_m=parameters.clearance_m,
        )
        for press in _chosen(read_presses(path), parameters.press_numbers)
    ]
    return in_sequence(motions)


def _motion(parameters: PlayerParameters) -> Motion:
    """Return the motion against the sensor's gel that the parameters ask for."""
    gel, depth_m = load_sensor(parameters.sensor).gel, parameters.depth_m
    if parameters.source == "presses":
        return _presses(parameters, gel)
    site = Site(
        outer_radius_m=parameters.outer_radius_m or gel.outer_radius_m,
        tilt_rad=float(np.deg2rad(parameters.tilt_deg)),
        azimuth_rad=float(np.deg2rad(parameters.azimuth_deg)),
        spin_rad=float(np.deg2rad(parameters.spin_deg)),
        clearance_m=parameters.clearance_m,
    )
    if gel.shape != DOME:
        site = _pad_site(gel, site, depth_m=depth_m)
    speed_m_s = parameters.speed_m_s
    if parameters.source == "press":
        return press_hold_release(
            site, depth_m=depth_m, hold_s=parameters.hold_s, speed_m_s=speed_m_s
        )
    if parameters.source == "twist":
        return twist(
            site,
            depth_m=depth_m,
            angle_rad=float(np.deg2rad(parameters.twist_angle_deg)),
            speed_m_s=speed_m_s,
            rotation_rate_rad_s=float(np.deg2rad(parameters.twist_rate_deg_s)),
        )
    move = slide if gel.shape == DOME else partial(_pad_slide, gel)
    return move(
        site,
        depth_m=depth_m,
        distance_m=parameters.slide_distance_m,
        heading_rad=float(np.deg2rad(parameters.slide_heading_deg)),
        speed_m_s=speed_m_s,
        slide_speed_m_s=parameters.slide_speed_m_s,
    )


def _bag(parameters: PlayerParameters) -> Program:
    force_topic = parameters.bag_force_topic
    topics = Topics(pose=parameters.bag_topic, wrench=force_topic)
    channels = ["pose", "wrench"] if force_topic else ["pose"]
    recording = read_trajectory(parameters.path, topics=topics, channels=channels)
    channel, wrench = recording.pose, recording.wrench
    if channel is None or (force_topic and wrench is None):
        absent = parameters.bag_topic if channel is None else force_topic
        raise ValueError(f"{parameters.path} holds no message on {absent}: name the bag's topic")
    first_ns, forces = channel.stamp_ns[0], None
    if wrench is not None:
        time_s = np.asarray(1e-9 * (wrench.stamp_ns - first_ns), dtype=np.float64)
        forces = PlayedForces(time_s, wrench.force_n, wrench.frame_id)
    motion = Motion((channel.stamp_ns - first_ns) * 1e-9, tuple(channel.poses()))
    return Program(motion, channel.frame_id, parameters.rate_hz, forces)


def program_of(parameters: PlayerParameters) -> Program:
    """Return what the parameters ask to play.

    Raises:
        FileNotFoundError: no file or bag at `path`, or no such sensor.
        ValueError: it cannot be read, or the motion is impossible.
    """
    if parameters.source == "bag":
        program = _bag(parameters)
    else:
        program = Program(
            _motion(parameters), parameters.frame_id, parameters.rate_hz or DEFAULT_RATE_HZ
        )
    if parameters.loop:
        back = travel(program.motion.poses[-1], program.motion.poses[0])
        program = replace(program, motion=joined(program.motion, back))
    return program
