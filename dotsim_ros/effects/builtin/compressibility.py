# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Compressibility: Poisson's ratio nu is another than the twin's.

The size is the change of log(1/2 - nu), in which the compliance is straight up to
incompressibility; it is zero at the twin's own ratio.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, GelTerm, Values
from dotsim_ros.effects.excitation import touches
from dotsim_ros.measured.recording import Recording

SMALLEST_RATIO = 0.2
LARGEST_RATIO = 0.4999
"""What the solver takes, as in calibration."""


def _gel(term: GelTerm, values: Values, recording: Recording | None) -> GelTerm:
    shift = values["log_compressibility_shift"]
    if shift == 0.0:
        return term
    ratio = 0.5 - (0.5 - term.values.poisson_ratio) * float(np.exp(shift))
    ratio = float(np.clip(ratio, SMALLEST_RATIO, LARGEST_RATIO))
    return replace(term, values=replace(term.values, poisson_ratio=ratio))


EFFECT = Effect(
    name="compressibility",
    title="Compressibility (another Poisson's ratio)",
    # From the twin's 0.48, these are ratios of 0.45 and 0.4995.
    parameters=(EffectParameter("log_compressibility_shift", "", 0.0, -3.7, 0.92, (-1.0, 0.7)),),
    channels=(SKIN, FORCE),
    protocol="slow presses with two radii: the skin bulges beside the contact",
    excited_by=touches,
    taken_for=("youngs_modulus", "coulomb_slip", "thickness_error"),
    gel=_gel,
)
