# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The calibration that `camera_info` shows in place of the simulated camera's own intrinsics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sensor_msgs.srv import SetCameraInfo

import msg_adapters
from dotsim_ros.nodes.common.guarded_node import GuardedNode
from dotsim_ros.nodes.tactile_sim.calibration_file import (
    path_of_url,
    read_calibration,
    write_calibration,
)
from msg_adapters import CameraCalibration


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
        node: GuardedNode,
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
        calibration = msg_adapters.decode_calibration(request.camera_info)
        self._check(calibration)
        response.status_message = "taken until the node ends: no camera_info_url is set"
        if self._path is not None:
            # First, since it may fail: one that is not kept must not be shown.
            write_calibration(self._path, calibration, name=self._camera_name)
            response.status_message = f"taken and written to {self._path}"
        self._on_change(calibration)
        response.success = True
        return response
