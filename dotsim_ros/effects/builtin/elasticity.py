# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of the elastic gel: its law, its thickness, and what use does to both."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.effect import (
    FORCE,
    SKIN,
    Effect,
    EffectParameter,
    GelTerm,
    Response,
    ResponseFilter,
    Values,
    with_gel,
)
from dotsim_ros.effects.excitation import rests_after_contact, strains, touches, unloads
from dotsim_ros.gel.values import GEL_PARAMETERS

C20, POISSON_RATIO = GEL_PARAMETERS["c20_ratio"], GEL_PARAMETERS["poisson_ratio"]


HYPERELASTIC_STIFFENING = Effect(
    name="hyperelastic_stiffening",
    title="Stiffening at large strain (Yeoh's C20)",
    summary="the gel stiffens more, or less, at large strain than the twin's.",
    parameters=(EffectParameter("c20_ratio", C20.unit, 0.0, -0.1, 0.5, (0.3, -0.08)),),
    channels=(SKIN, FORCE),
    protocol="slow presses to three depths, the deepest beyond 2 mm, with a narrow indenter",
    excited_by=strains,
    taken_for=("compressibility", "thickness_error", "mullins_softening"),
    gel=lambda term, values, _: with_gel(
        term, c20_ratio=term.values.c20_ratio + values["c20_ratio"]
    ),
)
"""Yeoh, "Some forms of the strain energy function for rubber", 1993: the energy's second
coefficient. The third one shows the same at larger strain; presses of a fingertip cannot
distinguish the two.
"""


def _compressibility_gel(term: GelTerm, values: Values, recording: Recording | None) -> GelTerm:
    shift = values["log_compressibility_shift"]
    if shift == 0.0:
        return term
    ratio = 0.5 - (0.5 - term.values.poisson_ratio) * float(np.exp(shift))
    return with_gel(term, poisson_ratio=float(np.clip(ratio, *POISSON_RATIO.bounds)))


COMPRESSIBILITY = Effect(
    name="compressibility",
    title="Compressibility (another Poisson's ratio)",
    # From the twin's 0.48, these are ratios of 0.45 and 0.4995.
    summary="Poisson's ratio nu is another than the twin's.",
    parameters=(EffectParameter("log_compressibility_shift", "", 0.0, -3.7, 0.92, (-1.0, 0.7)),),
    channels=(SKIN, FORCE),
    protocol="slow presses with two radii: the skin bulges next to the contact",
    excited_by=touches,
    taken_for=("youngs_modulus", "coulomb_slip", "thickness_error"),
    gel=_compressibility_gel,
)
"""The size is the change of log(1/2 - nu), in which the compliance is straight up to
incompressibility; it is zero at the twin's own ratio.
"""


THICKNESS_ERROR = Effect(
    name="thickness_error",
    title="Another thickness of the gel",
    summary="the gel is thicker, or thinner, than the sensor's file says.",
    parameters=(EffectParameter("thickness_share", "", 0.0, -0.15, 0.15, (0.1, -0.1)),),
    channels=(SKIN, FORCE),
    protocol="oblique presses all over the skin, to depths of a fifth of the thickness",
    excited_by=strains,
    taken_for=("youngs_modulus", "compressibility", "hyperelastic_stiffening"),
    gel=lambda term, values, _: with_gel(
        term, thickness_m=term.values.thickness_m * (1.0 + values["thickness_share"])
    ),
)

WORK_POWER = 5.0 / 3.0


def _mullins_softening_response(values: Values) -> ResponseFilter:
    share, width = values["share"], values["width"]
    largest_n = 0.0

    def softened(response: Response) -> Response:
        nonlocal largest_n
        load_n = float(np.linalg.norm(response.force_n))
        largest_n = max(largest_n, load_n)
        if largest_n == 0.0:
            return response
        unused = 1.0 - (load_n / largest_n) ** WORK_POWER
        return replace(
            response, force_n=response.force_n * (1.0 - share * math.erf(unused / width))
        )

    return softened


MULLINS_SOFTENING = Effect(
    name="mullins_softening",
    title="Mullins softening",
    summary="a gel that was loaded once is softer below that load.",
    parameters=(
        EffectParameter("share", "", 0.0, 0.0, 0.35, (0.15,)),
        EffectParameter("width", "", None, 0.1, 1.5, (0.3, 0.8)),
    ),
    channels=(FORCE,),
    protocol="cycles of rising depth on a gel that has rested: the second is softer up to the "
    "first one's peak",
    excited_by=unloads,
    taken_for=("permanent_set", "viscoelastic_relaxation", "hyperelastic_stiffening"),
    response=_mullins_softening_response,
)
"""The pseudo-elastic form of Ogden and Roxburgh, "A pseudo-elastic model for the Mullins effect in
filled rubber", 1999, on the response as a whole: below the largest load so far, the force is
multiplied by 1 - share * erf((1 - w / w_max) / width), w being the work that the load has done. By
Hertz the work goes with the force to the power 5/3. An indenter that is held at a depth leaves the
skin where it is. The memory is one for the whole gel: a contact elsewhere finds it soft, too.
"""


def _permanent_set_response(values: Values) -> ResponseFilter:
    share = values["share"]
    largest_m = None

    def kept(response: Response) -> Response:
        nonlocal largest_m
        moved_m = response.skin_position_m - response.rest_position_m
        size = np.linalg.norm(moved_m, axis=1)
        if largest_m is None:
            largest_m = moved_m.copy()
        grows = size > np.linalg.norm(largest_m, axis=1)
        largest_m[grows] = moved_m[grows]
        peak = np.linalg.norm(largest_m, axis=1)
        gone_back = 1.0 - size / np.where(peak > 0.0, peak, 1.0)
        return replace(
            response,
            skin_position_m=response.skin_position_m + share * gone_back[:, None] * largest_m,
        )

    return kept


PERMANENT_SET = Effect(
    name="permanent_set",
    title="Permanent set",
    summary="the skin does not come back all the way.",
    parameters=(EffectParameter("share", "", 0.0, 0.0, 0.1, (0.04,)),),
    channels=(SKIN,),
    protocol="cycles with the skin untouched between them, and a minute of rest at the end",
    excited_by=rests_after_contact,
    taken_for=("viscoelastic_relaxation", "mullins_softening", "camera extrinsics"),
    response=_permanent_set_response,
)
"""Every marker remembers its largest displacement, and keeps a share of it. As it goes back, what
it keeps grows in proportion to how far it has gone back: at the largest displacement the indenter
still determines where the skin is. The force that a set takes from the next contact is left out.
"""
