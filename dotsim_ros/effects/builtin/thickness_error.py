# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Thickness error: the gel is thicker, or thinner, than the sensor's file says."""

from __future__ import annotations

from dataclasses import replace

from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, GelTerm, Values
from dotsim_ros.effects.excitation import strains
from dotsim_ros.measured.recording import Recording


def _gel(term: GelTerm, values: Values, recording: Recording | None) -> GelTerm:
    thickness_m = term.values.thickness_m * (1.0 + values["thickness_share"])
    return replace(term, values=replace(term.values, thickness_m=thickness_m))


EFFECT = Effect(
    name="thickness_error",
    title="Another thickness of the gel",
    parameters=(EffectParameter("thickness_share", "", 0.0, -0.15, 0.15, (0.1, -0.1)),),
    channels=(SKIN, FORCE),
    protocol="oblique presses all over the skin, to depths of a fifth of the thickness",
    excited_by=strains,
    taken_for=("youngs_modulus", "compressibility", "hyperelastic_stiffening"),
    gel=_gel,
)
