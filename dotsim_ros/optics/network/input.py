# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The input of an image network: geometry and warped image of a frame, next to those at rest.

Three arrays, channels first, all values of order one:

- `frame` (7, h, w): unit normal mapped from [-1, 1] to [0, 1] (3), distance along the ray over the
  largest at rest (1), warped image over 255 (3);
- `rest` (10, h, w): the same of the gel untouched, with the idle frame in place of the warped
  image (7), the pixel's place x and y from the principal point over half the height (2), and a
  weight that fades from 1 inside the lit disc to 0 before its rim (1);
- `image` (3, f h, f w): the warped image over 255 at the resolution of what is added, which may be
  finer than the geometry's by a factor f.

Where no skin is seen the geometry is 0 in both. At rest `frame` equals the first seven channels of
`rest` to the last bit, whatever the resolution, so a network can detect that nothing has moved.
"""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import Float32Array, ImageArray
from dotsim_ros.optics.idle import lit_region

FRAME = slice(0, 7)
GEOMETRY = slice(0, 4)
DEPTH = slice(3, 4)
CARRIED = slice(4, 7)
PLACE = slice(7, 9)
FADE = slice(9, 10)
"""Channels; those of `frame` are the first of `rest`."""
FADE_BEGIN_PX, FADE_END_PX = 3.0, 1.5
"""Distances from the rim, in the network's pixels, between which its output fades to nothing. The
second leaves nothing to interpolate beyond the rim where what is added is enlarged."""


Pixels = TypeVar("Pixels", np.uint8, np.float32)


def resized(array: NDArray[Pixels], size: tuple[int, int]) -> NDArray[Pixels]:
    """Return an image (H, W[, C]) at another size (width, height): means of what a pixel covers
    where it shrinks, linear interpolation where it grows."""
    if (array.shape[1], array.shape[0]) == size:
        return array
    shrinks = size[0] < array.shape[1]
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(array, size, interpolation=interpolation), dtype=array.dtype)


class CompletionInput:
    """Brings what a camera sees to the size and the units of a network.

    Args:
        camera: that sees it.
        size: width and height of the geometry.
        fineness: how often wider and higher the images are.
        depth_m: (H, W) distance along the ray of the gel untouched; NaN where no skin is seen.
        normal: (H, W, 3) its unit normal in the optical frame.
        idle: (H, W, 3) uint8, the idle frame.

    Attributes:
        rest: (10, h, w) the input that stays.
        size: width and height of the geometry.

    Raises:
        ValueError: an array is not of the camera's size, or the geometry has another aspect ratio.
    """

    def __init__(
        self,
        camera: Camera,
        size: tuple[int, int],
        *,
        fineness: int,
        depth_m: Float32Array,
        normal: Float32Array,
        idle: ImageArray,
    ) -> None:
        for name, array in (("depth_m", depth_m), ("normal", normal), ("idle", idle)):
            if array.shape[:2] != (camera.height, camera.width):
                raise ValueError(
                    f"{name} at rest is {array.shape[1]}x{array.shape[0]}, expected "
                    f"{camera.width}x{camera.height} as the camera"
                )
        self.size = size
        self._image_size = (fineness * size[0], fineness * size[1])
        self._depth_scale = np.float32(1.0 / np.nanmax(depth_m))
        small = camera.scaled(*size)
        x, y = np.meshgrid(
            np.arange(size[0], dtype=np.float32), np.arange(size[1], dtype=np.float32)
        )
        centre_x, centre_y = small.principal_point_px
        half = 0.5 * size[1]
        # A pixel is lit where all that it covers is.
        lit = (resized(lit_region(idle).astype(np.float32), size) > 0.999).astype(np.uint8)
        distance = cv2.distanceTransform(lit, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        fade = np.clip((distance - FADE_END_PX) / (FADE_BEGIN_PX - FADE_END_PX), 0.0, 1.0)
        self.rest = np.concatenate(
            [
                self.frame(depth_m, normal, idle),
                np.stack([(x - centre_x) / half, (y - centre_y) / half, fade]),
            ]
        ).astype(np.float32)

    def frame(
        self, depth_m: Float32Array, normal: Float32Array, warped: ImageArray
    ) -> Float32Array:
        """Return the input (7, h, w) of one frame.

        Args:
            depth_m: (H, W) distance along the ray; NaN where no skin is seen.
            normal: (H, W, 3) unit normal in the optical frame.
            warped: (H, W, 3) uint8.
        """
        width, height = self.size
        frame = np.empty((FRAME.stop, height, width), dtype=np.float32)
        small = resized(normal, self.size)
        for channel in range(3):
            np.multiply(small[..., channel], 0.5, out=frame[channel])
        frame[:3] += 0.5
        np.multiply(resized(depth_m, self.size), self._depth_scale, out=frame[3])
        # cv2 does it in place, on two dimensions.
        cv2.patchNaNs(frame[:4].reshape(4 * height, width), 0.0)
        frame[CARRIED] = self._planes(warped, self.size)
        return frame

    def image(self, warped: ImageArray) -> Float32Array:
        """Return a warped image (H, W, 3) uint8 as input (3, f h, f w)."""
        return self._planes(warped, self._image_size)

    @staticmethod
    def _planes(image: ImageArray, size: tuple[int, int]) -> Float32Array:
        small = resized(image, size)
        planes = np.empty((3, size[1], size[0]), dtype=np.float32)
        for channel in range(3):
            np.multiply(small[..., channel], np.float32(1.0 / 255.0), out=planes[channel])
        return planes
