# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Saturation: the camera clips what is brighter than a level below its full scale."""

from __future__ import annotations

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import FULL_SCALE, any_frame


def _image(values: Values) -> ImageFilter:
    level = FULL_SCALE * values["clip_share"]

    def clipped(image: SeenImage) -> FloatArray:
        return np.minimum(image.pixels, level)

    return clipped


EFFECT = Effect(
    name="saturation",
    title="Saturation of the camera",
    # Lower than the table's 0.85, so that a sensor that is not lit to the full has it in range.
    parameters=(EffectParameter("clip_share", "", 1.0, 0.5, 1.0, (0.85, 0.65)),),
    channels=(IMAGE,),
    protocol="images that come near to white: bright LEDs, a glossy contact",
    excited_by=any_frame,
    taken_for=("gamma", "auto_exposure"),
    image=_image,
)
