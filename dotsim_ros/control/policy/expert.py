# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The expert: it knows where the indenter is, and commands how the sensor should follow a path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dotsim_ros.control.policy.paths import ReferencePath
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class Expert:
    """Goes along a path, and back to it from next to.

    Attributes:
        path: to follow.
        gain_per_s: speed towards the path over the distance from it.
        look_ahead_s: the path is followed as it is so much later: about the time from an image to
            the motion that answers it.
        fading_m: distance from the path at which half of the speed along it is left.
        largest_speed_m_s: of the whole command.
    """

    path: ReferencePath
    gain_per_s: float = 2.5
    look_ahead_s: float = 0.1
    fading_m: float = 1.0e-3
    largest_speed_m_s: float = 0.008

    def relative_velocity_m_s(self, position_m: ArrayLike) -> FloatArray:
        """Return velocities (..., 3) of the indenter relative to the sensor, along its axes.

        Args:
            position_m: (..., 3) places of the indenter in the sensor's frame.
        """
        position = np.asarray(position_m, dtype=np.float64)
        distance, arc = self.path.nearest(position)
        nearest, _, speed = self.path.at(arc)
        _, tangent, speed = self.path.at(arc + self.look_ahead_s * speed)
        share = 1.0 / (1.0 + np.square(distance / self.fading_m))
        velocity = (share * speed)[..., None] * tangent + self.gain_per_s * (nearest - position)
        size = np.linalg.norm(velocity, axis=-1, keepdims=True)
        return np.asarray(
            velocity * np.minimum(1.0, self.largest_speed_m_s / np.maximum(size, 1e-9))
        )

    def command(self, position_m: ArrayLike) -> FloatArray:
        """Return commands (..., 6) to the sensor, along its own axes: m/s, then rad/s.

        The indenter stands still, so the sensor moves the other way. It does not turn: a ball
        feels the same from every side, so touch does not identify an error of orientation.
        """
        linear = -self.relative_velocity_m_s(position_m)
        return np.concatenate([linear, np.zeros_like(linear)], axis=-1)
