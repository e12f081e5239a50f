# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Crosstalk: the gauge's x axis reads a share of the force along z.

An effect is a file that holds an EFFECT of its own name; docs/extend.md explains each field.
"""

from dataclasses import replace

from dotsim_ros import Effect
from dotsim_ros.effects.effect import FORCE, EffectParameter, Response, ResponseFilter, Values
from dotsim_ros.effects.excitation import touches


def _response(values: Values) -> ResponseFilter:
    share = values["share"]

    def mixed(response: Response) -> Response:
        force_n = response.force_n.copy()
        force_n[0] += share * force_n[2]
        return replace(response, force_n=force_n)

    return mixed


EFFECT = Effect(
    name="crosstalk",
    title="Crosstalk of the force gauge",
    parameters=(EffectParameter("share", "", none=0.0, low=-0.5, high=0.5, probes=(0.1, -0.1)),),
    channels=(FORCE,),
    protocol="presses straight down, on both sides of the apex",
    excited_by=touches,
    taken_for=("pose_offset_x", "coulomb_slip"),
    response=_response,
)
