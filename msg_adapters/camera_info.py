# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/CameraInfo of a fisheye or a pinhole camera (REP 104)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

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

    @property
    def focal_px(self) -> NDArray[np.float64]:
        """(2,) focal lengths fx, fy; of a fisheye pixels per radian at the optical axis."""
        return self.camera_matrix[[0, 1], [0, 1]]

    @property
    def principal_point_px(self) -> NDArray[np.float64]:
        """(2,) cx, cy."""
        return self.camera_matrix[:2, 2]


def calibration_of(
    *,
    width: int,
    height: int,
    focal_px: ArrayLike,
    principal_point_px: ArrayLike,
    distortion: ArrayLike,
    distortion_model: str = EQUIDISTANT,
) -> CameraCalibration:
    """Return the calibration of a camera whose images are not rectified.

    Args:
        width, height: of the image in pixels.
        focal_px: fx and fy, or one for both.
        principal_point_px: cx and cy.
        distortion: k1 to k4 of an equidistant fisheye, r = f * theta * (1 + k1 theta^2 + ... +
            k4 theta^8), or k1, k2, p1, p2, k3 of "plumb_bob", a pinhole with Brown's distortion.
        distortion_model: either of these.

    Raises:
        ValueError: another distortion model or number of coefficients, a size or focal length that
            is not positive, or a number that is not finite.
    """
    if distortion_model not in COEFFICIENT_COUNTS:
        raise ValueError(
            f"distortion model {distortion_model!r} is not supported; expected one of "
            f"{', '.join(COEFFICIENT_COUNTS)}"
        )
    focal = finite_vector(np.broadcast_to(np.asarray(focal_px, dtype=float), (2,)), 2, "focal_px")
    centre = finite_vector(principal_point_px, 2, "principal_point_px")
    camera_matrix = np.array(
        [[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]]
    )
    return CameraCalibration(
        width=int(width),
        height=int(height),
        distortion_model=distortion_model,
        distortion=finite_vector(distortion, COEFFICIENT_COUNTS[distortion_model], "distortion"),
        camera_matrix=camera_matrix,
        rectification=np.eye(3),
        projection=np.hstack([camera_matrix, np.zeros((3, 1))]),
    )


def encode_camera_info(
    *, stamp_ns: int, frame_id: str, types: MessageTypes = ROS, **camera: Any
) -> Message:
    """Return a sensor_msgs/CameraInfo; other arguments and errors as of `calibration_of`."""
    return encode_calibration(
        calibration_of(**camera), stamp_ns=stamp_ns, frame_id=frame_id, types=types
    )


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


def decode_camera_info(message: Message) -> CameraCalibration:
    """Return the calibration in a sensor_msgs/CameraInfo, of any model.

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
