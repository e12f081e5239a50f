# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of the force gauge."""

from __future__ import annotations

from dataclasses import replace

from dotsim_ros.effects.effect import FORCE, Effect, EffectParameter, Response, Values, by_frame
from dotsim_ros.effects.excitation import presses_late, touches


def _scaled(values: Values, response: Response) -> Response:
    return replace(response, force_n=values["scale"] * response.force_n)


FORCE_SCALE = Effect(
    name="force_scale",
    title="Another scale of the force",
    summary="the force gauge's gain is another than its calibration says.",
    parameters=(EffectParameter("scale", "", 1.0, 0.8, 1.2, (1.1, 0.9)),),
    channels=(FORCE,),
    protocol="any press, and a weight on the gauge: without the weight it is Young's modulus that "
    "may be wrong",
    excited_by=touches,
    taken_for=("youngs_modulus", "thermal_drift", "force_drift"),
    response=by_frame(_scaled),
)


def _drifted(values: Values, response: Response) -> Response:
    gain = 1.0 + values["share_per_s"] * response.session_s
    return replace(response, force_n=gain * response.force_n)


FORCE_DRIFT = Effect(
    name="force_drift",
    title="Drift of the force",
    # A fifth in 10 s, which is a session of eight short presses.
    summary="the force gauge's gain changes at a constant rate over the session.",
    parameters=(EffectParameter("share_per_s", "1/s", 0.0, -2e-2, 2e-2, (5e-3, -5e-3)),),
    channels=(FORCE,),
    protocol="the same press at the start, in the middle and at the end of the session",
    excited_by=presses_late,
    taken_for=("thermal_drift", "force_scale", "mullins_softening"),
    response=by_frame(_drifted),
)
