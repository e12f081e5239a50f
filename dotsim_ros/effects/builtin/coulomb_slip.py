# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Coulomb slip: the skin slides on the indenter at another coefficient than the twin's."""

from __future__ import annotations

from dataclasses import replace

from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, GelTerm, Values
from dotsim_ros.measured.recording import Phase, Recording


def _gel(term: GelTerm, values: Values, recording: Recording | None) -> GelTerm:
    friction = term.values.friction * values["friction_ratio"]
    return replace(term, values=replace(term.values, friction=friction))


EFFECT = Effect(
    name="coulomb_slip",
    title="Coulomb slip at another friction",
    parameters=(EffectParameter("friction_ratio", "", 1.0, 0.1, 5.0, (0.6, 1.6)),),
    channels=(SKIN, FORCE),
    protocol="a slide of two contact radii, or an oblique press",
    excited_by=lambda recording: recording.has(Phase.SLIDE),
    taken_for=("numerical shear stiffness",),
    gel=_gel,
)
