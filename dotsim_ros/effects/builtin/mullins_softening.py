# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Mullins softening: a gel that was loaded once is softer below that load.

The pseudo-elastic form of Ogden and Roxburgh, "A pseudo-elastic model for the Mullins effect in
filled rubber", 1999, on the response as a whole: below the largest load so far, the force is
multiplied by 1 - share * erf((1 - w / w_max) / width), w being the work that the load has done.
By Hertz the work goes with the force to the power 5/3. An indenter that is held at a depth leaves
the skin where it is. The memory is one for the whole gel: a contact elsewhere finds it soft, too.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dotsim_ros.effects.effect import (
    FORCE,
    Effect,
    EffectParameter,
    Response,
    ResponseFilter,
    Values,
)
from dotsim_ros.effects.excitation import unloads

WORK_POWER = 5.0 / 3.0


def _response(values: Values) -> ResponseFilter:
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


EFFECT = Effect(
    name="mullins_softening",
    title="Mullins softening",
    parameters=(
        EffectParameter("share", "", 0.0, 0.0, 0.35, (0.15,)),
        EffectParameter("width", "", None, 0.1, 1.5, (0.3, 0.8)),
    ),
    channels=(FORCE,),
    protocol="cycles of rising depth on a gel that has rested: the second is softer up to the "
    "first one's peak",
    excited_by=unloads,
    taken_for=("permanent_set", "viscoelastic_relaxation", "hyperelastic_stiffening"),
    response=_response,
)
