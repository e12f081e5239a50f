# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of time in the gel: relaxation, flow and warmth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dotsim_ros.data.recording import TOUCH_M, Phase, Recording
from dotsim_ros.effects.effect import (
    FORCE,
    SKIN,
    Effect,
    EffectParameter,
    GelTerm,
    Response,
    Values,
    by_frame,
)
from dotsim_ros.effects.excitation import presses_late, unloads
from dotsim_ros.geometry.indenter import Indenter


def with_relaxation(term: GelTerm, share: float, time_s: float) -> GelTerm:
    """Return a gel that relaxes in one way more: `share` of the stress that nothing else relaxes,
    so that the whole stays below 1, in a time."""
    if share == 0.0:
        return term
    left = 1.0 - sum(term.prony_shares)
    return replace(
        term,
        prony_shares=(*term.prony_shares, share * left),
        prony_times_s=(*term.prony_times_s, time_s),
    )


VISCOELASTIC_RELAXATION = Effect(
    name="viscoelastic_relaxation",
    title="Viscoelastic relaxation",
    summary="a share of the shape-changing stress fades under a held indenter.",
    parameters=(
        EffectParameter("share", "", 0.0, 0.0, 0.5, (0.2,)),
        EffectParameter("time_s", "s", None, 0.1, 100.0, (0.3, 1.0, 3.0, 10.0)),
    ),
    channels=(SKIN, FORCE),
    protocol="a press that is held for three times the relaxation, reached fast and slowly",
    excited_by=lambda recording: recording.has(Phase.HOLD) or unloads(recording),
    taken_for=("poroelastic_relaxation", "latency", "permanent_set", "thermal_drift"),
    gel=lambda term, values, _: with_relaxation(term, values["share"], values["time_s"]),
)
"""One term of a Prony series, as `dotsim_ros.gel.implicit.relaxation` solves it; the elastic
constants stay those of the fast response.
"""

UNKNOWN_RADIUS_M = 2.0e-3
SAMPLES = 96
"""Samples of a cross-section along each side of the box around the indenter."""


def contact_radius_m(indenter: Indenter, depth_m: float) -> float:
    """Return the radius of the circle that is as large as the contact at a depth of the tip below
    the skin at rest."""
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


def _poroelastic_relaxation_gel(
    term: GelTerm, values: Values, recording: Recording | None
) -> GelTerm:
    if values["share"] == 0.0:
        return term
    radius_m = UNKNOWN_RADIUS_M
    if recording is not None:
        deepest_m = max(TOUCH_M, float(np.max(recording.depth_m)))
        # A point thinner than the samples still touches with something.
        radius_m = max(TOUCH_M, contact_radius_m(recording.indenter, deepest_m))
    return with_relaxation(term, values["share"], radius_m**2 / values["diffusivity_m2_s"])


POROELASTIC_RELAXATION = Effect(
    name="poroelastic_relaxation",
    title="Poroelastic relaxation",
    summary="fluid leaves the pressed gel, in a time that grows with the contact.",
    parameters=(
        EffectParameter("share", "", 0.0, 0.0, 0.5, (0.2,)),
        # 0.1 to 400 s for a contact of 2 mm: a silicone that holds still for longer shows none.
        EffectParameter("diffusivity_m2_s", "m2/s", None, 1e-8, 4e-5, (4e-7, 1.2e-6, 4e-6, 1.2e-5)),
    ),
    channels=(SKIN, FORCE),
    protocol="held presses with two radii: the wider contact relaxes later",
    excited_by=lambda recording: recording.has(Phase.HOLD),
    taken_for=("viscoelastic_relaxation",),
    gel=_poroelastic_relaxation_gel,
)
"""The time is the contact's radius squared over the diffusivity (Hu, Zhao, Vlassak, Suo, "Using
indentation to characterize the poroelasticity of gels", 2010). One exponential stands for their
master curve, so that the solver's own relaxation does it. The radius is that of the recording's
deepest frame, by Hertz: the contact's edge lies half the depth above the tip, and the radius is
that of the circle of the indenter's cross-section there. Where there is no recording, in the live
sensor, the radius is 2 mm whatever presses: exact for contacts of this size alone.
"""


def _warmed(values: Values, response: Response) -> Response:
    gain = 1.0 - values["stiffness_change"] * math.expm1(-response.session_s / values["time_s"])
    return replace(response, force_n=gain * response.force_n)


THERMAL_DRIFT = Effect(
    name="thermal_drift",
    title="Thermal drift of the stiffness",
    summary="the gel grows stiffer or softer while its light warms it.",
    parameters=(
        EffectParameter("stiffness_change", "", 0.0, -0.1, 0.1, (0.05, -0.05)),
        EffectParameter("time_s", "s", None, 5.0, 3600.0, (20.0, 300.0)),
    ),
    channels=(FORCE,),
    protocol="the same press first and last, the light being on for half an hour between them",
    excited_by=presses_late,
    taken_for=("force_drift", "force_scale", "mullins_softening"),
    response=by_frame(_warmed),
)
"""The stiffness approaches a new value exponentially, like the temperature of a body that is heated
evenly and cooled at its surface. Only the force shows it: in a quasi-static press by a rigid
indenter the skin does not depend on Young's modulus. Rubber's modulus is proportional to the
absolute temperature, 0.3 % a kelvin (Treloar, "The physics of rubber elasticity", 1975); the range
is that of some thirty kelvins.
"""
