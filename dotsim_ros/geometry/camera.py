# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera inside the gel: an equidistant fisheye that also sees beyond 90 degrees.

The model is that of OpenCV's fisheye module and of CameraInfo's `equidistant` (Kannala and Brandt,
"A generic camera model and calibration method for conventional, wide-angle, and fish-eye lenses",
2006): a ray at angle theta from the optical axis meets the image at the distance
`focal * theta_d` from the principal point, with
theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8). OpenCV's functions divide
by z and so end at 90 degrees; these use the angle itself.

Pixel coordinates are (x, y) with the centre of the first pixel at (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.arrays import BoolArray, FloatArray
from dotsim_ros.geometry.pose import Pose

if TYPE_CHECKING:
    from dotsim_ros.specification import CameraSpecification


def _widest_angle(distortion: FloatArray) -> float:
    """Return the angle up to which theta_d grows with theta; pi where it always does."""
    slope = np.zeros(9)
    slope[0::2] = np.concatenate([[1.0], distortion * np.array([3.0, 5.0, 7.0, 9.0])])
    # Division by a coefficient too small to matter at any angle overflows.
    slope[np.abs(slope) * np.pi ** np.arange(9) < 1e-15] = 0.0
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(slope, "b"))
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0)]
    return float(min(real.min(initial=np.pi), np.pi))


def angle_from_distorted(distorted: ArrayLike, distortion: FloatArray) -> FloatArray:
    """Return the angle theta (radians) of theta_d (any shape); NaN where no angle has it."""
    target = np.asarray(distorted, dtype=np.float64)
    widest = _widest_angle(distortion)
    limit = float(distorted_angle(widest, distortion))
    lower = np.zeros_like(target)
    upper = np.full_like(target, widest)
    angle = np.minimum(target, widest)
    # Newton kept inside a shrinking bracket: theta_d flattens towards the widest angle.
    for _ in range(60):
        error = distorted_angle(angle, distortion) - target
        lower = np.where(error < 0.0, angle, lower)
        upper = np.where(error < 0.0, upper, angle)
        if np.all((np.abs(error) < 1e-14) | (target > limit)):
            break
        slope = _distorted_slope(angle, distortion)
        step = angle - error / np.where(slope > 1e-12, slope, np.inf)
        inside = (step > lower) & (step < upper) & (slope > 1e-12)
        angle = np.where(inside, step, 0.5 * (lower + upper))
    return np.where(target <= limit, angle, np.nan)


def distorted_angle(angle: ArrayLike, distortion: FloatArray) -> FloatArray:
    """Return theta_d of the angle theta (radians, any shape)."""
    theta = np.asarray(angle, dtype=np.float64)
    square = theta * theta
    k1, k2, k3, k4 = distortion
    return np.asarray(
        theta * (1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4)))),
        dtype=np.float64,
    )


def _distorted_slope(angle: FloatArray, distortion: FloatArray) -> FloatArray:
    square = angle * angle
    k1, k2, k3, k4 = distortion * np.array([3.0, 5.0, 7.0, 9.0])
    return 1.0 + square * (k1 + square * (k2 + square * (k3 + square * k4)))


