# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Force scale: the force gauge's gain is another than its calibration says."""

from __future__ import annotations

from dataclasses import replace

from dotsim_ros.effects.effect import (
    FORCE,
    Effect,
    EffectParameter,
    Response,
    ResponseFilter,
    Values,
)
from dotsim_ros.effects.excitation import touches


def _response(values: Values) -> ResponseFilter:
    scale = values["scale"]

    def scaled(response: Response) -> Response:
        return replace(response, force_n=scale * response.force_n)

    return scaled


EFFECT = Effect(
    name="force_scale",
    title="Another scale of the force",
    parameters=(EffectParameter("scale", "", 1.0, 0.8, 1.2, (1.1, 0.9)),),
    channels=(FORCE,),
    protocol="any press, and a weight on the gauge: without the weight it is Young's modulus that "
    "may be wrong",
    excited_by=touches,
    taken_for=("youngs_modulus", "thermal_drift", "force_drift"),
    response=_response,
)
