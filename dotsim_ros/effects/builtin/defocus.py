# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defocus: the lens is focused at one distance, and skin that is nearer or farther is blurred.

A thin lens spreads a point at the distance s over a disc, the circle of confusion (Potmesil and
Chakravarty, "A lens and aperture camera model for synthetic image generation", Computer Graphics
15(3), 1981). Seen from the lens, its diameter is D |1/s - 1/f|, with D the diameter of the entrance
pupil and f the distance in focus: as many pixels as the focal length has a radian.

Each pixel is the mean over the disc of its own depth. Discs of some diameters are worked out, and
a pixel mixes the two next to its own so that the variance of the blur, d^2 / 16 an axis for a
diameter d, is exactly its own. What blurs the frame already, such as the lens that took the idle
image, is beneath.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import any_frame, within_scale

SMALLEST_PX = 2.0
"""Diameter of the smallest disc that is worked out; smaller ones are mixed of it and no blur."""
GROWTH = 1.4
"""From one disc to the next."""
SUBSAMPLES = 16
"""Points along each side of a pixel at which a disc is asked whether it covers it."""


def disc_px(image: SeenImage, *, pupil_area_m2: float, focus_m: float) -> FloatArray:
    """Return (H, W) the diameter of each pixel's circle of confusion, px; 0 where no skin is seen.

    Args:
        image: with the skin's depth.
        pupil_area_m2: area of the entrance pupil.
        focus_m: distance that is in focus.
    """
    pupil_m = np.sqrt(4.0 * pupil_area_m2 / np.pi)
    diameter = image.focal_px * pupil_m * np.abs(1.0 / image.depth_m - 1.0 / focus_m)
    return np.nan_to_num(diameter)


@cache
def _disc(number: int) -> tuple[FloatArray, float]:
    """Return the weights (2 n + 1, 2 n + 1) of a disc, and their variance along an axis, px^2."""
    radius = 0.5 * SMALLEST_PX * GROWTH**number
    reach = int(np.ceil(radius - 0.5))
    side = 2 * reach + 1
    place = (np.arange(side * SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5 * side
    covered = np.hypot(place[:, None], place[None, :]) <= radius
    weight = covered.reshape(side, SUBSAMPLES, side, SUBSAMPLES).mean(axis=(1, 3))
    weight /= weight.sum()
    offset = np.arange(side) - reach
    return weight, float(np.sum(weight * offset**2))


def _image(values: Values) -> ImageFilter:
    area_m2, focus_m = values["pupil_area_m2"], values["focus_m"]

    def blurred(image: SeenImage) -> FloatArray:
        wanted = disc_px(image, pupil_area_m2=area_m2, focus_m=focus_m) ** 2 / 16.0
        result = image.pixels.copy()
        finer, least = image.pixels, 0.0
        number, most = 0, float(wanted.max())
        while least < most:
            weight, variance = _disc(number)
            coarser = np.asarray(
                cv2.filter2D(image.pixels, -1, weight, borderType=cv2.BORDER_REPLICATE),
                dtype=np.float64,
            )
            between = (wanted > least) & (wanted <= variance)
            share = ((wanted[between] - least) / (variance - least))[:, None]
            result[between] = (1.0 - share) * finer[between] + share * coarser[between]
            finer, least, number = coarser, variance, number + 1
        return within_scale(result)

    return blurred


EFFECT = Effect(
    name="defocus",
    title="A lens out of focus",
    # The area, since blur grows in proportion to it: 1e-6 m2 are a pupil of 1.13 mm.
    parameters=(
        EffectParameter("pupil_area_m2", "m2", 0.0, 0.0, 1.0e-6, (5.0e-8, 4.0e-7)),
        EffectParameter("focus_m", "m", None, 0.004, 0.2, (0.009, 0.015, 0.04)),
    ),
    channels=(IMAGE,),
    protocol="images of the idle pattern, and of presses of several depths",
    excited_by=any_frame,
    taken_for=("motion_blur",),
    image=_image,
)
