# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hidden effects of the camera and its lights, with other laws than those that are looked for.

They act on measured images: vignetting falls with the fourth power of a cosine (a thin lens), the
camera answers by a logarithm instead of a power, LEDs dim with two time constants, a colour's LEDs
leak into the other channels, the exposure lags behind what it follows, a turned camera is resampled
by splines, a worn spot has a ragged edge, a lens out of focus blurs as a bell whatever the depth, a
lamp shines on a sphere about the lens. One is of no library: bands of a flickering lamp.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dotsim_ros.io.arrays import FloatArray

FULL_SCALE = 255.0
LEAK = 0.06
"""Share of a colour's light that the other channels see."""
HALF_HEIGHT_DEG = 86.0
"""What half the image's height shows, as the maker of `sensor_a` states it."""
DARK_LEVELS = 8.0
"""What is darker in the idle image is next to the skin."""


@dataclass(frozen=True)
class Takes:
    """Images of one trajectory.

    Attributes:
        pixels: (F, H, W, 3), 0 to 255.
        session_s: (F,) since the session's start.
        idle: (H, W, 3) without contact.
    """

    pixels: FloatArray
    session_s: FloatArray
    idle: FloatArray


@dataclass(frozen=True)
class ImageLaw:
    """A hidden effect.

    Attributes:
        name: in the truth.
        library: name of the effect that the library knows it by; empty for one of no library.
        sizes: from hardly to be seen to obvious.
        unit: of the size.
        change: from images and the size to the images (F, H, W, 3) as they are taken.
    """

    name: str
    library: str
    sizes: tuple[float, ...]
    unit: str
    change: Callable[[Takes, float], FloatArray]


def taken(takes: Takes, law: ImageLaw, size: float) -> NDArray[np.uint8]:
    """Return the images (F, H, W, 3) as a camera gives them."""
    return np.clip(np.rint(law.change(takes, size)), 0.0, FULL_SCALE).astype(np.uint8)


def _radius(pixels: FloatArray) -> FloatArray:
    """Return (H, W) the distance from the image's centre over half its height."""
    height, width = pixels.shape[1:3]
    y, x = np.mgrid[0:height, 0:width]
    return np.asarray(np.hypot(x - 0.5 * (width - 1), y - 0.5 * (height - 1)) / (0.5 * height))


def _cosine_fourth(takes: Takes, size: float) -> FloatArray:
    # The size is the loss at half the height.
    angle = np.arctan(_radius(takes.pixels) * np.tan(np.arccos((1.0 - size) ** 0.25)))
    return takes.pixels * (np.cos(angle) ** 4)[..., None]


def _logarithm(takes: Takes, size: float) -> FloatArray:
    return FULL_SCALE * np.log1p(size * takes.pixels / FULL_SCALE) / np.log1p(size)


def _two_times(takes: Takes, size: float) -> FloatArray:
    fast, slow = (-np.expm1(-takes.session_s / time_s) for time_s in (4.0, 30.0))
    return takes.pixels * (1.0 - size * (0.6 * fast + 0.4 * slow))[:, None, None, None]


def _leaking(takes: Takes, size: float) -> FloatArray:
    gain = np.array([1.0 - size, 1.0 - LEAK * size, 1.0 - LEAK * size])
    return takes.pixels * gain


def _lagging(takes: Takes, size: float) -> FloatArray:
    wanted = float(takes.idle.mean())
    followed, result = wanted, []
    for image in takes.pixels:
        followed += 0.7 * (float(image.mean()) - followed)
        result.append(image * (wanted / followed) ** size)
    return np.stack(result)


def _veil(takes: Takes, size: float) -> FloatArray:
    # A window at the right: more on that side.
    width = takes.pixels.shape[2]
    side = 1.0 + 0.3 * (np.arange(width) / width - 0.5)
    return takes.pixels + FULL_SCALE * size * side[None, None, :, None]


def _lamp(takes: Takes, size: float) -> FloatArray:
    # Far to the right, and as far down: what a sphere around the lens has of it.
    height, width = takes.pixels.shape[1:3]
    y, x = np.mgrid[0:height, 0:width]
    angle = _radius(takes.pixels) * np.radians(HALF_HEIGHT_DEG)
    towards = np.arctan2(y - 0.5 * (height - 1), x - 0.5 * (width - 1)) - 0.25 * np.pi
    lit = np.maximum(np.sin(angle) * np.cos(towards), 0.0) * (takes.idle.max(axis=2) > DARK_LEVELS)
    return takes.pixels + FULL_SCALE * size * lit[..., None]


def _shifted(takes: Takes, size: float) -> FloatArray:
    # The size is in pixels of an image 240 px high.
    moved = size * takes.pixels.shape[1] / 240.0
    shift = (0.0, 0.4 * moved, moved, 0.0)
    return np.asarray(ndimage.shift(takes.pixels, shift, order=3, mode="nearest"))


def _ragged_spot(takes: Takes, size: float) -> FloatArray:
    height, width = takes.pixels.shape[1:3]
    random = np.random.default_rng(5)
    rough = cv2.GaussianBlur(random.standard_normal((height, width)), (0, 0), 0.012 * height)
    y, x = np.mgrid[0:height, 0:width]
    distance = np.hypot(x - 0.62 * width, y - 0.4 * height) / (0.15 * height)
    worn = (distance + 0.15 * rough / rough.std() < 1.0).astype(np.float64)
    return takes.pixels * (1.0 - size * worn)[..., None]


def _defocused(takes: Takes, size: float) -> FloatArray:
    blur = size * takes.pixels.shape[1] / 240.0
    return np.stack([cv2.GaussianBlur(image, (0, 0), blur) for image in takes.pixels])


def _banded(takes: Takes, size: float) -> FloatArray:
    rows = np.arange(takes.pixels.shape[1]) / takes.pixels.shape[1]
    phase = 37.0 * takes.session_s
    bands = np.sin(2.0 * np.pi * 3.0 * rows[None, :] + phase[:, None])
    return takes.pixels * (1.0 + size * bands)[:, :, None, None]


LAWS: Mapping[str, ImageLaw] = {
    law.name: law
    for law in (
        ImageLaw("cosine_fourth", "vignetting", (0.02, 0.05, 0.1, 0.2), "edge", _cosine_fourth),
        ImageLaw("logarithm", "gamma", (0.1, 0.2, 0.4, 0.8), "k", _logarithm),
        ImageLaw("two_times", "led_dimming", (0.02, 0.05, 0.1, 0.2), "share", _two_times),
        ImageLaw("leaking_red", "led_imbalance_red", (0.01, 0.03, 0.06, 0.12), "", _leaking),
        ImageLaw("lagging_exposure", "auto_exposure", (0.15, 0.3, 0.6, 0.9), "", _lagging),
        ImageLaw("window", "ambient_light", (0.004, 0.01, 0.02, 0.04), "share", _veil),
        ImageLaw("lamp", "daylight", (0.01, 0.02, 0.04, 0.08), "share", _lamp),
        ImageLaw("knocked", "camera_intrinsics", (0.1, 0.3, 0.6, 1.2), "px", _shifted),
        ImageLaw("ragged_spot", "worn_coat", (0.05, 0.1, 0.2, 0.4), "share", _ragged_spot),
        ImageLaw("defocused", "defocus", (0.4, 0.6, 0.9, 1.4), "px", _defocused),
        ImageLaw("banded", "", (0.01, 0.02, 0.05, 0.1), "share", _banded),
    )
}
