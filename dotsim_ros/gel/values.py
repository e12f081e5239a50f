# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a calibration or an effect changes of the gel, each parameter declared once: read from a
sensor's file, and written into one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from dotsim_ros.gel.material import (
    bulk_modulus_pa,
    law_of,
    shear_modulus_pa,
    small_strain_moduli_pa,
)
from dotsim_ros.io.quantity import quantities_of
from dotsim_ros.specification import (
    SECTIONS,
    GelSpecification,
    MaterialSpecification,
    SensorSpecification,
)

COORDINATES: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {
    "": (float, float),
    "log": (np.log, np.exp),
    "log(1/2 - nu)": (lambda ratio: np.log(0.5 - ratio), lambda place: 0.5 - np.exp(place)),
}
"""From a value to the coordinate in which the gel's response is close to linear, and back."""
LAW_CONSTANTS = (
    *("youngs_modulus_pa", "poisson_ratio"),
    *("c10_pa", "c01_pa", "c20_pa", "c30_pa", "bulk_modulus_pa"),
)
"""Fields of a material that its law takes; the others are kept under another law."""


@dataclass(frozen=True)
class GelParameter:
    """One of `GelValues`, as calibration, effects and the twin know it.

    Attributes:
        field: of `GelValues`.
        section, entry: where a sensor's file has the same number; empty for one that `values_of`
            works out from several.
        unit: of its value.
        name: of `--fit` and reports; empty for one that no calibration fits.
        bounds: smallest and largest value that is searched.
        coordinate: that it is searched in, a key of `COORDINATES`.
        prior_width: one standard deviation of the prior, in the coordinate.
        step: of the differences, in the coordinate: so large that the solver's tolerance does not
            matter, so small that the answer is straight over it.
        model_error: RMS of the coordinate, by which the constant that fits a unit differs from that
            of its material, which another solver was given; None where that is not known. Learnt
            from five units of the series of the gap finder's study, judged on five others
            (docs/calibration.md).
    """

    field: str
    unit: str
    section: str = ""
    entry: str = ""
    name: str = ""
    bounds: tuple[float, float] = (-math.inf, math.inf)
    coordinate: str = ""
    prior_width: float = math.nan
    step: float = math.nan
    model_error: float | None = None

    @property
    def is_elastic(self) -> bool:
        """Whether a gel must be recreated for another value: all but the contact's numbers, and
        Young's modulus, which scales the force alone."""
        return self.section != "contact" and self.field != "youngs_modulus_pa"

    def to_coordinate(self, value: float) -> float:
        """Return the coordinate of a value."""
        return float(COORDINATES[self.coordinate][0](value))

    def to_value(self, coordinate: float) -> float:
        """Return the value at a coordinate."""
        return float(COORDINATES[self.coordinate][1](coordinate))

    def bound_of(self, value: float) -> float | None:
        """Return the bound that a value lies at; None for one between them."""
        return next((bound for bound in self.bounds if np.isclose(value, bound, rtol=1e-6)), None)


def _own(default: float, unit: str = "", **fit: Any) -> Any:
    """Return a field of `GelValues` that follows from several numbers of a sensor's file."""
    return field(default=default, metadata={"unit": unit, **fit})


def _entry(section: str, entry: str, *, unit: str | None = None, **fit: Any) -> Any:
    """Return a field of `GelValues` that a section has: its default and, unless given, unit."""
    default, known = quantities_of(SECTIONS[section])[entry]
    place = {"section": section, "entry": entry, "unit": known.unit if unit is None else unit}
    return field(default=default, metadata={**place, **fit})


