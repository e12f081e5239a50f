# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Daylight: light from one side falls through the coat, most on the skin that faces it.

A share of the light is that of a uniform half of the sky about a direction: skin whose outward
normal leans from it by the angle b has (1 + cos b) / 2 of it (Liu and Jordan, "The long-term
average performance of flat-plate solar-energy collectors", Solar Energy 7(2), 1963). The rest comes
straight from there, and skin has max(cos b, 0) of it by Lambert's law. Skin that faces the light
has all of either, skin that faces away none, so a dent shows in it. Shadows of the indenter are
left out.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import FULL_SCALE, any_frame, within_scale


def _image(values: Values) -> ImageFilter:
    azimuth, elevation = values["azimuth_rad"], values["elevation_rad"]
    towards = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    most, diffuse = FULL_SCALE * values["added_share"], values["diffuse_share"]

    def lit(image: SeenImage) -> FloatArray:
        # The normal of a view is the one on the camera's side.
        cosine = -image.normal @ towards
        share = diffuse * 0.5 * (1.0 + cosine) + (1.0 - diffuse) * np.maximum(cosine, 0.0)
        return within_scale(image.pixels + most * np.nan_to_num(share)[..., None])

    return lit


EFFECT = Effect(
    name="daylight",
    title="Daylight from one side",
    # Of the full scale, on skin that faces it. The direction is that of the optical frame: from
    # right towards down in the image, and from its plane towards where the camera looks. Less
    # light than when the twin was made is as likely as more.
    parameters=(
        EffectParameter("added_share", "", 0.0, -0.1, 0.1, (0.03,)),
        EffectParameter(
            "azimuth_rad",
            "rad",
            None,
            -np.pi,
            np.pi,
            tuple(np.radians([-150.0, -90.0, -30.0, 30.0, 90.0, 150.0]).tolist()),
        ),
        EffectParameter("elevation_rad", "rad", None, 0.0, 1.2, (0.0, 0.7)),
        EffectParameter("diffuse_share", "", None, 0.0, 1.0, (0.5,)),
    ),
    channels=(IMAGE,),
    protocol="images with the LEDs off, the sensor turned about its axis between them",
    excited_by=any_frame,
    taken_for=("ambient_light", "vignetting", "led_imbalance"),
    image=_image,
)
