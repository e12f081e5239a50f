# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera behind the gel: an equidistant fisheye that sees beyond 90 degrees, or a pinhole.

The fisheye is that of OpenCV's fisheye module and CameraInfo's `equidistant` (Kannala and Brandt,
"A generic camera model and calibration method for conventional, wide-angle, and fish-eye lenses",
2006): a ray at angle theta from the optical axis meets the image at the distance
`focal * theta_d` from the principal point, with
theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8). OpenCV's functions divide
by z and so end at 90 degrees; these use the angle itself.

The pinhole is that of OpenCV's `projectPoints` and of CameraInfo's `plumb_bob` with k3 = 0 (Brown,
"Close-range camera calibration", 1971): a ray (x, y, 1) meets the image at the focal length times
x (1 + k1 r^2 + k2 r^4) + 2 p1 x y + p2 (r^2 + 2 x^2) along x, and
y (1 + k1 r^2 + k2 r^4) + p1 (r^2 + 2 y^2) + 2 p2 x y along y, with r^2 = x^2 + y^2.

Pixel coordinates are (x, y) with the centre of the first pixel at (0, 0).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from dotsim_ros.specification import CameraSpecification

LARGEST_TANGENT = 12.0
"""Of the angle from the axis that a pinhole still images: 85 degrees."""


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
    result = np.full(target.size, np.nan)
    # Of those that are still sought: few need many steps.
    place = np.flatnonzero(target.ravel() <= limit)
    sought = target.ravel()[place]
    angle = np.minimum(sought, widest)
    lower, upper = np.zeros_like(sought), np.full_like(sought, widest)
    # Newton kept inside a shrinking bracket: theta_d flattens towards the widest angle.
    for _ in range(60):
        error = distorted_angle(angle, distortion) - sought
        result[place] = angle
        is_off = np.abs(error) >= 1e-14
        if not is_off.any():
            break
        place, sought, angle, error = place[is_off], sought[is_off], angle[is_off], error[is_off]
        lower = np.where(error < 0.0, angle, lower[is_off])
        upper = np.where(error < 0.0, upper[is_off], angle)
        slope = _distorted_slope(angle, distortion)
        step = angle - error / np.where(slope > 1e-12, slope, np.inf)
        inside = (step > lower) & (step < upper) & (slope > 1e-12)
        angle = np.where(inside, step, 0.5 * (lower + upper))
    return result.reshape(target.shape)


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


def _brown(across: FloatArray, distortion: FloatArray) -> FloatArray:
    """Return where Brown's model images rays (..., 2) of unit z, over the focal length."""
    x, y = across[..., 0], across[..., 1]
    k1, k2, p1, p2 = distortion
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * k2)
    return np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
            y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )


def _brown_slope(across: FloatArray, distortion: FloatArray) -> FloatArray:
    """Return the derivatives (..., 2, 2) of `_brown`."""
    x, y = across[..., 0], across[..., 1]
    k1, k2, p1, p2 = distortion
    square = x * x + y * y
    radial, growth = 1.0 + square * (k1 + square * k2), 2.0 * (k1 + 2.0 * square * k2)
    mixed = x * y * growth + 2.0 * (p1 * x + p2 * y)
    along_x = radial + x * x * growth + 2.0 * p1 * y + 6.0 * p2 * x
    along_y = radial + y * y * growth + 6.0 * p1 * y + 2.0 * p2 * x
    return np.stack([np.stack([along_x, mixed], -1), np.stack([mixed, along_y], -1)], -2)


def _from_brown(distorted: FloatArray, distortion: FloatArray, widest: float) -> FloatArray:
    """Return the rays (..., 2) of unit z of `_brown`'s places; NaN where none within the widest
    tangent has it."""
    across = np.array(distorted)
    if np.any(distortion):
        for _ in range(30):
            error = _brown(across, distortion) - distorted
            slope = _brown_slope(across, distortion)
            determinant = slope[..., 0, 0] * slope[..., 1, 1] - slope[..., 0, 1] ** 2
            determinant = np.where(np.abs(determinant) > 1e-9, determinant, np.nan)
            step_x = slope[..., 1, 1] * error[..., 0] - slope[..., 0, 1] * error[..., 1]
            step_y = slope[..., 0, 0] * error[..., 1] - slope[..., 0, 1] * error[..., 0]
            across = across - np.stack([step_x, step_y], -1) / determinant[..., None]
        missed = np.abs(_brown(across, distortion) - distorted).max(axis=-1)
        across[~(missed < 1e-9)] = np.nan
    beyond = ~(np.hypot(across[..., 0], across[..., 1]) <= widest)
    return np.where(beyond[..., None], np.nan, across)