@dataclass(frozen=True)
class GelValues:
    """The gel's parameters that a calibration or an effect changes, each declared here alone: its
    place in a sensor's file (with unit, range and default there), and how it is searched.

    A number that a section has needs a line here, and then is read and written,
    `--fit` knows it by its name, and the twin makes another gel for it.

    Attributes:
        youngs_modulus_pa, poisson_ratio: at small strain, of whichever law.
        friction: coefficient of the contact.
        contact_stiffness: of the contact, in units of E over 1.2 mm.
        c20_ratio, c30_ratio: Yeoh's C20 and C30 over C10; both 0 for a neo-Hookean gel.
        thickness_m: from the core's surface, or the pad's base, to the free surface.
        bond_slip_share, loose_patch_rad: how far the gel has come off its core, and where, as in
            `GelSpecification`.
    """

    youngs_modulus_pa: float = _own(
        MaterialSpecification.youngs_modulus_pa,
        "Pa",
        name="E",
        bounds=(1e3, 1e8),
        coordinate="log",
        prior_width=0.5,
        step=0.05,
        model_error=0.018,
    )
    poisson_ratio: float = _own(
        MaterialSpecification.poisson_ratio,
        name="nu",
        bounds=(0.2, 0.4999),
        coordinate="log(1/2 - nu)",
        prior_width=0.8,
        step=0.2,
        model_error=0.515,
    )
    friction: float = _entry(
        "contact",
        "friction_coefficient",
        name="friction",
        bounds=(0.02, 3.0),
        coordinate="log",
        prior_width=0.5,
        step=0.1,
        model_error=0.192,
    )
    contact_stiffness: float = _entry(
        "contact",
        "stiffness",
        unit="E/1.2 mm",
        name="contact_stiffness",
        bounds=(2.0, 1e3),
        coordinate="log",
        prior_width=1.0,
        step=0.2,
    )
    c20_ratio: float = _own(
        0.0, "of C10", name="c20", bounds=(-0.3, 2.0), prior_width=0.2, step=0.05
    )
    c30_ratio: float = _own(
        0.0, "of C10", name="c30", bounds=(-0.1, 2.0), prior_width=0.1, step=0.05
    )
    thickness_m: float = _own(
        GelSpecification().thickness_m,
        "m",
        name="thickness",
        bounds=(1e-3, 0.1),
        prior_width=0.3e-3,
        step=0.1e-3,
    )
    bond_slip_share: float = _entry("gel", "bond_slip_share")
    loose_patch_rad: tuple[float, float, float] = _entry("gel", "loose_patch_rad")


GEL_PARAMETERS = {each.name: GelParameter(each.name, **each.metadata) for each in fields(GelValues)}
"""By their fields of `GelValues`."""


def values_of(specification: SensorSpecification) -> GelValues:
    """Return the parameters that a sensor's file has.

    Raises:
        ValueError: a law with a second invariant, or one without constants.
    """
    s = specification
    c10, c01, c20, c30, _ = law_of(s.material).coefficients_pa().tolist()
    if c01 != 0.0:
        raise ValueError(
            f"material.law is {s.material.law!r}, expected neo_hookean or yeoh for a calibration"
        )
    youngs, bulk = map(float, small_strain_moduli_pa(law_of(s.material)))
    entries: dict[str, Any] = {
        p.field: getattr(getattr(s, p.section), p.entry)
        for p in GEL_PARAMETERS.values()
        if p.section
    }
    return GelValues(
        youngs_modulus_pa=youngs,
        poisson_ratio=0.5 - youngs / (6.0 * bulk),
        c20_ratio=c20 / c10,
        c30_ratio=c30 / c10,
        thickness_m=s.gel.thickness_m,
        **entries,
    )


def specification_with(
    specification: SensorSpecification, values: GelValues
) -> SensorSpecification:
    """Return a sensor with the given parameters; a dome keeps its outer radius, and the grid of a
    pad becomes as fine as its thickness asks for.

    Raises:
        ValueError: a value that the sensor cannot have.
    """
    v, gel, solver = values, specification.gel, specification.solver
    changes: dict[str, dict[str, Any]] = {"gel": {}, "material": _law(v), "contact": {}}
    for parameter in GEL_PARAMETERS.values():
        if parameter.section:
            changes[parameter.section][parameter.entry] = getattr(v, parameter.field)
    if gel.shape == "dome":
        changes["gel"]["core_radius_m"] = gel.outer_radius_m - v.thickness_m
    else:
        # A pad has no core that it could come off.
        changes["gel"] = {"pad_size_m": (*gel.pad_size_m[:2], v.thickness_m)}
        finest_m = min(solver.grid_spacing_m, 0.5 * v.thickness_m)
        solver = replace(solver, grid_spacing_m=finest_m)
    return replace(
        specification,
        gel=replace(gel, **changes["gel"]),
        solver=solver,
        material=replace(specification.material, **changes["material"]),
        contact=replace(specification.contact, **changes["contact"]),
    )


def _law(values: GelValues) -> dict[str, Any]:
    """Return the fields of a material that has the law of the values: Yeoh's, or neo-Hooke's."""
    v = values
    unset = {name: getattr(MaterialSpecification, name) for name in LAW_CONSTANTS}
    if v.c20_ratio == 0.0 and v.c30_ratio == 0.0:
        own = {"youngs_modulus_pa": v.youngs_modulus_pa, "poisson_ratio": v.poisson_ratio}
        return {"law": "neo_hookean", **unset, **own}
    mu = shear_modulus_pa(v.youngs_modulus_pa, v.poisson_ratio)
    return {
        "law": "yeoh",
        **unset,
        "c10_pa": 0.5 * mu,
        "c20_pa": 0.5 * mu * v.c20_ratio,
        "c30_pa": 0.5 * mu * v.c30_ratio,
        "bulk_modulus_pa": bulk_modulus_pa(v.youngs_modulus_pa, v.poisson_ratio),
    }
