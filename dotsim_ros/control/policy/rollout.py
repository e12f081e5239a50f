# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A policy that drives a simulated sensor along its path, in lockstep and without ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame, advance
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.sensor import GelFailureError

APPROACH_S = 2.0
"""Time at the start that is not judged."""
ARM_STEP_S = 0.01
ARM_SPEED_M_S = 0.02
"""The largest speed of the arm, far above the expert's."""


class Arm:
    """The sensor on an arm that follows commands late and slowly, in front of an indenter that
    stands still.

    Args:
        latency_s: from the time of an image to that when its command begins to act.
        time_constant_s: of the first-order approach of the arm's velocity to the command.
    """

    def __init__(
        self, indenter: Pose, *, latency_s: float = 0.06, time_constant_s: float = 0.05
    ) -> None:
        self._indenter = indenter
        self._latency_s, self._time_constant_s = latency_s, time_constant_s
        self._tool = Pose()
        self._velocity, self._wanted = np.zeros(6), np.zeros(6)
        self._coming: deque[tuple[float, FloatArray]] = deque()
        self._time_s = 0.0

    def command(self, velocity: FloatArray) -> None:
        """Take a command (6,) along the sensor's axes; it acts after the arm's latency."""
        speed = float(np.linalg.norm(velocity[:3]))
        limited = velocity * min(1.0, ARM_SPEED_M_S / max(speed, 1e-9))
        self._coming.append((self._time_s + self._latency_s, limited))

    def move(self, duration_s: float) -> Pose:
        """Return the indenter's pose in the sensor's frame after a time."""
        for _ in range(round(duration_s / ARM_STEP_S)):
            while self._coming and self._coming[0][0] <= self._time_s + 1e-9:
                self._wanted = self._coming.popleft()[1]
            share = 1.0 - np.exp(-ARM_STEP_S / self._time_constant_s)
            self._velocity = self._velocity + share * (self._wanted - self._velocity)
            self._tool = advance(
                self._tool,
                self._velocity[:3],
                self._velocity[3:],
                duration_s=ARM_STEP_S,
                along=TwistFrame.OWN,
            )
            self._time_s += ARM_STEP_S
        return self.indenter()

    def indenter(self) -> Pose:
        """Return the indenter's pose in the sensor's frame."""
        turn = self._tool.rotation()
        x, y, z, w = self._tool.quaternion_xyzw
        a, b = np.array([-x, -y, -z]), self._indenter.quaternion_xyzw[:3]
        real = self._indenter.quaternion_xyzw[3]
        quaternion = np.append(w * b + real * a + np.cross(a, b), w * real - a @ b)
        return Pose((self._indenter.position_m - self._tool.position_m) @ turn, quaternion)


def follow(
    driver: Callable[[ImageArray, ImageArray], FloatArray],
    press: Callable[[Pose], ImageArray],
    idle: ImageArray,
    start: Pose,
    *,
    frame_count: int,
    rate_hz: float,
) -> tuple[FloatArray, str]:
    """Return where a policy takes the indenter (F, 3) in the sensor's frame, and why it ended
    early, empty where it did not.

    Args:
        driver: returns the sensor's velocity (6,) along its own axes, as a `Policy` does.
        press: moves the indenter in the sensor's frame and returns the image.
        start: of the indenter in the sensor's frame, where the gel already is.
    """
    mounted = Arm(start)
    places, ended = [], ""
    for _ in range(frame_count):
        pose = mounted.indenter()
        try:
            image = press(pose)
        except (GelFailureError, ValueError) as error:
            ended = str(error)
            break
        places.append(pose.position_m)
        mounted.command(np.asarray(driver(image, idle), dtype=np.float64))
        mounted.move(1.0 / rate_hz)
    return np.reshape(places, (-1, 3)), ended