@dataclass(frozen=True)
class Camera(ABC):
    """A camera at a fixed pose, without its projection.

    Attributes:
        width: pixels along x.
        height: pixels along y.
        focal_px: pixels a radian near the optical axis, along y.
        principal_point_px: (2,) where the optical axis meets the image, x then y.
        distortion: (4,) coefficients of the projection.
        pose: the optical frame (z forward, x right, y down) in the base frame.
        pixel_aspect: the focal length along x over that along y.

    Raises:
        ValueError: a size, the focal length or the aspect is not positive, or a number is missing
            or not finite.
    """

    projection: ClassVar[str]
    """As a sensor's file names it."""

    width: int
    height: int
    focal_px: float
    principal_point_px: FloatArray
    distortion: FloatArray = field(default_factory=lambda: np.zeros(4))
    pose: Pose = field(default_factory=Pose)
    pixel_aspect: float = 1.0

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(
                f"image size is {self.width}x{self.height}, expected at least one pixel each way"
            )
        for name in ("focal_px", "pixel_aspect"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value}, expected a positive number")
        for name, length in (("principal_point_px", 2), ("distortion", 4)):
            array = np.array(getattr(self, name), dtype=np.float64).reshape(-1)
            if array.shape != (length,) or not np.all(np.isfinite(array)):
                raise ValueError(f"{name} is {array.tolist()}, expected {length} finite numbers")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @staticmethod
    def from_specification(specification: CameraSpecification) -> Camera:
        """Return the camera of a sensor's file, of the projection that it names.

        `half_height_angle_deg` sets the focal length as if there were no distortion. The
        distortion then acts on top of it.
        """
        kind = CAMERAS[specification.projection]
        return kind(
            width=specification.width,
            height=specification.height,
            focal_px=kind.focal_of(
                0.5 * specification.height, float(np.radians(specification.half_height_angle_deg))
            ),
            principal_point_px=np.asarray(specification.principal_point_px, dtype=np.float64),
            distortion=np.asarray(specification.distortion, dtype=np.float64),
            pose=Pose(
                np.asarray(specification.position_m), np.asarray(specification.quaternion_xyzw)
            ),
            pixel_aspect=specification.pixel_aspect,
        )

    @property
    def focal_xy_px(self) -> FloatArray:
        """Return the focal lengths (2,) along x and y, fx and fy of CameraInfo."""
        return np.array([self.pixel_aspect * self.focal_px, self.focal_px])

    @staticmethod
    @abstractmethod
    def focal_of(radius_px: float, angle_rad: float) -> float:
        """Return the focal length (px) without distortion, by the distance from the principal point
        at which a ray at an angle from the axis meets the image."""

    @property
    @abstractmethod
    def half_height_angle_rad(self) -> float:
        """Return the angle from the axis that is seen at half the height, without distortion."""

    @property
    @abstractmethod
    def widest_angle_rad(self) -> float:
        """Return the largest angle from the axis that has an image of its own."""

    @property
    @abstractmethod
    def edge_curvature(self) -> float:
        """Return a bound of how strongly the image bends straight edges, times the focal length."""

    @abstractmethod
    def project_optical(self, points_optical_m: ArrayLike) -> FloatArray:
        """Return pixels (..., 2) of points (..., 3) of the optical frame; NaN where the projection
        has no image of it, or at the camera's own position."""

    @abstractmethod
    def unproject(self, pixels: ArrayLike) -> FloatArray:
        """Return unit directions (..., 3) in the optical frame of pixels (..., 2); NaN where no
        direction has this image."""

    def part(self, x: int, y: int, width: int, height: int) -> Self:
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

    def scaled(self, width: int, height: int) -> Self:
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
        return replace(
            self,
            width=width,
            height=height,
            focal_px=self.focal_px * scale,
            principal_point_px=(self.principal_point_px + 0.5) * scale - 0.5,
        )

    def to_optical(self, points_base_m: ArrayLike) -> FloatArray:
        """Return points (..., 3) of the base frame in the optical frame."""
        offset = np.asarray(points_base_m, dtype=np.float64) - self.pose.position_m
        return offset @ self.pose.rotation()

    def project(self, points_base_m: ArrayLike) -> FloatArray:
        """Return pixels (..., 2) of points (..., 3) of the base frame, as `project_optical`."""
        return self.project_optical(self.to_optical(points_base_m))

    def rays(self) -> tuple[FloatArray, BoolArray]:
        """Return the unit directions (H, W, 3) of all pixels' centres in the optical frame, and
        where (H, W) the model has one; directions elsewhere are NaN."""
        x, y = np.meshgrid(np.arange(self.width), np.arange(self.height))
        directions = self.unproject(np.stack([x, y], axis=-1))
        return directions, np.isfinite(directions[..., 2])


