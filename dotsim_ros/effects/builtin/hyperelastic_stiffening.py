# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hyperelastic stiffening: the gel stiffens more, or less, at large strain than the twin's.

Yeoh, "Some forms of the strain energy function for rubber", 1993: the energy's second coefficient.
The third one shows the same at larger strain; presses of a fingertip cannot distinguish the two.
"""

from __future__ import annotations

from dataclasses import replace

from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, GelTerm, Values
from dotsim_ros.effects.excitation import strains
from dotsim_ros.measured.recording import Recording


def _gel(term: GelTerm, values: Values, recording: Recording | None) -> GelTerm:
    c20_ratio = term.values.c20_ratio + values["c20_ratio"]
    return replace(term, values=replace(term.values, c20_ratio=c20_ratio))


EFFECT = Effect(
    name="hyperelastic_stiffening",
    title="Stiffening at large strain (Yeoh's C20)",
    parameters=(EffectParameter("c20_ratio", "of C10", 0.0, -0.1, 0.5, (0.3, -0.08)),),
    channels=(SKIN, FORCE),
    protocol="slow presses to three depths, the deepest beyond 2 mm, with a narrow indenter",
    excited_by=strains,
    taken_for=("compressibility", "thickness_error", "mullins_softening"),
    gel=_gel,
)
