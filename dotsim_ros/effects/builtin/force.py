# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of the force gauge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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
    taken_for=("youngs_modulus", "thermal_drift", "force_drift", "force_bias_z"),
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


def crosstalk_effect(axis: str) -> Effect:
    """Return the effect that mixes the force along z into what the gauge reads along x or y."""
    mixing = np.outer(np.eye(3)["xyz".index(axis)], [0.0, 0.0, 1.0])

    def mixed(values: Values, response: Response) -> Response:
        force_n = response.force_n
        return replace(response, force_n=force_n + values["share"] * (mixing @ force_n))

    return Effect(
        name=f"force_crosstalk_{axis}",
        title=f"Crosstalk of the force along z into {axis}",
        summary=f"the force gauge's {axis} axis reads a share of the force along z, base frame.",
        parameters=(EffectParameter("share", "", 0.0, -0.3, 0.3, (0.1, -0.1)),),
        channels=(FORCE,),
        protocol="presses straight down, on both sides of the apex and with two radii",
        excited_by=touches,
        taken_for=(f"pose_offset_{axis}", f"force_bias_{axis}", "coulomb_slip"),
        response=by_frame(mixed),
    )


FORCE_CROSSTALK_X, FORCE_CROSSTALK_Y = crosstalk_effect("x"), crosstalk_effect("y")
"""A gauge that is tilted reads like this, too: what it mixes back into z is of second order in a
press. That of x into y, a gauge turned about z, is left out.
"""


def bias_effect(axis: str) -> Effect:
    """Return the effect that adds a constant to what the gauge reads along an axis."""
    along = np.eye(3)["xyz".index(axis)]

    def biased(values: Values, response: Response) -> Response:
        return replace(response, force_n=response.force_n + values["bias_n"] * along)

    return Effect(
        name=f"force_bias_{axis}",
        title=f"A bias of the force along {axis}",
        summary=f"the force gauge reads a constant along {axis}, base frame, under no load, too.",
        parameters=(EffectParameter("bias_n", "N", 0.0, -1.0, 1.0, (0.1, -0.1)),),
        channels=(FORCE,),
        protocol="frames without contact, before and after presses",
        # A gauge shows it whatever the indenter does.
        excited_by=lambda recording: True,
        taken_for=("force_scale", "pose_offset")
        if axis == "z"
        else (f"force_crosstalk_{axis}", f"pose_offset_{axis}"),
        response=by_frame(biased),
    )


FORCE_BIAS_X, FORCE_BIAS_Y, FORCE_BIAS_Z = map(bias_effect, "xyz")
