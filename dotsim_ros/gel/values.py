# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A gel as the few values that a fit or an effect changes, and the specification that has them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dotsim_ros.gel.make import law_of
from dotsim_ros.gel.material import bulk_modulus_pa, shear_modulus_pa, small_strain_moduli_pa
from dotsim_ros.specification import (
    WHOLE_CORE_RAD,
    MaterialSpecification,
    SensorSpecification,
)


@dataclass(frozen=True)
class GelValues:
    """The gel's parameters, in SI units.

    Attributes:
        youngs_modulus_pa: at small strain.
        poisson_ratio: at small strain.
        friction: coefficient of the contact.
        contact_stiffness: of the contact, in units of E over 1.2 mm.
        c20_ratio, c30_ratio: Yeoh's C20 and C30 over C10; both 0 for a neo-Hookean gel.
        thickness_m: from the core's surface, or the pad's base, to the free surface.
        bond_slip_share, loose_patch_rad: how far the gel has come off its core, and where, as in
            `GelSpecification`.
    """

    youngs_modulus_pa: float
    poisson_ratio: float
    friction: float
    contact_stiffness: float
    c20_ratio: float
    c30_ratio: float
    thickness_m: float
    bond_slip_share: float = 0.0
    loose_patch_rad: tuple[float, float, float] = WHOLE_CORE_RAD


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
    return GelValues(
        youngs_modulus_pa=youngs,
        poisson_ratio=0.5 - youngs / (6.0 * bulk),
        friction=s.contact.friction_coefficient,
        contact_stiffness=s.contact.stiffness,
        c20_ratio=c20 / c10,
        c30_ratio=c30 / c10,
        thickness_m=s.gel.thickness_m,
        bond_slip_share=s.gel.bond_slip_share,
        loose_patch_rad=s.gel.loose_patch_rad,
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
    mu = shear_modulus_pa(v.youngs_modulus_pa, v.poisson_ratio)
    bulk = bulk_modulus_pa(v.youngs_modulus_pa, v.poisson_ratio)
    old = specification.material
    relaxation = MaterialSpecification(
        prony_shares=old.prony_shares,
        prony_times_s=old.prony_times_s,
        density_kg_m3=old.density_kg_m3,
    )
    if v.c20_ratio == 0.0 and v.c30_ratio == 0.0:
        material = replace(
            relaxation,
            law="neo_hookean",
            youngs_modulus_pa=v.youngs_modulus_pa,
            poisson_ratio=v.poisson_ratio,
        )
    else:
        material = replace(
            relaxation,
            law="yeoh",
            c10_pa=0.5 * mu,
            c20_pa=0.5 * mu * v.c20_ratio,
            c30_pa=0.5 * mu * v.c30_ratio,
            bulk_modulus_pa=bulk,
        )
    if gel.shape == "dome":
        gel = replace(
            gel,
            core_radius_m=gel.outer_radius_m - v.thickness_m,
            bond_slip_share=v.bond_slip_share,
            loose_patch_rad=v.loose_patch_rad,
        )
    else:
        gel = replace(gel, pad_size_m=(*gel.pad_size_m[:2], v.thickness_m))
        finest_m = min(solver.grid_spacing_m, 0.5 * v.thickness_m)
        solver = replace(solver, grid_spacing_m=finest_m)
    return replace(
        specification,
        gel=gel,
        solver=solver,
        material=material,
        contact=replace(
            specification.contact,
            friction_coefficient=v.friction,
            stiffness=v.contact_stiffness,
        ),
    )
