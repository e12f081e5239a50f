# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Poroelastic relaxation: fluid leaves the pressed gel, in a time that grows with the contact.

The time is the contact's radius squared over the diffusivity (Hu, Zhao, Vlassak, Suo, "Using
indentation to characterize the poroelasticity of gels", 2010). One exponential stands for their
master curve, so that the solver's own relaxation does it. The radius is that of the recording's
deepest frame, by Hertz: the contact's edge lies half the depth above the tip, and the radius is
that of the circle of the indenter's cross-section there. Where there is no recording, in the live
sensor, the radius is 2 mm whatever presses: exact for contacts of this size alone.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.effects.effect import FORCE, SKIN, Effect, EffectParameter, GelTerm, Values
from dotsim_ros.effects.gel_terms import with_relaxation
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.measured.recording import TOUCH_M, Phase, Recording

UNKNOWN_RADIUS_M = 2.0e-3
SAMPLES = 96
"""Samples of a cross-section along each side of the box around the indenter."""


def contact_radius_m(indenter: Indenter, depth_m: float) -> float:
    """Return the radius of the circle that is as large as the contact at a depth of the tip.

    Args:
        indenter: what presses.
        depth_m: of its tip below the skin at rest.
    """
    lower, upper = indenter.bounds_m()
    x, y = (
        np.linspace(lower[axis], upper[axis], SAMPLES + 1)[:-1]
        + 0.5 * (upper[axis] - lower[axis]) / SAMPLES
        for axis in (0, 1)
    )
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = np.column_stack([grid, np.full(len(grid), 0.5 * depth_m)])
    inside = float(np.mean(indenter.signed_distance(points) < 0.0))
    area = inside * float(np.prod(upper[:2] - lower[:2]))
    return float(np.sqrt(area / np.pi))


def _gel(term: GelTerm, values: Values, recording: Recording | None) -> GelTerm:
    if values["share"] == 0.0:
        return term
    radius_m = UNKNOWN_RADIUS_M
    if recording is not None:
        deepest_m = max(TOUCH_M, float(np.max(recording.depth_m)))
        # A point thinner than the samples still touches with something.
        radius_m = max(TOUCH_M, contact_radius_m(recording.indenter, deepest_m))
    return with_relaxation(term, values["share"], radius_m**2 / values["diffusivity_m2_s"])


EFFECT = Effect(
    name="poroelastic_relaxation",
    title="Poroelastic relaxation",
    parameters=(
        EffectParameter("share", "", 0.0, 0.0, 0.5, (0.2,)),
        # 0.1 to 400 s for a contact of 2 mm: a silicone that holds still for longer shows none.
        EffectParameter("diffusivity_m2_s", "m2/s", None, 1e-8, 4e-5, (4e-7, 1.2e-6, 4e-6, 1.2e-5)),
    ),
    channels=(SKIN, FORCE),
    protocol="held presses with two radii: the wider contact relaxes later",
    excited_by=lambda recording: recording.has(Phase.HOLD),
    taken_for=("viscoelastic_relaxation",),
    gel=_gel,
)
