# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Permanent set: the skin does not come back all the way.

Every marker remembers its largest displacement, and keeps a share of it. As it goes back, what it
keeps grows in proportion to how far it has gone back: at the largest displacement the indenter
still determines where the skin is. The force that a set takes from the next contact is left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dotsim_ros.effects.effect import (
    SKIN,
    Effect,
    EffectParameter,
    Response,
    ResponseFilter,
    Values,
)
from dotsim_ros.effects.excitation import rests_after_contact


def _response(values: Values) -> ResponseFilter:
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


EFFECT = Effect(
    name="permanent_set",
    title="Permanent set",
    parameters=(EffectParameter("share", "", 0.0, 0.0, 0.1, (0.04,)),),
    channels=(SKIN,),
    protocol="cycles with the skin untouched between them, and a minute of rest at the end",
    excited_by=rests_after_contact,
    taken_for=("viscoelastic_relaxation", "mullins_softening", "camera extrinsics"),
    response=_response,
)
