# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera: one thread takes frames at the sensor's rate, a robot's loop reads them."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.cameras.configs import ColorMode
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from dotsim_ros.io.files import shipped_names
from dotsim_ros.sensor import FRAME_S
from dotsim_ros.specification import load_sensor
from lerobot_camera_dotsim.config_dotsim import DotsimCameraConfig
from lerobot_camera_dotsim.frames import (
    Frames,
    Image,
    PoseSource,
    SimulatedFrames,
    TopicFrames,
)

READ_PATIENCE_S = 10.0


class DotsimCamera(Camera):
    """A tactile sensor as a camera of LeRobot.

    Args:
        config: what it is.
        pose_source: returns the indenter's pose at a time in seconds from `connect`, in place of
            the press or bag of the configuration; called from the camera's thread.
    """

    def __init__(self, config: DotsimCameraConfig, pose_source: PoseSource | None = None) -> None:
        super().__init__(config)
        self.config = config
        self._pose_source = pose_source
        self._frames: Frames | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._changed = threading.Condition()
        self._newest: Image | None = None
        self._taken_s = 0.0
        self._count = self._read_count = 0
        self._failure: Exception | None = None

    def __repr__(self) -> str:
        return f"DotsimCamera({self.config.topic or self.config.sensor})"

    @property
    def is_connected(self) -> bool:
        """Whether frames are taken."""
        return self._thread is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return the sensors that come with dotsim_ros."""
        found = []
        for name in shipped_names("sensors"):
            camera = load_sensor(name).camera
            profile = {"width": camera.width, "height": camera.height, "fps": 1.0 / FRAME_S}
            found.append(
                {
                    "name": f"Simulated {name}",
                    "type": "dotsim",
                    "id": name,
                    "default_stream_profile": profile,
                }
            )
        return found

    @check_if_already_connected
    def connect(self, warmup: bool = True) -> None:
        """Open the sensor and begin to take frames.

        Args:
            warmup: return when the first frame is there.

        Raises:
            ConnectionError: there is no such sensor, indenter, bag or topic, or no frame came.
            RuntimeError: another size is configured than the sensor's.
        """
        try:
            frames: Frames = (
                TopicFrames(self.config)
                if self.config.topic
                else SimulatedFrames(self.config, self._pose_source)
            )
        except (ValueError, OSError) as error:
            raise ConnectionError(f"{self} cannot be opened: {error}") from error
        size = frames.width, frames.height
        wanted = self.config.width or size[0], self.config.height or size[1]
        if wanted != size:
            frames.close()
            raise RuntimeError(
                f"{self} is configured for {wanted[0]} x {wanted[1]} pixels, expected the sensor's "
                f"{size[0]} x {size[1]}"
            )
        self.width, self.height = size
        self.fps = self.config.fps or round(frames.fps)
        self._frames, self._newest, self._failure = frames, None, None
        self._count = self._read_count = 0
        self._stop.clear()
        self._thread = threading.Thread(target=self._take, name=f"{self}", daemon=True)
        self._thread.start()
        if warmup:
            try:
                self._wait_for(0, READ_PATIENCE_S)
            except (TimeoutError, RuntimeError) as error:
                self.disconnect()
                raise ConnectionError(f"{self} has no first frame: {error}") from error

    def _take(self) -> None:
        """Take frames until the end; where one takes longer than its period, the next is due."""
        assert self._frames is not None
        assert self.fps is not None
        start_s = due_s = time.perf_counter()
        while not self._stop.wait(max(0.0, due_s - time.perf_counter())):
            begun_s = time.perf_counter()
            due_s = max(due_s + 1.0 / self.fps, begun_s)
            try:
                image = self._frames.image(begun_s - start_s)
            except Exception as error:
                # Of the pose source or of the gel; a reader gets it.
                with self._changed:
                    self._failure = error
                    self._changed.notify_all()
                return
            if image is None:
                continue
            # A reader may keep or change what it gets.
            order = (
                slice(None) if self.config.color_mode == ColorMode.RGB else slice(None, None, -1)
            )
            taken = np.ascontiguousarray(image[..., order])
            with self._changed:
                self._newest, self._taken_s = taken, begun_s
                self._count += 1
                self._changed.notify_all()

    def _wait_for(self, count: int, timeout_s: float) -> Image:
        """Return the newest frame as soon as more than `count` were taken."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._count > count or self._failure is not None, timeout_s
            )
            if self._failure is not None:
                raise RuntimeError(f"{self} takes no more frames: {self._failure}")
            if self._count <= count or self._newest is None:
                raise TimeoutError(f"{self} has no new frame after {1e3 * timeout_s:g} ms")
            self._read_count = self._count
            return self._newest.copy()

    @check_if_not_connected
    def read(self, color_mode: ColorMode | None = None) -> Image:
        """Return the next frame (H, W, 3) uint8.

        Raises:
            DeviceNotConnectedError: before `connect`.
            TimeoutError: none came within 10 s.
            RuntimeError: the sensor failed.
        """
        return self._wait_for(self._count, READ_PATIENCE_S)

    @check_if_not_connected
    def async_read(self, timeout_ms: float = 200) -> Image:
        """Return the newest frame that was not read yet; wait for one where there is none.

        Raises:
            As `read`; TimeoutError after `timeout_ms`.
        """
        return self._wait_for(self._read_count, 1e-3 * timeout_ms)

    @check_if_not_connected
    def read_latest(self, max_age_ms: int = 500) -> Image:
        """Return the newest frame at once, read already or not.

        Raises:
            TimeoutError: it is older than `max_age_ms`.
            RuntimeError: there is none yet, or the sensor failed.
        """
        with self._changed:
            if self._newest is None or self._failure is not None:
                raise RuntimeError(f"{self} has no frame: {self._failure or 'none was taken yet'}")
            age_ms = 1e3 * (time.perf_counter() - self._taken_s)
            if age_ms > max_age_ms:
                raise TimeoutError(f"{self}'s newest frame is {age_ms:.0f} ms old")
            return self._newest.copy()

    @check_if_not_connected
    def disconnect(self) -> None:
        """Stop, and give the sensor back."""
        assert self._thread is not None
        assert self._frames is not None
        self._stop.set()
        self._thread.join()
        self._frames.close()
        self._thread = self._frames = None
