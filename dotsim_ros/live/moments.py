# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the page shows: the scene, the skin at one time, and what the camera sees of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, ImageArray

AT_REST_M = 10e-6
"""A skin that has moved by less is at rest."""


@dataclass(frozen=True)
class Scene:
    """What stays while the indenter moves.

    Attributes:
        rest_m: (V, 3) the skin at rest, base frame.
        triangles: (T, 3) vertex numbers.
        indenter: what presses, drawn by its surface; None where that is not known.
    """

    rest_m: FloatArray
    triangles: NDArray[np.integer]
    indenter: Indenter | None = None

    def is_at_rest(self, skin_m: FloatArray) -> bool:
        """Return whether a skin (V, 3) is the one at rest."""
        return bool(np.abs(skin_m - self.rest_m).max() < AT_REST_M)


@dataclass(frozen=True)
class SkinMoment:
    """The skin at one time.

    Attributes:
        stamp_ns: the time.
        skin_m: (V, 3) base frame.
        force_n, torque_nm: (3,) of the gel on the indenter, base frame, about its origin; None, and
            zero, where they are not known.
        pose: of the indenter, that the skin shows; None where it is away or not known.
        number: of the newest order that the skin shows; 0: of none.
        spent_s: time of the frame before it, camera included; None where it is not known.
        rate_hz: frames a second at the moment; None where the one before is long past.
        is_converged: whether the gel's solver met its tolerance.
        is_behind: whether the indenter is still on its way to where it was ordered.
    """

    stamp_ns: int
    skin_m: FloatArray
    force_n: FloatArray | None
    torque_nm: FloatArray
    pose: Pose | None
    number: int = 0
    spent_s: float | None = None
    rate_hz: float | None = None
    is_converged: bool = True
    is_behind: bool = False


@dataclass(frozen=True)
class Picture:
    """What the camera sees.

    Attributes:
        stamp_ns: the time.
        image: (H, W, 3) uint8, red, green, blue; None where there is none.
        depth_m: (H, W) along the optical axis, NaN where no skin is seen or the ray is 90 degrees
            or more from the axis; None where it is not known.
        rest_depth_m: (H, W) the same of the skin at rest; None where it is not known.
    """

    stamp_ns: int
    image: ImageArray | None
    depth_m: NDArray[np.floating] | None
    rest_depth_m: NDArray[np.floating] | None = None
