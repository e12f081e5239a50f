# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How the image moves from one shape of the skin to another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.io.arrays import FloatArray, IndexArray
from dotsim_ros.optics.renderer import View


def image_motion_px(view: View, triangles: IndexArray, pixel_before: FloatArray) -> FloatArray:
    """Return how far (H, W, 2) what each pixel shows has moved in the image, x then y.

    Args:
        view: of the skin now.
        triangles: (T, 3) of the skin.
        pixel_before: (V, 2) images of the vertices before; NaN where they had none.

    Returns:
        Pixels, linear within each triangle; zero where no skin is seen or it had no image before.
    """
    moved: NDArray[np.float64] = view.vertex_pixel.astype(np.float64) - pixel_before
    second, third = view.barycentric[..., 0], view.barycentric[..., 1]
    weight = np.stack([1.0 - second - third, second, third], axis=-1)
    corners = triangles[np.where(view.mask, view.triangle, 0)]
    motion = np.einsum("hwk,hwkc->hwc", weight, moved[corners])
    seen = view.mask[..., None] & np.isfinite(motion)
    return np.where(seen, motion, 0.0)