@dataclass(frozen=True)
class FisheyeCamera:
    """An equidistant fisheye camera at a fixed pose.

    Attributes:
        width: pixels along x.
        height: pixels along y.
        focal_px: pixels a radian.
        principal_point_px: (2,) where the optical axis meets the image, x then y.
        distortion: (4,) k1..k4.
        pose: the optical frame (z forward, x right, y down) in the base frame.

    Raises:
        ValueError: a size or the focal length is not positive, or a number is missing or not
            finite.
    """

    width: int
    height: int
    focal_px: float
    principal_point_px: FloatArray
    distortion: FloatArray = field(default_factory=lambda: np.zeros(4))
    pose: Pose = field(default_factory=Pose)

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(
                f"image size is {self.width}x{self.height}, expected at least one pixel each way"
            )
        if not (np.isfinite(self.focal_px) and self.focal_px > 0.0):
            raise ValueError(f"focal_px is {self.focal_px}, expected a positive number")
        for name, length in (("principal_point_px", 2), ("distortion", 4)):
            array = np.array(getattr(self, name), dtype=np.float64).reshape(-1)
            if array.shape != (length,) or not np.all(np.isfinite(array)):
                raise ValueError(f"{name} is {array.tolist()}, expected {length} finite numbers")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def from_specification(cls, specification: CameraSpecification) -> FisheyeCamera:
        """Return the camera of a sensor's file.

        `half_height_angle_deg` sets the focal length as if there were no distortion: half the
        height divided by that angle. The distortion then acts on top of it.
        """
        return cls(
            width=specification.width,
            height=specification.height,
            focal_px=0.5 * specification.height / np.radians(specification.half_height_angle_deg),
            principal_point_px=np.asarray(specification.principal_point_px, dtype=np.float64),
            distortion=np.asarray(specification.distortion, dtype=np.float64),
            pose=Pose(
                np.asarray(specification.position_m), np.asarray(specification.quaternion_xyzw)
            ),
        )

    @property
    def widest_angle_rad(self) -> float:
        """Return the largest angle from the axis that the distortion gives an image of its own."""
        return _widest_angle(self.distortion)

    def part(self, x: int, y: int, width: int, height: int) -> FisheyeCamera:
        """Return the camera whose image is a part of this one's, cut at its first column and row.

        Raises:
            ValueError: the part reaches beyond the image, or is empty.
        """
        if min(x, y) < 0 or x + width > self.width or y + height > self.height:
            raise ValueError(
                f"the part of {width} x {height} pixels from ({x}, {y}) reaches beyond the image "
                f"of {self.width} x {self.height} pixels"
            )
        return replace(
            self,
            width=width,
            height=height,
            principal_point_px=self.principal_point_px - np.array([x, y]),
        )

    def scaled(self, width: int, height: int) -> FisheyeCamera:
        """Return the camera of the same view with another number of pixels.

        Raises:
            ValueError: the aspect ratio differs by more than half a pixel of the new height.
        """
        scale = width / self.width
        if abs(self.height * scale - height) > 0.5:
            raise ValueError(
                f"{width}x{height} has another aspect ratio than {self.width}x{self.height}; "
                f"expected {width}x{round(self.height * scale)}"
            )
        return FisheyeCamera(
            width=width,
            height=height,
            focal_px=self.focal_px * scale,
            principal_point_px=(self.principal_point_px + 0.5) * scale - 0.5,
            distortion=self.distortion,
            pose=self.pose,
        )

    def to_optical(self, points_base_m: ArrayLike) -> FloatArray:
        """Return points (..., 3) of the base frame in the optical frame."""
        offset = np.asarray(points_base_m, dtype=np.float64) - self.pose.position_m
        return offset @ self.pose.rotation()

    def project_optical(self, points_optical_m: ArrayLike) -> FloatArray:
        """Return pixels (..., 2) of points (..., 3) of the optical frame, in any direction; NaN
        where the distortion has no image of it, or at the camera's own position."""
        points = np.asarray(points_optical_m, dtype=np.float64)
        across = np.hypot(points[..., 0], points[..., 1])
        angle = np.arctan2(across, points[..., 2])
        seen = (angle <= self.widest_angle_rad) & ((across > 0.0) | (points[..., 2] > 0.0))
        radius = np.where(seen, self.focal_px * distorted_angle(angle, self.distortion), np.nan)
        direction = points[..., :2] / np.where(across > 0.0, across, 1.0)[..., None]
        return radius[..., None] * direction + self.principal_point_px

    def project(self, points_base_m: ArrayLike) -> FloatArray:
        """Return pixels (..., 2) of points (..., 3) of the base frame, as `project_optical`."""
        return self.project_optical(self.to_optical(points_base_m))

    def unproject(self, pixels: ArrayLike) -> FloatArray:
        """Return unit directions (..., 3) in the optical frame of pixels (..., 2); NaN where no
        direction has this image."""
        offset = (np.asarray(pixels, dtype=np.float64) - self.principal_point_px) / self.focal_px
        distorted = np.hypot(offset[..., 0], offset[..., 1])
        angle = angle_from_distorted(distorted, self.distortion)
        across = np.sin(angle) / np.where(distorted > 0.0, distorted, 1.0)
        return np.stack([across * offset[..., 0], across * offset[..., 1], np.cos(angle)], axis=-1)

    def rays(self) -> tuple[FloatArray, BoolArray]:
        """Return the unit directions (H, W, 3) of all pixels' centres in the optical frame, and
        where (H, W) the model has one; directions elsewhere are NaN."""
        x, y = np.meshgrid(np.arange(self.width), np.arange(self.height))
        directions = self.unproject(np.stack([x, y], axis=-1))
        return directions, np.isfinite(directions[..., 2])


def camera_of_disc(
    width: int,
    height: int,
    *,
    centre_px: ArrayLike,
    radius_px: float,
    rim_angle_deg: float,
    pose: Pose,
) -> FisheyeCamera:
    """Return the undistorted camera of an image of which only the lit disc is known.

    Args:
        width: pixels along x.
        height: pixels along y.
        centre_px: (2,) the disc's centre, x then y.
        radius_px: the disc's radius.
        rim_angle_deg: the angle from the optical axis that the disc's rim shows.
        pose: the optical frame in the base frame.

    Raises:
        ValueError: radius or angle is not positive, or the angle exceeds 180 degrees.
    """
    if not radius_px > 0.0:
        raise ValueError(f"radius_px is {radius_px}, expected a positive number of pixels")
    if not 0.0 < rim_angle_deg <= 180.0:
        raise ValueError(f"rim_angle_deg is {rim_angle_deg}, expected above 0 and at most 180")
    return FisheyeCamera(
        width=width,
        height=height,
        focal_px=radius_px / np.radians(rim_angle_deg),
        principal_point_px=np.asarray(centre_px, dtype=np.float64),
        pose=pose,
    )