@dataclass(frozen=True)
class FisheyeCamera(Camera):
    """An equidistant fisheye, whose points may lie in any direction.

    `focal_px` are pixels a radian, and `distortion` (4,) is k1..k4.
    """

    projection: ClassVar[str] = "equidistant"

    @staticmethod
    def focal_of(radius_px: float, angle_rad: float) -> float:
        return radius_px / angle_rad

    @property
    def half_height_angle_rad(self) -> float:
        return 0.5 * self.height / self.focal_px

    @property
    def widest_angle_rad(self) -> float:
        return _widest_angle(self.distortion)

    @property
    def edge_curvature(self) -> float:
        # That of the plain lens is below 0.65.
        return 0.8

    def project_optical(self, points_optical_m: ArrayLike) -> FloatArray:
        points = np.asarray(points_optical_m, dtype=np.float64)
        across = np.hypot(points[..., 0], points[..., 1])
        angle = np.arctan2(across, points[..., 2])
        seen = (angle <= self.widest_angle_rad) & ((across > 0.0) | (points[..., 2] > 0.0))
        radius = np.where(seen, distorted_angle(angle, self.distortion), np.nan)
        direction = points[..., :2] / np.where(across > 0.0, across, 1.0)[..., None]
        return self.focal_xy_px * radius[..., None] * direction + self.principal_point_px

    def unproject(self, pixels: ArrayLike) -> FloatArray:
        offset = (np.asarray(pixels, dtype=np.float64) - self.principal_point_px) / self.focal_xy_px
        distorted = np.hypot(offset[..., 0], offset[..., 1])
        angle = angle_from_distorted(distorted, self.distortion)
        across = np.sin(angle) / np.where(distorted > 0.0, distorted, 1.0)
        return np.stack([across * offset[..., 0], across * offset[..., 1], np.cos(angle)], axis=-1)


@dataclass(frozen=True)
class PinholeCamera(Camera):
    """A pinhole camera with Brown's distortion, which sees what is in front of it.

    `focal_px` are pixels where the ray's tangent is 1, and `distortion` (4,) is k1, k2, p1, p2.
    """

    projection: ClassVar[str] = "pinhole"

    @staticmethod
    def focal_of(radius_px: float, angle_rad: float) -> float:
        return radius_px / float(np.tan(angle_rad))

    @property
    def half_height_angle_rad(self) -> float:
        return float(np.arctan(0.5 * self.height / self.focal_px))

    @property
    def widest_angle_rad(self) -> float:
        return float(np.arctan(self._widest_tangent))

    @property
    def _widest_tangent(self) -> float:
        """Return the tangent up to which the radial part of the distortion grows."""
        k1, k2 = self.distortion[:2]
        # Of 1 + 3 k1 r^2 + 5 k2 r^4, in r^2; a coefficient too small to matter is none.
        slope = np.array([1.0, 3.0 * k1, 5.0 * k2])
        slope[np.abs(slope) * LARGEST_TANGENT ** (2.0 * np.arange(3)) < 1e-15] = 0.0
        roots = np.polynomial.polynomial.polyroots(np.trim_zeros(slope, "b"))
        real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0.0)]
        return float(np.sqrt(min(real.min(initial=np.inf), LARGEST_TANGENT**2)))

    @property
    def edge_curvature(self) -> float:
        # Second derivatives of the distortion at 45 degrees from the axis.
        return float(np.abs(self.distortion) @ np.array([6.0, 20.0, 6.0, 6.0]))

    def project_optical(self, points_optical_m: ArrayLike) -> FloatArray:
        points = np.asarray(points_optical_m, dtype=np.float64)
        height = points[..., 2:]
        across = points[..., :2] / np.where(height > 0.0, height, np.nan)
        seen = np.hypot(across[..., :1], across[..., 1:]) <= self._widest_tangent
        place = _brown(np.where(seen, across, np.nan), self.distortion)
        return self.focal_xy_px * place + self.principal_point_px

    def unproject(self, pixels: ArrayLike) -> FloatArray:
        place = (np.asarray(pixels, dtype=np.float64) - self.principal_point_px) / self.focal_xy_px
        across = _from_brown(place, self.distortion, self._widest_tangent)
        direction = np.concatenate([across, np.ones_like(across[..., :1])], axis=-1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return np.where(np.isfinite(direction[..., :1]), direction, np.nan)


CAMERAS: dict[str, type[Camera]] = {
    kind.projection: kind for kind in (FisheyeCamera, PinholeCamera)
}
"""By their projection."""


def middle_part(size_px: tuple[int, int], shape_px: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return the largest part (left, top, width, height) in the middle of an image (width, height)
    that has the shape of another size."""
    width, height = size_px
    scale = min(width / shape_px[0], height / shape_px[1])
    across, down = max(1, round(shape_px[0] * scale)), max(1, round(shape_px[1] * scale))
    return (width - across) // 2, (height - down) // 2, across, down
