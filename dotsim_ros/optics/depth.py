# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a range along the rays of a camera is along its axis, or from the centre of the gel."""

from __future__ import annotations

import numpy as np

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import Float32Array, ImageArray

RADIUS_STEPS = 256.0
"""Of 8 bits, as readers of the DenseTact driver's imgDepth take them."""


class DepthConversion:
    """Converts ranges that one camera sees; what a pixel's ray decides is computed once.

    Args:
        camera: whose image it is.
    """

    def __init__(self, camera: Camera) -> None:
        rays, _ = camera.rays()
        origin = camera.pose.position_m @ camera.pose.rotation()
        with np.errstate(invalid="ignore"):
            ahead = np.where(rays[..., 2] > 0.0, rays[..., 2], np.nan)
        self._along_axis: Float32Array = ahead.astype(np.float32)
        self._origin_along_ray: Float32Array = (rays @ origin).astype(np.float32)
        self._origin_square = np.float32(origin @ origin)

    def axial_m(self, range_m: Float32Array) -> Float32Array:
        """Return (H, W) depth along the optical axis, which is what REP 118 calls depth.

        NaN where the range (H, W) is, and where the ray leaves at 90 degrees from the axis or more,
        for which such a depth says nothing of a place.
        """
        return np.asarray(range_m * self._along_axis, dtype=np.float32)

    def radius_m(self, range_m: Float32Array) -> Float32Array:
        """Return (H, W) distance of the skin from the base frame's origin, the centre of a dome;
        NaN where the range (H, W) is."""
        square = range_m * (range_m + 2.0 * self._origin_along_ray) + self._origin_square
        return np.asarray(np.sqrt(square), dtype=np.float32)


def radius_bytes(radius_m: Float32Array, limits_m: tuple[float, float]) -> ImageArray:
    """Return (H, W) uint8 of radii (H, W), as the DenseTact 2.0 driver encodes them.

    A reader of the driver's imgDepth has radius = value / 256 * (16.88 mm - 12.23 mm) + 12.23 mm
    (depth2Ptcloud in the maker's ROS 1 recorder of touches). It takes the untouched dome as 15.5 mm
    and dents as less, which is a distance from the dome's centre.

    Args:
        radius_m: NaN where there is none, which becomes 0.
        limits_m: radii of value 0 and of value 256; what lies beyond them is clipped.
    """
    low, high = limits_m
    steps = np.rint((radius_m - low) * (RADIUS_STEPS / (high - low)))
    return np.nan_to_num(np.clip(steps, 0.0, 255.0), nan=0.0).astype(np.uint8)
