# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Scripted presses on a dome: press-hold-release, slide, twist, and the way from one to the next.

The dome is a hemisphere about the origin of the base frame, apex on +z. A place on it is given by
its tilt from the apex and its azimuth about +z from +x. The indenter's frame has its origin at the
tip and its +z away from the gel; depth is how far the tip lies below the skin at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.data.motion import Motion, at_speed, held, joined, pose_along, reversed_motion
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.io.arrays import FloatArray

ARC_STEP_RAD = np.deg2rad(1.0)
"""Arcs are cut into chords this long: 0.6 um off the circle at 15.75 mm."""

TRAVEL_SPEED_M_S = 0.04
"""Speed through the air from one press to the next."""


@dataclass(frozen=True)
class Site:
    """Where and how a press meets the dome.

    Attributes:
        outer_radius_m: radius of the dome's skin at rest.
        tilt_rad: angle from the apex, 0 to pi/2.
        azimuth_rad: angle about +z, from +x.
        spin_rad: rotation of the indenter about its own axis.
        clearance_m: gap between skin and tip where a motion begins and ends.

    Raises:
        ValueError: a length that is not positive, or a tilt off the dome.
    """

    outer_radius_m: float = 0.01575
    tilt_rad: float = 0.0
    azimuth_rad: float = 0.0
    spin_rad: float = 0.0
    clearance_m: float = 0.002

    def __post_init__(self) -> None:
        if not (self.outer_radius_m > 0.0 and self.clearance_m > 0.0):
            raise ValueError(
                f"radius {self.outer_radius_m} m and clearance {self.clearance_m} m must be "
                "positive"
            )
        if not 0.0 <= self.tilt_rad <= np.pi / 2:
            raise ValueError(f"tilt of {np.rad2deg(self.tilt_rad):.4g} degrees is not on the dome")

    def direction(self) -> FloatArray:
        """Return the (3,) outward unit vector at this place."""
        sine = np.sin(self.tilt_rad)
        return np.array(
            [
                sine * np.cos(self.azimuth_rad),
                sine * np.sin(self.azimuth_rad),
                np.cos(self.tilt_rad),
            ]
        )

    def pose(self, depth_m: float) -> Pose:
        """Return the indenter's pose at a depth; negative depths are above the skin."""
        direction = self.direction()
        origin = (self.outer_radius_m - depth_m) * direction
        return pose_along(origin, direction, spin_rad=self.spin_rad)


def _check_depth(site: Site, depth_m: float) -> None:
    if not 0.0 < depth_m < site.outer_radius_m:
        raise ValueError(
            f"press depth {depth_m} m must be positive and below the dome's radius of "
            f"{site.outer_radius_m} m"
        )


def _approach(site: Site, depth_m: float, speed_m_s: float) -> Motion:
    _check_depth(site, depth_m)
    return at_speed([site.pose(-site.clearance_m), site.pose(depth_m)], speed_m_s=speed_m_s)


def press_hold_release(
    site: Site, *, depth_m: float, hold_s: float = 0.5, speed_m_s: float = 0.005
) -> Motion:
    """Return a press along the skin's normal, a hold, and the release on the same way."""
    press = _approach(site, depth_m, speed_m_s)
    return joined(press, held(press.poses[-1], hold_s), reversed_motion(press))


def slide(
    site: Site,
    *,
    depth_m: float,
    distance_m: float,
    heading_rad: float = 0.0,
    speed_m_s: float = 0.005,
    slide_speed_m_s: float = 0.01,
) -> Motion:
    """Return a press, a slide along a great circle at the same depth, and the release there.

    Args:
        site: where it begins.
        depth_m: how deep.
        distance_m: arc length of the slide on the skin at rest.
        heading_rad: its direction in the indenter's frame, from its +x towards its +y.
        speed_m_s: of the tip in the press and the release.
        slide_speed_m_s: of the contact along the skin.

    Raises:
        ValueError: a value out of range, or a slide that leaves the dome.
    """
    if not distance_m > 0.0:
        raise ValueError(f"slide distance must be positive, got {distance_m} m")
    press = _approach(site, depth_m, speed_m_s)
    start = press.poses[-1]
    heading = start.rotation() @ np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    axis = np.cross(site.direction(), heading)
    angle = distance_m / site.outer_radius_m
    path = [turned(start, axis, part) for part in _arc(angle)]
    lowest = min(float(pose.position_m[2]) for pose in path)
    if lowest < 0.0:
        raise ValueError(
            f"the slide of {distance_m} m leaves the dome: it reaches {-lowest:.4g} m below the "
            "base plane; shorten it or change its heading"
        )
    tip_speed = slide_speed_m_s * (site.outer_radius_m - depth_m) / site.outer_radius_m
    along = at_speed(path, speed_m_s=tip_speed, rotation_rate_rad_s=np.inf)
    end = turned(press.poses[0], axis, angle)
    return joined(press, along, at_speed([path[-1], end], speed_m_s=speed_m_s))


