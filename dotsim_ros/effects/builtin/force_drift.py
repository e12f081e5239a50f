# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Force drift: the force gauge's gain changes at a constant rate over the session."""

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
from dotsim_ros.effects.excitation import presses_late


def _response(values: Values) -> ResponseFilter:
    share_per_s = values["share_per_s"]

    def drifted(response: Response) -> Response:
        gain = 1.0 + share_per_s * response.session_s
        return replace(response, force_n=gain * response.force_n)

    return drifted


EFFECT = Effect(
    name="force_drift",
    title="Drift of the force",
    # A fifth in 10 s, which is a session of eight short presses.
    parameters=(EffectParameter("share_per_s", "1/s", 0.0, -2e-2, 2e-2, (5e-3, -5e-3)),),
    channels=(FORCE,),
    protocol="the same press at the start, in the middle and at the end of the session",
    excited_by=presses_late,
    taken_for=("thermal_drift", "force_scale", "mullins_softening"),
    response=_response,
)
