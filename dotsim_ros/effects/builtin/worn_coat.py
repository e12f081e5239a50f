# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Worn coat: a smooth spot of the image that scatters less light than it did.

The spot is a Gaussian at a fixed place of the image. A spot of the coat moves with the skin under
contact; as long as that is less than its radius this makes little difference.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import any_frame, pixel_places, within_scale

PLACES_RAD = (0.0, -1.0, -0.5, 0.5, 1.0)


def _image(values: Values) -> ImageFilter:
    def worn(image: SeenImage) -> FloatArray:
        x, y = pixel_places(image)
        across_x = (x - image.centre_px[0]) / image.focal_x_px - values["x_rad"]
        across_y = (y - image.centre_px[1]) / image.focal_px - values["y_rad"]
        spot = np.exp(-0.5 * (across_x**2 + across_y**2) / values["radius_rad"] ** 2)
        return within_scale(image.pixels * (1.0 - values["loss_share"] * spot)[..., None])

    return worn


EFFECT = Effect(
    name="worn_coat",
    title="Worn spot of the coat",
    # Places and radius are angles from the optical axis: pixels over the focal length.
    parameters=(
        EffectParameter("loss_share", "", 0.0, -0.5, 0.8, (0.2,)),
        EffectParameter("x_rad", "rad", None, -1.4, 1.4, PLACES_RAD),
        EffectParameter("y_rad", "rad", None, -1.4, 1.4, PLACES_RAD),
        EffectParameter("radius_rad", "rad", None, 0.1, 0.6, (0.3,)),
    ),
    channels=(IMAGE,),
    protocol="images without contact, at commissioning and after wear",
    excited_by=any_frame,
    taken_for=("dust", "vignetting"),
    image=_image,
)
