# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Ambient light: a veil over the whole image that no contact changes."""

from __future__ import annotations

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import FULL_SCALE, any_frame, within_scale


def _image(values: Values) -> ImageFilter:
    veil = FULL_SCALE * values["added_share"]

    def veiled(image: SeenImage) -> FloatArray:
        return within_scale(image.pixels + veil)

    return veiled


EFFECT = Effect(
    name="ambient_light",
    title="Ambient light",
    # Of the full scale. Less light than when the twin was made is as likely as more.
    parameters=(EffectParameter("added_share", "", 0.0, -0.05, 0.05, (0.02, -0.02)),),
    channels=(IMAGE,),
    protocol="images with the LEDs off",
    excited_by=any_frame,
    taken_for=("gamma", "daylight"),
    image=_image,
)
