# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Thermal drift: the gel grows stiffer or softer while its light warms it.

The stiffness approaches a new value exponentially, like the temperature of a body that is heated
evenly and cooled at its surface. Only the force shows it: in a quasi-static press by a rigid
indenter the skin does not depend on Young's modulus. Rubber's modulus is proportional to the
absolute temperature, 0.3 % a kelvin (Treloar, "The physics of rubber elasticity", 1975); the range
is that of some thirty kelvins.
"""

from __future__ import annotations

import math
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
    change, time_s = values["stiffness_change"], values["time_s"]

    def warmed(response: Response) -> Response:
        gain = 1.0 - change * math.expm1(-response.session_s / time_s)
        return replace(response, force_n=gain * response.force_n)

    return warmed


EFFECT = Effect(
    name="thermal_drift",
    title="Thermal drift of the stiffness",
    parameters=(
        EffectParameter("stiffness_change", "", 0.0, -0.1, 0.1, (0.05, -0.05)),
        EffectParameter("time_s", "s", None, 5.0, 3600.0, (20.0, 300.0)),
    ),
    channels=(FORCE,),
    protocol="the same press first and last, the light being on for half an hour between them",
    excited_by=presses_late,
    taken_for=("force_drift", "force_scale", "mullins_softening"),
    response=_response,
)