def twist(
    site: Site,
    *,
    depth_m: float,
    angle_rad: float,
    speed_m_s: float = 0.005,
    rotation_rate_rad_s: float = 0.5,
) -> Motion:
    """Return a press, a turn about the indenter's axis by an angle, either way, and back, and the
    release."""
    if angle_rad == 0.0:
        raise ValueError("a twist needs an angle")
    press = _approach(site, depth_m, speed_m_s)
    start, axis = press.poses[-1], site.direction()
    path = [turned(start, axis, part) for part in _arc(angle_rad)]
    turn = at_speed(path, speed_m_s=speed_m_s, rotation_rate_rad_s=rotation_rate_rad_s)
    return joined(press, turn, reversed_motion(turn), reversed_motion(press))


def travel(start: Pose, end: Pose) -> Motion:
    """Return the way through the air between two poses off the skin: round the dome, not through.

    The origin follows the great circle between the two, its distance from the dome's centre going
    evenly from the one to the other.

    Raises:
        ValueError: a pose at the dome's centre.
    """
    radii = [float(np.linalg.norm(pose.position_m)) for pose in (start, end)]
    if min(radii) == 0.0:
        raise ValueError("no way round the dome from or to its centre")
    first, last = start.position_m / radii[0], end.position_m / radii[1]
    across = last - (first @ last) * first
    sine, cosine = float(np.linalg.norm(across)), float(first @ last)
    if sine < 1e-9:
        # The same direction: straight; the opposite one: over the apex.
        across = np.cross(np.cross(first, [0.0, 0.0, 1.0]), first)
        across = across if np.linalg.norm(across) > 1e-9 else np.array([1.0, 0.0, 0.0])
    across = across / np.linalg.norm(across)
    angles = _arc(float(np.arctan2(sine, cosine)))
    path = [start]
    for index, angle in enumerate(angles[1:-1], start=1):
        part = index / (len(angles) - 1)
        radius = (1.0 - part) * radii[0] + part * radii[1]
        origin = radius * (np.cos(angle) * first + np.sin(angle) * across)
        quaternion = interpolate(start, end, part).quaternion_xyzw
        path.append(Pose(origin, quaternion))
    return at_speed([*path, end], speed_m_s=TRAVEL_SPEED_M_S)


def in_sequence(motions: list[Motion]) -> Motion:
    """Return motions one after the other, with the way round the dome between them.

    Raises:
        ValueError: no motion.
    """
    if not motions:
        raise ValueError("nothing to play: no motion")
    pieces = [motions[0]]
    for motion in motions[1:]:
        pieces += [travel(pieces[-1].poses[-1], motion.poses[0]), motion]
    return joined(*pieces)


def turned(pose: Pose, axis: ArrayLike, angle_rad: float) -> Pose:
    """Return a pose turned about an axis through the base frame's origin."""
    direction = np.asarray(axis, dtype=np.float64)
    direction = direction / np.linalg.norm(direction)
    versor = np.append(np.sin(angle_rad / 2) * direction, np.cos(angle_rad / 2))
    rotation = Pose(np.zeros(3), versor)
    ax, ay, az, aw = rotation.quaternion_xyzw
    bx, by, bz, bw = pose.quaternion_xyzw
    product = [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
    return Pose(rotation.apply(pose.position_m), np.array(product))


def _arc(angle_rad: float) -> FloatArray:
    steps = max(1, int(np.ceil(abs(angle_rad) / ARC_STEP_RAD)))
    return np.linspace(0.0, angle_rad, steps + 1)
