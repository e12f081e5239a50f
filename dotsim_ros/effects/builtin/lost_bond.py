# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lost bond: the gel has come off its core, and slides on it.

The size is the share of a shear's sliding that the bond lets through (`dotsim_ros.gel.bond`); at 1,
where it slides freely, the range ends by nature. The air's pressure keeps the gel on the core, so
that it does not open. A search looks for a bond that is lost all over the core; a smaller patch is
for simulation, or for a file of your own with its place as probes.
"""

from __future__ import annotations

import math
from dataclasses import replace

from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, GelTerm, Values
from dotsim_ros.effects.excitation import touches
from dotsim_ros.measured.recording import Recording


def _gel(term: GelTerm, values: Values, recording: Recording | None) -> GelTerm:
    own = term.values
    if values["slip_share"] == 0.0:
        return term
    patch = (values["x_rad"], values["y_rad"], values["radius_rad"])
    if own.bond_slip_share > 0.0:
        # A gel has one patch: that which has come off already gets looser.
        patch = own.loose_patch_rad
    slip = 1.0 - (1.0 - own.bond_slip_share) * (1.0 - values["slip_share"])
    return replace(term, values=replace(own, bond_slip_share=slip, loose_patch_rad=patch))


EFFECT = Effect(
    name="lost_bond",
    title="A gel that has come off its core",
    parameters=(
        EffectParameter("slip_share", "", 0.0, 0.0, 1.0, (0.5, 1.0), natural_ends=(1.0,)),
        EffectParameter("x_rad", "rad", None, -1.5, 1.5, (0.0,)),
        EffectParameter("y_rad", "rad", None, -1.5, 1.5, (0.0,)),
        EffectParameter("radius_rad", "rad", None, 0.1, math.pi, (math.pi,)),
    ),
    channels=(SKIN, FORCE),
    protocol="presses and slides all over the skin, to depths of a fifth of the thickness",
    excited_by=touches,
    taken_for=("thickness_error", "youngs_modulus", "compressibility"),
    gel=_gel,
)
