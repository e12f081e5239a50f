# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measured presses, and what a model predicts for them: the currency of models and tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class Press:
    """What was measured while one indenter pressed the sensor, F frames.

    Attributes:
        name: of its trajectory.
        indenter: name of the indenter.
        poses: F poses of the indenter's frame (tip, +z out of the gel) in the base frame.
        stamp_s: (F,) increasing.
        skin_position_m: (F, V, 3) of the data set's skin vertices, base frame; None: not measured.
        force_n: (F, 3) of the gel on the indenter, base frame; None: not measured.

    Raises:
        ValueError: no frame, an array of another length, or times that do not increase.
    """

    name: str
    indenter: str
    poses: list[Pose]
    stamp_s: FloatArray
    skin_position_m: FloatArray | None = None
    force_n: FloatArray | None = None

    def __post_init__(self) -> None:
        count = len(self.poses)
        if count == 0 or self.stamp_s.shape != (count,):
            raise ValueError(f"{self.name}: {count} poses and stamps of {self.stamp_s.shape}")
        falls = np.flatnonzero(~(np.diff(self.stamp_s) > 0.0))
        if falls.size:
            raise ValueError(
                f"{self.name}: frame {falls[0] + 1} is not later than the one before; record "
                "increasing stamps"
            )
        skin, force = self.skin_position_m, self.force_n
        if skin is not None and (skin.ndim != 3 or skin.shape[::2] != (count, 3)):
            raise ValueError(f"{self.name}: skin of shape {skin.shape}, expected ({count}, V, 3)")
        if force is not None and force.shape != (count, 3):
            raise ValueError(f"{self.name}: forces of shape {force.shape}, expected ({count}, 3)")

    @property
    def frame_count(self) -> int:
        """Number of frames F."""
        return len(self.poses)


@dataclass(frozen=True)
class Prediction:
    """What a model predicts for the F frames of a press.

    Attributes:
        skin_position_m: (F, V, 3) of the measured skin's vertices, base frame.
        force_n: (F, 3) of the gel on the indenter, base frame; None where a model has no force.
    """

    skin_position_m: FloatArray
    force_n: FloatArray | None = None
