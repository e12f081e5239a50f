# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A policy that drives a simulated sensor along its path, in lockstep and without ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dotsim_ros.control.policy.paths import ReferencePath
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame, advance
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.sensor import GelFailureError

APPROACH_S = 2.0
"""Time at the start that is not judged."""
ARM_STEP_S = 0.01
ARM_SPEED_M_S = 0.02
"""The largest speed of the arm, far above the expert's."""


class Driver(Protocol):
    """What a `Policy` is to a roll-out."""

    def __call__(self, image: ImageArray, idle: ImageArray) -> FloatArray:
        """Return (6,) the sensor's velocity along its own axes."""


@dataclass(frozen=True)
class ArmModel:
    """An arm that follows commands late and slowly.

    Attributes:
        latency_s: from the time of an image to that when its command begins to act.
        time_constant_s: of the first-order approach of the arm's velocity to the command.
    """

    latency_s: float = 0.06
    time_constant_s: float = 0.05


class Arm:
    """The sensor on an arm, in front of an indenter that stands still.

    Args:
        model: of the arm.
        indenter: pose of the indenter in the sensor's frame at the start.
    """

    def __init__(self, model: ArmModel, indenter: Pose) -> None:
        self._model, self._indenter = model, indenter
        self._tool = Pose()
        self._velocity, self._wanted = np.zeros(6), np.zeros(6)
        self._coming: deque[tuple[float, FloatArray]] = deque()
        self._time_s = 0.0

    def command(self, velocity: FloatArray) -> None:
        """Take a command (6,) along the sensor's axes; it acts after the arm's latency."""
        speed = float(np.linalg.norm(velocity[:3]))
        limited = velocity * min(1.0, ARM_SPEED_M_S / max(speed, 1e-9))
        self._coming.append((self._time_s + self._model.latency_s, limited))

    def move(self, duration_s: float) -> Pose:
        """Return the indenter's pose in the sensor's frame after a time."""
        for _ in range(round(duration_s / ARM_STEP_S)):
            while self._coming and self._coming[0][0] <= self._time_s + 1e-9:
                self._wanted = self._coming.popleft()[1]
            share = 1.0 - np.exp(-ARM_STEP_S / self._model.time_constant_s)
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


@dataclass(frozen=True)
class RollOut:
    """What happened.

    Attributes:
        path: that was to be followed.
        rate_hz: of the images.
        position_m: (F, 3) places of the indenter in the sensor's frame at the images.
        command: (F, 6) answers to them.
        ended: why it ended before its time; empty where it did not.
    """

    path: ReferencePath
    rate_hz: float
    position_m: FloatArray
    command: FloatArray
    ended: str

    def figures(self) -> dict[str, Any]:
        """Return mean, 95th percentile and largest error after the approach (mm), the time in laps
        over that of the expert, and the duration."""
        judged = self.position_m[round(APPROACH_S * self.rate_hz) :]
        if len(judged) < 2:
            return {"ended": self.ended or "within the approach"}
        error = 1e3 * self.path.nearest(judged)[0]
        duration_s = (len(judged) - 1) / self.rate_hz
        return {
            "mean_error_mm": round(float(error.mean()), 4),
            "p95_error_mm": round(float(np.percentile(error, 95)), 4),
            "largest_error_mm": round(float(error.max()), 4),
            "laps": round(self.path.laps(judged), 3),
            "laps_of_expert": round(duration_s / self.path.lap_s, 3),
            "seconds": round(duration_s, 2),
            "ended": self.ended,
        }


def follow(
    driver: Driver,
    press: Callable[[Pose], ImageArray],
    idle: ImageArray,
    path: ReferencePath,
    start: Pose,
    *,
    frame_count: int,
    rate_hz: float,
    arm: ArmModel | None = None,
) -> RollOut:
    """Return what a policy does.

    Args:
        driver: the policy.
        press: moves the indenter in the sensor's frame and returns the image.
        idle: the image without contact.
        path: that it should follow.
        start: of the indenter in the sensor's frame, where the gel already is.
        frame_count: images until the end.
        rate_hz: of the images.
        arm: that the sensor is mounted on.
    """
    mounted = Arm(arm or ArmModel(), start)
    position, commands, ended = [], [], ""
    for _ in range(frame_count):
        pose = mounted.indenter()
        try:
            image = press(pose)
        except (GelFailureError, ValueError) as error:
            ended = str(error)
            break
        command = np.asarray(driver(image, idle), dtype=np.float64)
        position.append(pose.position_m)
        commands.append(command)
        mounted.command(command)
        mounted.move(1.0 / rate_hz)
    return RollOut(
        path, rate_hz, np.reshape(position, (-1, 3)), np.reshape(commands, (-1, 6)), ended
    )
