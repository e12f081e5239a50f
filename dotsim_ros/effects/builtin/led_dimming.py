# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""LED dimming: all LEDs lose brightness as they warm up over a session.

The loss approaches its final share exponentially, as that of a junction that warms up under a
constant current does. Dimming that came before the session is a gain of all images alike, which
the camera's gain takes.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter, ImageFilter, SeenImage, Values
from dotsim_ros.effects.optical_terms import within_scale


def _image(values: Values) -> ImageFilter:
    final, time_s = values["final_loss_share"], values["time_s"]

    def dimmed(image: SeenImage) -> FloatArray:
        warm = -np.expm1(-max(image.session_s, 0.0) / time_s)
        return within_scale(image.pixels * (1.0 - final * warm))

    return dimmed


EFFECT = Effect(
    name="led_dimming",
    title="LEDs that dim over the session",
    parameters=(
        EffectParameter("final_loss_share", "", 0.0, 0.0, 0.3, (0.05,)),
        EffectParameter("time_s", "s", None, 1.0, 3600.0, (20.0, 300.0)),
    ),
    channels=(IMAGE,),
    protocol="images without contact, at the start and at the end of a session of minutes",
    excited_by=lambda recording: recording.session_s > 0.0,
    taken_for=("auto_exposure", "ambient_light"),
    image=_image,
)
