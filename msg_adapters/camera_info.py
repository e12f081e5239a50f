# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/CameraInfo of a fisheye or a pinhole camera (REP 104)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msg_adapters.checks import finite_vector
from msg_adapters.stamps import encode_header
from msg_adapters.types import ROS, Message, MessageTypes

EQUIDISTANT = "equidistant"
PLUMB_BOB = "plumb_bob"
COEFFICIENT_COUNTS = {EQUIDISTANT: 4, PLUMB_BOB: 5}
"""Of the distortion models that a simulated camera has."""
LARGEST_COEFFICIENT_COUNT = 14
"""Of OpenCV's models."""


@dataclass(frozen=True)
class CameraIntrinsics:
    """Intrinsics of an equidistant fisheye, r = f * theta * (1 + k1 theta^2 + ... + k4 theta^8), or
    of a pinhole with Brown's distortion.

    Attributes:
        width: image width in pixels.
        height: image height in pixels.
        focal_px: (2,) focal lengths fx, fy in pixels per radian at the optical axis.
        principal_point_px: (2,) cx, cy.
        distortion: (4,) k1 to k4 of "equidistant", or (5,) k1, k2, p1, p2, k3 of "plumb_bob".
        distortion_model: either of these.
    """

    width: int
    height: int
    focal_px: NDArray[np.float64]
    principal_point_px: NDArray[np.float64]
    distortion: NDArray[np.float64]
    distortion_model: str = EQUIDISTANT


@dataclass(frozen=True)
class CameraCalibration:
    """What a sensor_msgs/CameraInfo says of a camera, of any distortion model.

    Attributes:
        width, height: of the image in pixels.
        distortion_model: "plumb_bob", "equidistant", ...
        distortion: (N,) its coefficients.
        camera_matrix: (3, 3).
        rectification: (3, 3).
        projection: (3, 4).

    Raises:
        ValueError: no size, a matrix of another shape, a number that is not finite, or a camera
            matrix without focal lengths.
    """

    width: int
    height: int
    distortion_model: str
    distortion: NDArray[np.float64]
    camera_matrix: NDArray[np.float64]
    rectification: NDArray[np.float64]
    projection: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise ValueError(f"camera of {self.width} x {self.height} pixels is empty")
        count = np.size(self.distortion)
        if count > LARGEST_COEFFICIENT_COUNT:
            raise ValueError(
                f"distortion has {count} coefficients, expected at most {LARGEST_COEFFICIENT_COUNT}"
            )
        shapes = {
            "distortion": (count,),
            "camera_matrix": (3, 3),
            "rectification": (3, 3),
            "projection": (3, 4),
        }
        for name, shape in shapes.items():
            flat = np.ravel(getattr(self, name))
            checked = finite_vector(flat, int(np.prod(shape)), name).reshape(shape)
            object.__setattr__(self, name, checked)
        if not (self.camera_matrix[0, 0] > 0.0 and self.camera_matrix[1, 1] > 0.0):
            raise ValueError(
                "camera_matrix has no positive focal lengths; zeros mean an uncalibrated camera"
            )


def encode_camera_info(
    *,
    width: int,
    height: int,
    focal_px: ArrayLike,
    principal_point_px: ArrayLike,
    distortion: ArrayLike,
    distortion_model: str = EQUIDISTANT,
    stamp_ns: int,
    frame_id: str,
    types: MessageTypes = ROS,
) -> Message:
    """Return a sensor_msgs/CameraInfo; arguments as `CameraIntrinsics`.

    Raises:
        ValueError: another distortion model or number of coefficients, a size or focal length that
            is not positive, or a number that is not finite.
    """
    focal = finite_vector(np.broadcast_to(np.asarray(focal_px, dtype=float), (2,)), 2, "focal_px")
    centre = finite_vector(principal_point_px, 2, "principal_point_px")
    coefficients = finite_vector(distortion, _coefficient_count(distortion_model), "distortion")
    if width <= 0 or height <= 0 or not (focal > 0.0).all():
        raise ValueError(
            f"camera of {width} x {height} pixels and focal length {focal.tolist()} px: all must "
            "be positive"
        )
    camera_matrix = np.array(
        [[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]]
    )
    calibration = CameraCalibration(
        width=int(width),
        height=int(height),
        distortion_model=distortion_model,
        distortion=coefficients,
        camera_matrix=camera_matrix,
        rectification=np.eye(3),
        projection=np.hstack([camera_matrix, np.zeros((3, 1))]),
    )
    return encode_calibration(calibration, stamp_ns=stamp_ns, frame_id=frame_id, types=types)


def _coefficient_count(distortion_model: str) -> int:
    if distortion_model not in COEFFICIENT_COUNTS:
        raise ValueError(
            f"distortion model {distortion_model!r} is not supported; expected one of "
            f"{', '.join(COEFFICIENT_COUNTS)}"
        )
    return COEFFICIENT_COUNTS[distortion_model]


def encode_calibration(
    calibration: CameraCalibration, *, stamp_ns: int, frame_id: str, types: MessageTypes = ROS
) -> Message:
    """Return a sensor_msgs/CameraInfo of a calibration of any model."""
    return types.make(
        "sensor_msgs/msg/CameraInfo",
        header=encode_header(stamp_ns, frame_id, types=types),
        height=calibration.height,
        width=calibration.width,
        distortion_model=calibration.distortion_model,
        d=types.doubles(calibration.distortion),
        k=types.doubles(calibration.camera_matrix.reshape(-1)),
        r=types.doubles(calibration.rectification.reshape(-1)),
        p=types.doubles(calibration.projection.reshape(-1)),
        binning_x=0,
        binning_y=0,
        roi=types.make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        ),
    )


def decode_calibration(message: Message) -> CameraCalibration:
    """Return the calibration of a sensor_msgs/CameraInfo, of any model.

    Raises:
        ValueError: as `CameraCalibration`.
    """
    return CameraCalibration(
        width=int(message.width),
        height=int(message.height),
        distortion_model=message.distortion_model,
        distortion=np.array(message.d, dtype=np.float64),
        camera_matrix=np.array(message.k, dtype=np.float64),
        rectification=np.array(message.r, dtype=np.float64),
        projection=np.array(message.p, dtype=np.float64),
    )


def decode_camera_info(message: Message) -> CameraIntrinsics:
    """Return the intrinsics of a sensor_msgs/CameraInfo.

    Raises:
        ValueError: another distortion model or number of coefficients, a matrix that is no
            pinhole's, or a number that is not finite.
    """
    count = _coefficient_count(message.distortion_model)
    coefficients = finite_vector(message.d, count, "distortion")
    matrix = finite_vector(message.k, 9, "camera matrix").reshape(3, 3)
    focal = np.array([matrix[0, 0], matrix[1, 1]])
    skew_and_last_row = [matrix[0, 1], matrix[1, 0], matrix[2, 0], matrix[2, 1], matrix[2, 2] - 1.0]
    if not (focal > 0.0).all() or np.any(skew_and_last_row):
        raise ValueError(
            f"camera matrix {matrix.tolist()} is no [fx 0 cx; 0 fy cy; 0 0 1] with positive focal "
            "lengths; a CameraInfo of zeros means an uncalibrated camera"
        )
    if message.width <= 0 or message.height <= 0:
        raise ValueError(f"camera of {message.width} x {message.height} pixels is empty")
    return CameraIntrinsics(
        width=int(message.width),
        height=int(message.height),
        focal_px=focal,
        principal_point_px=matrix[:2, 2].copy(),
        distortion=coefficients,
        distortion_model=message.distortion_model,
    )
