# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Auto-exposure: the camera's gain follows the mean of what it sees, relative to the idle frame."""

from __future__ import annotations

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import within_scale
from dotsim_ros.measured.recording import Phase

DARK_LEVEL = 1.0
"""Mean grey level below which a camera's gain does not follow any further."""


def _image(values: Values) -> ImageFilter:
    strength = values["strength"]

    def exposed(image: SeenImage) -> FloatArray:
        wanted = max(float(np.mean(image.idle)), DARK_LEVEL)
        seen = max(float(np.mean(image.pixels)), DARK_LEVEL)
        return within_scale(image.pixels * (wanted / seen) ** strength)

    return exposed


EFFECT = Effect(
    name="auto_exposure",
    title="Auto-exposure",
    # At 1 the mean of every image is that of the idle frame.
    parameters=(EffectParameter("strength", "", 0.0, 0.0, 1.0, (0.5, 1.0)),),
    channels=(IMAGE,),
    protocol="a deep press, which changes the image's mean",
    excited_by=lambda recording: recording.has(Phase.LOAD),
    taken_for=("led_dimming",),
    image=_image,
)
