# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where and how scripted motions meet a pad: in its middle, along the base frame's z axis.

There a pad is as the apex of a dome as high as the pad is thick, for all but a slide. Needs no ROS.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dotsim_ros.data.motion import Motion, at_speed, joined
from dotsim_ros.data.scripted import Site
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import GelSpecification


def pad_site(gel: GelSpecification, site: Site, *, depth_m: float) -> Site:
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


def pad_slide(
    gel: GelSpecification,
    site: Site,
    *,
    depth_m: float,
    distance_m: float,
    heading_rad: float,
    speed_m_s: float,
    slide_speed_m_s: float,
) -> Motion:
    """Return a press, a straight slide across the base frame's z axis, and the release there.

    Args:
        gel: the pad.
        site: its middle.
        depth_m: how deep, in the middle.
        distance_m: length of the slide.
        heading_rad: its direction in the indenter's frame, from its +x towards its +y.
        speed_m_s: of the tip in the press and the release.
        slide_speed_m_s: along the slide.

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
