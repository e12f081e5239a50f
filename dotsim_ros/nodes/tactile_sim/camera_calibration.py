# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The calibration that `camera_info` shows in place of the simulated camera's own intrinsics.

The format of its file is that of camera_calibration_parsers, which camera_info_manager and the
calibrator of image_pipeline read and write:
https://github.com/ros-perception/image_common/tree/jazzy/camera_calibration_parsers
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np
import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from numpy.typing import NDArray
from sensor_msgs.srv import SetCameraInfo

import msg_adapters
from dotsim_ros.io.documents import is_number, read_yaml, value_text
from dotsim_ros.io.files import write_text
from dotsim_ros.nodes.common.node import WorkingNode
from msg_adapters import CameraCalibration

EXPECTED = "expected file:///PATH.yaml or package://PACKAGE/PATH.yaml"


def path_of_url(url: str) -> Path:
    """Return the path of a file:// or package:// URL.

    Raises:
        ValueError: another URL, or a package that is not there.
    """
    parts = urlsplit(url)
    path = unquote(parts.path)
    if parts.scheme == "file" and not parts.netloc and len(path) > 1:
        return Path(path)
    if parts.scheme != "package" or not parts.netloc or len(path) < 2:
        raise ValueError(f"camera_info_url is {value_text(url)}, {EXPECTED}")
    try:
        share = get_package_share_directory(parts.netloc)
    # Without a sourced workspace there is nowhere to look, which is an OSError.
    except (PackageNotFoundError, OSError, ValueError):
        raise ValueError(
            f"camera_info_url is {value_text(url)}: no package {parts.netloc!r} is installed; "
            "source its workspace, or give a file:// URL"
        ) from None
    return Path(share) / path[1:]


def read_calibration(path: Path) -> CameraCalibration:
    """Read a calibration.

    Raises:
        FileNotFoundError: no such file.
        OSError: it cannot be opened.
        ValueError: it is no calibration; the message says what is wrong.
    """
    document = read_yaml(path)
    if not isinstance(document, Mapping):
        raise ValueError(f"{path} holds {value_text(document)}, expected a calibration of a camera")
    try:
        return CameraCalibration(
            width=_size(document, "image_width"),
            height=_size(document, "image_height"),
            distortion_model=str(document.get("distortion_model", "plumb_bob")),
            distortion=_numbers(document, "distortion_coefficients"),
            camera_matrix=_numbers(document, "camera_matrix"),
            rectification=_numbers(document, "rectification_matrix"),
            projection=_numbers(document, "projection_matrix"),
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def write_calibration(path: Path, calibration: CameraCalibration, *, name: str) -> None:
    """Write a calibration of the camera of a name, whole or not at all.

    Raises:
        OSError: it could not be written.
    """
    matrices = {
        "camera_matrix": calibration.camera_matrix,
        "distortion_coefficients": calibration.distortion[None],
        "rectification_matrix": calibration.rectification,
        "projection_matrix": calibration.projection,
    }
    document: dict[str, Any] = {
        "image_width": calibration.width,
        "image_height": calibration.height,
        "camera_name": name,
        "distortion_model": calibration.distortion_model,
    }
    for key, matrix in matrices.items():
        rows, columns = matrix.shape
        document[key] = {"rows": rows, "cols": columns, "data": matrix.reshape(-1).tolist()}
    write_text(path, yaml.safe_dump(document, sort_keys=False, default_flow_style=None))


def _size(document: Mapping[Any, Any], key: str) -> int:
    value = document.get(key)
    if not isinstance(value, int) or isinstance(value, bool):
        raise ValueError(f"{key} is {value_text(value)}, expected a number of pixels")
    return value


def _numbers(document: Mapping[Any, Any], key: str) -> NDArray[np.float64]:
    section = document.get(key)
    data = section.get("data") if isinstance(section, Mapping) else None
    if not isinstance(data, list) or not all(map(is_number, data)):
        raise ValueError(f"{key} is {value_text(section)}, expected rows, cols and data of numbers")
    return np.array(data, dtype=np.float64)


class CalibrationStore:
    """Reads a calibration by its URL, and takes and keeps another, as camera_info_manager does.

    Args:
        node: owns the service `set_camera_info`.
        url: of the file; empty for none, a calibration is then kept until the node ends.
        camera_name: for the file.
        check: refuses a calibration by ValueError.
        on_change: takes each calibration that is not refused.

    Raises:
        ValueError: the URL, or the file, is not valid, or `check` refuses it.
        OSError: the file cannot be opened. One that is not there is no error: it may be written.
    """

    def __init__(
        self,
        node: WorkingNode,
        url: str,
        *,
        camera_name: str,
        check: Callable[[CameraCalibration], None],
        on_change: Callable[[CameraCalibration], None],
    ) -> None:
        self._node, self._camera_name = node, camera_name
        self._check, self._on_change = check, on_change
        self._path = path_of_url(url) if url else None
        if self._path is not None and self._path.exists():
            calibration = read_calibration(self._path)
            check(calibration)
            on_change(calibration)
        elif self._path is not None:
            node.get_logger().warning(
                f"camera_info_url: no file {self._path} yet, so camera_info is that of the "
                "simulated camera; set_camera_info writes it"
            )
        node.create_service(SetCameraInfo, "set_camera_info", self._on_set)

    def _on_set(self, request: Any, response: Any) -> Any:
        calibration = msg_adapters.decode_camera_info(request.camera_info)
        self._check(calibration)
        response.status_message = "taken until the node ends: no camera_info_url is set"
        if self._path is not None:
            # First, since it may fail: one that is not kept must not be shown.
            write_calibration(self._path, calibration, name=self._camera_name)
            response.status_message = f"taken and written to {self._path}"
        self._on_change(calibration)
        response.success = True
        return response
