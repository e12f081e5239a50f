# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Moments of the page as a ROS 2 bag, with the topics of `tactile_sim`."""

from __future__ import annotations

import time
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np

import msg_adapters
from dotsim_ros.data.bag import BAG_TYPES, BagFile
from dotsim_ros.data.trajectory import BASE_FRAME, OPTICAL_FRAME
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.live.moments import Picture, SkinMoment

NAME_TOPIC, NAME_TYPE = "/indenter/name", "std_msgs/msg/String"
"""Tells the shape, by its name below params/indenters."""
FLUSH_S = 1.0
DEPTH_STRIDE = 2
"""A whole depth of 640 x 480 is 1.2 MB a frame, more than all the rest."""


class PressRecorder:
    """A bag that grows by what the page shows, from any thread.

    The image is a JPEG file, the depth has every second pixel of every second row. Until `finish`
    the bag lies at its path plus `.partial`, from where `dotsim_ros record --repair` takes it after
    a crash.

    Args:
        path: folder of the bag, which must not exist.
        rest_m: (V, 3) the skin at rest.
        indenter_name: of the shape that presses, for who looks at the bag; "" where it has none.

    Raises:
        FileExistsError: there is something at `path`.
        OSError: it cannot be written.
    """

    def __init__(self, path: Path, rest_m: FloatArray, indenter_name: str) -> None:
        self.path = path
        self.frame_count = 0
        self._rest_m, self._indenter_name = rest_m, indenter_name
        self._lock = Lock()
        self._bag: BagFile | None = BagFile(path, keep_unfinished=True)
        self._flushed_s = time.monotonic()

    def add_skin(self, moment: SkinMoment) -> None:
        """Write the skin, the pose and the wrench of a moment; nothing after `finish`.

        Raises:
            OSError: it does not fit on the disk.
        """
        in_base: dict[str, Any] = {
            "stamp_ns": moment.stamp_ns,
            "frame_id": BASE_FRAME,
            "types": BAG_TYPES,
        }
        messages = {
            "/points": msg_adapters.encode_cloud(
                moment.skin_m, displacement_m=moment.skin_m - self._rest_m, **in_base
            )
        }
        if moment.force_n is not None:
            messages["/wrench"] = msg_adapters.encode_wrench_stamped(
                moment.force_n, moment.torque_nm, **in_base
            )
        if moment.pose is not None:
            # The page knows the pose that the skin shows: of a recording, that is both.
            messages["/indenter/pose"] = messages["/indenter/state"] = (
                msg_adapters.encode_pose_stamped(
                    moment.pose.position_m, moment.pose.quaternion_xyzw, **in_base
                )
            )
        if self._indenter_name and not self.frame_count:
            messages[NAME_TOPIC] = BAG_TYPES.make(NAME_TYPE, data=self._indenter_name)
        self._write(moment.stamp_ns, messages, frame_count=1)

    def add_picture(self, picture: Picture) -> None:
        """Write what the camera sees; nothing after `finish`.

        Raises:
            OSError: it does not fit on the disk.
        """
        optical: dict[str, Any] = {
            "stamp_ns": picture.stamp_ns,
            "frame_id": OPTICAL_FRAME,
            "types": BAG_TYPES,
        }
        messages = {}
        if picture.image is not None:
            messages["/image_raw/compressed"] = msg_adapters.encode_compressed_image(
                picture.image, compression="jpeg", **optical
            )
        if picture.depth_m is not None:
            height, width = picture.depth_m.shape
            depth_m = cv2.resize(
                np.asarray(picture.depth_m, dtype=np.float32),
                (width // DEPTH_STRIDE, height // DEPTH_STRIDE),
                # Never averaged: between skin and nothing lies no skin.
                interpolation=cv2.INTER_NEAREST,
            )
            messages["/depth/image"] = msg_adapters.encode_image(
                depth_m, encoding="32FC1", **optical
            )
        self._write(picture.stamp_ns, messages)

    def _write(
        self, stamp_ns: int, messages: dict[str, msg_adapters.Message], *, frame_count: int = 0
    ) -> None:
        with self._lock:
            if self._bag is None:
                return
            for topic, message in messages.items():
                self._bag.write(topic, stamp_ns, message)
            self.frame_count += frame_count
            if time.monotonic() - self._flushed_s > FLUSH_S:
                self._bag.flush()
                self._flushed_s = time.monotonic()

    def finish(self) -> Path | None:
        """Give the bag its name and return its path; None where nothing was recorded, and then no
        bag is left.

        Raises:
            OSError: not all of it fits on the disk.
        """
        with self._lock:
            bag, self._bag = self._bag, None
            if bag is None:
                return self.path
            if self.frame_count == 0:
                bag.discard()
                return None
            bag.finish()
        return self.path
