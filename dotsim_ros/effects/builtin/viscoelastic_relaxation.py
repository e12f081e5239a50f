# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Viscoelastic relaxation: a share of the shape-changing stress fades under a held indenter.

One term of a Prony series, as `dotsim_ros.gel.implicit.relaxation` solves it; the elastic
constants stay those of the fast response.
"""

from __future__ import annotations

from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, GelTerm, Values
from dotsim_ros.effects.excitation import unloads
from dotsim_ros.effects.gel_terms import with_relaxation
from dotsim_ros.measured.recording import Phase, Recording


def _gel(term: GelTerm, values: Values, recording: Recording | None) -> GelTerm:
    return with_relaxation(term, values["share"], values["time_s"])


EFFECT = Effect(
    name="viscoelastic_relaxation",
    title="Viscoelastic relaxation",
    parameters=(
        EffectParameter("share", "", 0.0, 0.0, 0.5, (0.2,)),
        EffectParameter("time_s", "s", None, 0.1, 100.0, (0.3, 1.0, 3.0, 10.0)),
    ),
    channels=(SKIN, FORCE),
    protocol="a press that is held for three times the relaxation, reached fast and slowly",
    excited_by=lambda recording: recording.has(Phase.HOLD) or unloads(recording),
    taken_for=("poroelastic_relaxation", "latency", "permanent_set", "thermal_drift"),
    gel=_gel,
)
