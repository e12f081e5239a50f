# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Vignetting: brightness falls with the square of the distance from the optical axis."""

from __future__ import annotations

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import any_frame, radius_square, within_scale


def _image(values: Values) -> ImageFilter:
    loss = values["edge_loss"]

    def vignetted(image: SeenImage) -> FloatArray:
        return within_scale(image.pixels * (1.0 - loss * radius_square(image))[..., None])

    return vignetted


EFFECT = Effect(
    name="vignetting",
    title="Vignetting",
    # The loss at half the image's height from the axis, over that at the axis.
    parameters=(EffectParameter("edge_loss", "", 0.0, 0.0, 0.3, (0.05, 0.2)),),
    channels=(IMAGE,),
    protocol="any images, also without contact",
    excited_by=any_frame,
    taken_for=("gamma", "daylight"),
    image=_image,
)
