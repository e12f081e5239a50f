# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Rolling shutter: rows are read one after the other, so what moves is skewed.

The frame's stamp is that of the middle row. A row that is read later shows the image moved on
along its flow.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import moves_fast, pixel_places, sampled, within_scale


def _image(values: Values) -> ImageFilter:
    readout_s = values["readout_s"]

    def skewed(image: SeenImage) -> FloatArray:
        if readout_s == 0.0 or not np.any(image.flow_px_s):
            return image.pixels
        x, y = pixel_places(image)
        rows = max(image.pixels.shape[0] - 1, 1)
        later_s = readout_s * (y / rows - 0.5)
        return within_scale(
            sampled(
                image.pixels,
                x - later_s * image.flow_px_s[..., 0],
                y - later_s * image.flow_px_s[..., 1],
            )
        )

    return skewed


EFFECT = Effect(
    name="rolling_shutter",
    title="Rolling shutter",
    # From the first row to the last, whatever their number: 480 rows of 20 to 60 us take 10 to
    # 29 ms.
    parameters=(EffectParameter("readout_s", "s", 0.0, 0.0, 0.03, (0.015, 0.03)),),
    channels=(IMAGE,),
    protocol="a slide of 2 mm/s or faster, filmed as it moves, across and along the rows",
    excited_by=moves_fast,
    taken_for=("latency",),
    image=_image,
)
