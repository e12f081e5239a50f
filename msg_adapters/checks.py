# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What every adapter checks of the numbers that it is given."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

LONGEST_SHOWN = 16
"""Numbers of a list that a message of ours repeats: somebody else's may hold millions."""
UNIT_TOLERANCE = 1e-3
"""How far a quaternion's length may be from 1: single precision and rounding to three digits."""


def finite_vector(values: ArrayLike, length: int, name: str) -> NDArray[np.float64]:
    """Return a (length,) float64 copy of `values`.

    Raises:
        ValueError: another length, or a number that is not finite.
    """
    vector = np.array(values, dtype=np.float64)
    if vector.shape != (length,):
        raise ValueError(f"{name} needs {length} numbers, got shape {vector.shape}")
    if not np.isfinite(vector).all():
        shown = vector.tolist() if length <= LONGEST_SHOWN else f"one of {length}"
        raise ValueError(f"{name} holds a number that is not finite: {shown}")
    return vector


def unit_quaternion(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return a (4,) quaternion, checked to be of unit length, not changed.

    Raises:
        ValueError: not four finite numbers, or a length that is not 1.
    """
    quaternion = finite_vector(values, 4, name)
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise ValueError(
            f"{name} {quaternion.tolist()} has length {length:.6g}, expected 1 within "
            f"{UNIT_TOLERANCE:g}"
        )
    return quaternion
