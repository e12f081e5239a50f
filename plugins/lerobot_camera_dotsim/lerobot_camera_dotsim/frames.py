# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the images come from: a sensor of this process, or a topic."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.motion import Motion
from dotsim_ros.data.trajectory import decode_colour, read_trajectory
from dotsim_ros.geometry.pose import ApexPose, Pose
from dotsim_ros.sensor import FRAME_S, TactileSensor
from lerobot_camera_dotsim.config_dotsim import DotsimCameraConfig

Image = NDArray[np.uint8]
PoseSource = Callable[[float], Pose | ApexPose | None]
"""Returns where the indenter is at a time in seconds from `connect`; None: away."""
FIRST_IMAGE_S = 10.0
WAIT_S = 0.1
CLEARANCE_M = 1e-3


class Frames(Protocol):
    """Images of one size (H, W, 3), red, green, blue."""

    width: int
    height: int
    fps: float

    def image(self, time_s: float) -> Image | None:
        """Return the image at a time from the start; None: none has come yet."""

    def close(self) -> None:
        """Give back what was opened."""


def repeated_press(depth_m: float, period_s: float) -> PoseSource:
    """Return a press from above the apex down to a depth and up again, again and again."""

    def pose(time_s: float) -> ApexPose:
        share = 0.5 - 0.5 * math.cos(2.0 * math.pi * time_s / period_s)
        return Pose.above_apex(depth_m=share * (depth_m + CLEARANCE_M) - CLEARANCE_M)

    return pose


def poses_of_bag(path: str) -> PoseSource:
    """Return the poses on /indenter/pose of a bag, again and again.

    Raises:
        FileNotFoundError: no such bag.
        ValueError: it cannot be read, or holds no pose.
    """
    channel = read_trajectory(path, channels=["pose"]).pose
    if channel is None:
        raise ValueError(f"{path} holds no message on /indenter/pose")
    motion = Motion(1e-9 * (channel.stamp_ns - channel.stamp_ns[0]), tuple(channel.poses()))
    return lambda time_s: motion.at(time_s % max(motion.duration_s, FRAME_S))


class SimulatedFrames:
    """A `TactileSensor` whose indenter follows a pose source."""

    def __init__(self, config: DotsimCameraConfig, pose_source: PoseSource | None) -> None:
        self._sensor = TactileSensor.load(config.sensor, indenter=config.indenter)
        camera = self._sensor.specification.camera
        self.width, self.height, self.fps = camera.width, camera.height, 1.0 / FRAME_S
        if pose_source is None:
            pose_source = (
                poses_of_bag(config.bag)
                if config.bag
                else repeated_press(config.press_depth_m, config.press_period_s)
            )
        self._pose_source, self._before_s = pose_source, 0.0

    def image(self, time_s: float) -> Image:
        dt_s = max(time_s - self._before_s, 1e-3)
        self._before_s = time_s
        return self._sensor.step(self._pose_source(time_s), dt_s).image

    def close(self) -> None:
        pass


class TopicFrames:
    """The newest image of a topic."""

    def __init__(self, config: DotsimCameraConfig) -> None:
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
            from sensor_msgs.msg import CompressedImage
            from sensor_msgs.msg import Image as RosImage
        except ImportError as error:
            raise ValueError(
                "the topic of a camera needs ROS 2: source /opt/ros/jazzy, or pip install "
                "'dotsim_ros[ros]'"
            ) from error
        self.fps = 1.0 / FRAME_S
        self._newest: Image | None = None
        self._has_come = threading.Event()
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("lerobot_camera_dotsim", context=self._context)
        kind = CompressedImage if config.topic.endswith("/compressed") else RosImage
        self._node.create_subscription(kind, config.topic, self._take, 1)
        self._executor: Any = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()
        if not self._has_come.wait(FIRST_IMAGE_S) or self._newest is None:
            self.close()
            raise ValueError(
                f"no image came on {config.topic} within {FIRST_IMAGE_S:g} s; expected a node that "
                "publishes it, in this ROS_DOMAIN_ID"
            )
        self.height, self.width = self._newest.shape[:2]

    def _take(self, message: Any) -> None:
        self._newest = decode_colour(message)
        self._has_come.set()

    def image(self, time_s: float) -> Image | None:
        """Wait for the next image, not for long."""
        if not self._has_come.wait(WAIT_S):
            return None
        self._has_come.clear()
        return self._newest

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join(2.0)
        self._node.destroy_node()
        self._context.try_shutdown()
