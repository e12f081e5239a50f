# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel's values of a sensor's file, and the file that has given values."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dotsim_ros.gel.material import (
    bulk_modulus_pa,
    law_of,
    shear_modulus_pa,
    small_strain_moduli_pa,
)
from dotsim_ros.specification import (
    GEL_PARAMETERS,
    GelValues,
    MaterialSpecification,
    SensorSpecification,
)

__all__ = ["GelValues", "specification_with", "values_of"]

LAW_CONSTANTS = (
    *("youngs_modulus_pa", "poisson_ratio"),
    *("c10_pa", "c01_pa", "c20_pa", "c30_pa", "bulk_modulus_pa"),
)
"""Fields of a material that its law takes; the others are kept under another law."""


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
