# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the optical effects share: gains, resampling, and what excites them.

An optical effect acts on the camera's numbers after everything else, and keeps them between 0 and
`FULL_SCALE`. Lengths in the image are given in units of the focal length, so that a value found
on images of one size holds for images of another.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.recording import Phase, Recording
from dotsim_ros.effects.effect import SeenImage
from dotsim_ros.geometry.camera import CAMERAS, Camera
from dotsim_ros.io.arrays import FloatArray

FULL_SCALE = 255.0

FAST_M_S = 2.0e-3
"""An indenter that moves faster under load moves the image enough to blur or skew it."""

SourceMap = Callable[[SeenImage], tuple[FloatArray, FloatArray]]
"""Maps an image to x and y (H, W each), px, of the place in it that each new pixel shows."""


def any_frame(recording: Recording) -> bool:
    """Return that a recording excites what every frame shows, also one without contact."""
    return recording.press.frame_count > 0


def moves_fast(recording: Recording) -> bool:
    """Return whether the indenter loads or slides at `FAST_M_S` or faster in any frame."""
    press = recording.press
    position = np.stack([pose.position_m for pose in press.poses])
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / np.diff(press.stamp_s)
    return any(
        phase in (Phase.SLIDE, Phase.LOAD) and fast
        for phase, fast in zip(recording.phase[1:], speed >= FAST_M_S, strict=True)
    )


def within_scale(pixels: FloatArray) -> FloatArray:
    """Return pixels (..., 3) clipped to what the camera can give."""
    return np.clip(pixels, 0.0, FULL_SCALE)


def radius_square(image: SeenImage) -> FloatArray:
    """Return (H, W) the squared distance from the optical axis over half the image's height, the
    coordinate of `dotsim_ros.optics.lighting.Vignetting`."""
    height, width = image.pixels.shape[:2]
    x = np.arange(width) - image.centre_px[0]
    y = np.arange(height) - image.centre_px[1]
    return (x[None, :] ** 2 + y[:, None] ** 2) / (0.5 * height) ** 2


def sampled(pixels: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return pixels (H, W, 3) looked up at places (H, W) in px by cubic interpolation.

    A place outside shows the nearest border, a whole pixel itself, to single precision.
    """
    # OpenCV 5 cuts doubles off to whole numbers.
    found = cv2.remap(
        pixels.astype(np.float32),
        _asked_for(x).astype(np.float32),
        _asked_for(y).astype(np.float32),
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(found, dtype=np.float64)


def _asked_for(place: FloatArray) -> FloatArray:
    """Return the coordinates for OpenCV's cubic interpolation that sample an image at a place.

    Its kernel is that of Keys ("Cubic convolution interpolation for digital image processing",
    1981) with a = -0.75, which shows a straight slope at f^3 - 1.5 f^2 + 1.5 f of a pixel where it
    is asked for f: up to 0.047 px next to it, so that 0.10 px become 0.14.
    With f = 1/2 + sinh(u) that is 1/2 + sinh(3 u) / 4.
    """
    whole = np.floor(place)
    return np.asarray(whole + 0.5 + np.sinh(np.arcsinh(4.0 * (place - whole) - 2.0) / 3.0))


def undistorted_camera(image: SeenImage) -> Camera:
    """Return the camera of an image, in its own frame, without its distortion, which is not known
    to an effect."""
    height, width = image.pixels.shape[:2]
    return CAMERAS[image.projection](
        width, height, image.focal_px, image.centre_px, pixel_aspect=image.pixel_aspect
    )


def pixel_places(image: SeenImage) -> tuple[FloatArray, FloatArray]:
    """Return x and y (H, W each) of all pixels."""
    height, width = image.pixels.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    return x, y


class FixedResampling:
    """Resamples every image alike; the map is made for the first image of each geometry.

    Args:
        source: makes the map; it may read the image's size, centre, focal length and projection
            alone.
    """

    def __init__(self, source: SourceMap) -> None:
        self._source = source
        self._geometry: tuple[float | str, ...] = ()
        self._x: NDArray[np.float64] = np.empty((0, 0))
        self._y: NDArray[np.float64] = np.empty((0, 0))

    def __call__(self, image: SeenImage) -> FloatArray:
        """Return the resampled pixels (H, W, 3)."""
        geometry = (
            *image.pixels.shape,
            *map(float, image.centre_px),
            float(image.focal_px),
            image.projection,
            image.pixel_aspect,
        )
        if geometry != self._geometry:
            self._x, self._y = self._source(image)
            self._geometry = geometry
        return within_scale(sampled(image.pixels, self._x, self._y))
