# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recorded forces that are played next to the poses. Needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.trajectory import WrenchChannel
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class PlayedForces:
    """Forces of the gel on the indenter, at increasing times of a motion.

    Attributes:
        time_s: (N,) from the first pose of the motion.
        force_n: (N, 3).
        frame_id: the frame they are expressed in.
    """

    time_s: FloatArray
    force_n: FloatArray
    frame_id: str

    @classmethod
    def recorded(cls, wrench: WrenchChannel, first_pose_ns: int) -> PlayedForces:
        """Return the forces of a recording, given the stamp of its first pose."""
        time_s = np.asarray(1e-9 * (wrench.stamp_ns - first_pose_ns), dtype=np.float64)
        return cls(time_s, wrench.force_n, wrench.frame_id)

    def at(self, time_s: float) -> FloatArray:
        """Return the force (3,) at a time: between two it is linear, outside of them the nearest
        holds."""
        return np.array([np.interp(time_s, self.time_s, share_n) for share_n in self.force_n.T])
