# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of friction, contact and the bond of the gel."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from dotsim_ros.data.recording import Phase, Recording
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
from dotsim_ros.effects.excitation import touches, unloads

COULOMB_SLIP = Effect(
    name="coulomb_slip",
    title="Coulomb slip at another friction",
    summary="the skin slides on the indenter at another coefficient than the twin's.",
    parameters=(EffectParameter("friction_ratio", "", 1.0, 0.1, 5.0, (0.6, 1.6)),),
    channels=(SKIN, FORCE),
    protocol="a slide of two contact radii, or an oblique press",
    excited_by=lambda recording: recording.has(Phase.SLIDE),
    taken_for=("numerical shear stiffness",),
    gel=lambda term, values, _: with_gel(
        term, friction=term.values.friction * values["friction_ratio"]
    ),
)


@dataclass(frozen=True)
class ClingingContact:
    """A contact that was pressed to a depth and is pulled off.

    Attributes:
        modulus_pa: E / (1 - nu^2).
        radius_m: of the indenter.
        work_j_m2: that takes one square metre of skin off.
        deepest_m: where the pull began.
    """

    modulus_pa: float
    radius_m: float
    work_j_m2: float
    deepest_m: float

    @property
    def widest_m(self) -> float:
        """Radius of the contact at its deepest."""
        return float(np.sqrt(self.radius_m * self.deepest_m))

    @property
    def narrowest_m(self) -> float:
        """Radius at which it breaks off."""
        critical = np.pi * self.work_j_m2 * self.radius_m**2 / (8.0 * self.modulus_pa)
        return float(np.cbrt(critical))

    def depth_at(self, contact_m: float) -> float:
        """Return the depth at which an edge of the given radius recedes."""
        stretch = np.sqrt(2.0 * np.pi * self.work_j_m2 * contact_m / self.modulus_pa)
        return float(contact_m**2 / self.radius_m - stretch)

    def hertz_n(self, depth_m: float) -> float:
        """Return the force without adhesion."""
        pressed = max(0.0, depth_m)
        return float(4.0 / 3.0 * self.modulus_pa * np.sqrt(self.radius_m * pressed) * pressed)

    def force_n(self, depth_m: float) -> float | None:
        """Return the force on the way out, negative where it pulls; None once contact is lost."""
        if depth_m >= self.depth_at(self.widest_m):
            fallen_m = self.deepest_m - depth_m
            return self.hertz_n(self.deepest_m) - 2.0 * self.modulus_pa * self.widest_m * fallen_m
        if self.widest_m <= self.narrowest_m or depth_m < self.depth_at(self.narrowest_m):
            return None
        contact_m = brentq(
            lambda a: self.depth_at(a) - depth_m, self.narrowest_m, self.widest_m, xtol=1e-9
        )
        pull_n = np.sqrt(8.0 * np.pi * self.work_j_m2 * self.modulus_pa * contact_m**3)
        return float(4.0 * self.modulus_pa * contact_m**3 / (3.0 * self.radius_m) - pull_n)


def _response(values: Values) -> ResponseFilter:
    work, radius_m = values["work_j_m2"], values["radius_m"]
    contact: ClingingContact | None = None

    def clinging(response: Response) -> Response:
        nonlocal contact
        axis = response.pose.rotation()[:, 2]
        load_n, depth_m = float(response.force_n @ axis), response.depth_m
        if work == 0.0:
            return response
        if contact is None or depth_m >= contact.deepest_m:
            contact = None
            if depth_m > 0.0 and load_n > 0.0:
                modulus_pa = 0.75 * load_n / np.sqrt(radius_m * depth_m**3)
                contact = ClingingContact(float(modulus_pa), radius_m, work, depth_m)
            return response
        force_n = contact.force_n(depth_m)
        if force_n is None:
            contact = None
            return response
        return replace(
            response, force_n=response.force_n + (force_n - contact.hertz_n(depth_m)) * axis
        )

    return clinging


ADHESION = Effect(
    name="adhesion",
    title="Adhesion on release",
    summary="the skin sticks to the indenter as it is withdrawn, and pulls on it.",
    parameters=(
        EffectParameter("work_j_m2", "J/m2", 0.0, 0.0, 1.0, (0.2,)),
        EffectParameter("radius_m", "m", None, 1e-3, 15e-3, (3e-3,)),
    ),
    channels=(FORCE,),
    protocol="a slow release with frames every 0.05 mm up to 0.5 mm above the skin",
    excited_by=unloads,
    taken_for=("backlash", "viscoelastic_relaxation"),
    response=_response,
)
"""Johnson, Kendall and Roberts, "Surface energy and the contact of elastic solids", 1971, on
release alone: a skin that is pressed on does not cling, one that is pulled off does. From the
deepest point the edge of the contact stays (the force falls as under a flat punch; Maugis and
Barquins, "Fracture mechanics and the adherence of viscoelastic bodies", 1978) until the energy that
a receding edge sets free is the work of adhesion; from there it recedes along the curve of 1971 and
breaks off at its end. What Hertz would give is taken away from it, and the rest is added to the
force.

An approximation: the contact is that of a half space with one radius, its modulus follows from the
force at the deepest point, and the neck of the skin, some hundredths of a millimetre, is left out.
"""


def _lost_bond_gel(term: GelTerm, values: Values, recording: Recording | None) -> GelTerm:
    own = term.values
    if values["slip_share"] == 0.0:
        return term
    patch = (values["x_rad"], values["y_rad"], values["radius_rad"])
    if own.bond_slip_share > 0.0:
        # A gel has one patch: that which has come off already gets looser.
        patch = own.loose_patch_rad
    slip = 1.0 - (1.0 - own.bond_slip_share) * (1.0 - values["slip_share"])
    return with_gel(term, bond_slip_share=slip, loose_patch_rad=patch)


LOST_BOND = Effect(
    name="lost_bond",
    title="A gel that has come off its core",
    summary="the gel has come off its core, and slides on it.",
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
    gel=_lost_bond_gel,
)
"""The size is the share of a shear's sliding that the bond lets through (`dotsim_ros.gel.bond`); at
1, where it slides freely, the range ends by nature. The air's pressure keeps the gel on the core,
so that it does not open. A search looks for a bond that is lost all over the core; a smaller patch
is for simulation, or for a file of your own with its place as probes.
"""
