# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Motion blur: the image moves while the camera exposes.

The image is the mean of what was seen at even times over the exposure, which is centred on the
frame's stamp, so that the blur is not a latency too. Each instant is the frame's image, moved by
its flow.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import moves_fast, pixel_places, sampled, within_scale

SAMPLES_PER_PX = 2.0
MOST_SAMPLES = 33


def _image(values: Values) -> ImageFilter:
    exposure_s = values["exposure_s"]

    def blurred(image: SeenImage) -> FloatArray:
        path_px = exposure_s * image.flow_px_s
        longest_px = float(np.linalg.norm(path_px, axis=2).max(initial=0.0))
        if longest_px == 0.0:
            return image.pixels
        count = int(np.clip(np.ceil(SAMPLES_PER_PX * longest_px) + 2, 3, MOST_SAMPLES))
        x, y = pixel_places(image)
        total = np.zeros_like(image.pixels)
        # The middles of equal shares of the exposure.
        for share in (np.arange(count) + 0.5) / count - 0.5:
            total += sampled(image.pixels, x - share * path_px[..., 0], y - share * path_px[..., 1])
        return within_scale(total / count)

    return blurred


EFFECT = Effect(
    name="motion_blur",
    title="Motion blur",
    parameters=(EffectParameter("exposure_s", "s", 0.0, 0.0, 0.03, (0.01, 0.03)),),
    channels=(IMAGE,),
    protocol="a slide or a press of 2 mm/s or faster, filmed as it moves",
    excited_by=moves_fast,
    taken_for=("defocus", "latency"),
    image=_image,
)
