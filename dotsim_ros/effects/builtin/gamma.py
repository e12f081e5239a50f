# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gamma: the camera responds to light by another power than when the twin was made."""

from __future__ import annotations

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import FULL_SCALE, any_frame, within_scale


def _image(values: Values) -> ImageFilter:
    exponent = values["exponent"]

    def bent(image: SeenImage) -> FloatArray:
        # Identical, not only nearly, where nothing is bent.
        if exponent == 1.0:
            return image.pixels
        return FULL_SCALE * (within_scale(image.pixels) / FULL_SCALE) ** exponent

    return bent


EFFECT = Effect(
    name="gamma",
    title="Another gamma of the camera",
    parameters=(EffectParameter("exponent", "", 1.0, 0.85, 1.15, (0.95, 1.05)),),
    channels=(IMAGE,),
    protocol="idle images at two exposures",
    excited_by=any_frame,
    taken_for=("ambient_light", "vignetting"),
    image=_image,
)
