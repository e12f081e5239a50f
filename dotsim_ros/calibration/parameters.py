"""What can be fitted: each parameter's coordinate, prior, bounds and place in a sensor's file.

Fits work in coordinates in which the gel answers evenly: the logarithm of a stiffness, of friction
and of 1/2 - nu (compliance is smooth in it up to incompressibility), ratios and lengths as they
are. A prior is a normal distribution of the coordinate around the value that the sensor's file has.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.material import bulk_modulus_pa, shear_modulus_pa, small_strain_moduli_pa
from dotsim_ros.sensor import law_of
from dotsim_ros.specification import MaterialSpecification, SensorSpecification

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GelValues:
    """The gel's parameters, in SI units.

    Attributes:
        youngs_modulus_pa: at small strain.
        poisson_ratio: at small strain.
        friction: coefficient of the contact.
        c20_ratio, c30_ratio: Yeoh's C20 and C30 over C10; both 0 for a neo-Hookean gel.
        thickness_m: from the core's surface, or the pad's base, to the free surface.
    """

    youngs_modulus_pa: float
    poisson_ratio: float
    friction: float
    c20_ratio: float
    c30_ratio: float
    thickness_m: float


@dataclass(frozen=True)
class Parameter:
    """One parameter of the gel.

    Attributes:
        name: on the command line and in reports.
        field: of `GelValues` that it sets.
        unit: of its value.
        prior_width: one standard deviation of the prior, in the coordinate.
        bounds: smallest and largest value.
        step: of the differences, in the coordinate: so large that the solver's tolerance does not
            matter, so small that the answer is straight over it.
        to_coordinate, to_value: from the field's value to the coordinate, and back.
    """

    name: str
    field: str
    unit: str
    prior_width: float
    bounds: tuple[float, float]
    step: float
    to_coordinate: Callable[[float], float]
    to_value: Callable[[float], float]


def _same(value: float) -> float:
    return value


def _log(value: float) -> float:
    return float(np.log(value))


def _exp(value: float) -> float:
    return float(np.exp(value))


def _log_compressibility(poisson_ratio: float) -> float:
    return float(np.log(0.5 - poisson_ratio))


def _poisson_ratio(coordinate: float) -> float:
    return float(0.5 - np.exp(coordinate))


def _poisson(name: str, unit: str) -> Parameter:
    return Parameter(
        name, "poisson_ratio", unit, 0.8, (0.2, 0.4999), 0.2, _log_compressibility, _poisson_ratio
    )


PARAMETERS = {
    parameter.name: parameter
    for parameter in (
        Parameter("E", "youngs_modulus_pa", "Pa", 0.5, (1e3, 1e8), 0.05, _log, _exp),
        _poisson("nu", ""),
        # nu = 1/2 - E / (6 K): the same coordinate by another name.
        _poisson("bulk_modulus", "Pa"),
        Parameter("friction", "friction", "", 0.5, (0.02, 3.0), 0.1, _log, _exp),
        Parameter("c20", "c20_ratio", "of C10", 0.2, (-0.3, 2.0), 0.05, _same, _same),
        Parameter("c30", "c30_ratio", "of C10", 0.1, (-0.1, 2.0), 0.05, _same, _same),
        Parameter("thickness", "thickness_m", "m", 0.3e-3, (1e-3, 0.1), 0.1e-3, _same, _same),
    )
}
"""What `--fit` may name, beside `offset`."""


def chosen_parameters(names: Sequence[str]) -> tuple[Parameter, ...]:
    """Return the parameters of the given names.

    Raises:
        ValueError: an unknown name, a name twice, none, or two names of the same parameter.
    """
    unknown = sorted(set(names) - set(PARAMETERS))
    if unknown:
        raise ValueError(f"unknown parameters {unknown}; known are {', '.join(PARAMETERS)}")
    chosen = tuple(PARAMETERS[name] for name in names)
    if not chosen:
        raise ValueError("nothing to fit; name a parameter, such as E")
    fields = [parameter.field for parameter in chosen]
    if len(set(fields)) < len(fields):
        raise ValueError(
            f"{' '.join(names)}: a parameter twice (nu and bulk_modulus are one, given E)"
        )
    return chosen


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
    if s.gel.shape == "dome":
        thickness = s.gel.outer_radius_m - s.gel.core_radius_m
    else:
        thickness = s.gel.pad_size_m[2]
    return GelValues(
        youngs_modulus_pa=youngs,
        poisson_ratio=0.5 - youngs / (6.0 * bulk),
        friction=s.contact.friction_coefficient,
        c20_ratio=c20 / c10,
        c30_ratio=c30 / c10,
        thickness_m=thickness,
    )


def specification_with(
    specification: SensorSpecification, values: GelValues
) -> SensorSpecification:
    """Return a sensor with the given parameters; a dome keeps its outer radius.

    Raises:
        ValueError: a value that the sensor cannot have.
    """
    v, gel = values, specification.gel
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
        gel = replace(gel, core_radius_m=gel.outer_radius_m - v.thickness_m)
    else:
        gel = replace(gel, pad_size_m=(*gel.pad_size_m[:2], v.thickness_m))
    return replace(
        specification,
        gel=gel,
        material=material,
        contact=replace(specification.contact, friction_coefficient=v.friction),
    )


def coordinates(parameters: Sequence[Parameter], values: GelValues) -> Array:
    """Return the coordinates (P,) of the chosen parameters."""
    return np.array([p.to_coordinate(getattr(values, p.field)) for p in parameters])


def with_coordinates(
    values: GelValues, parameters: Sequence[Parameter], coordinate: Array
) -> GelValues:
    """Return the values with the chosen parameters at coordinates (P,), kept within bounds."""
    changes = {
        p.field: float(np.clip(p.to_value(float(x)), *p.bounds))
        for p, x in zip(parameters, coordinate, strict=True)
    }
    return replace(values, **changes)


def shown_value(parameter: Parameter, values: GelValues) -> float:
    """Return a parameter's value in its unit."""
    if parameter.name == "bulk_modulus":
        return bulk_modulus_pa(values.youngs_modulus_pa, values.poisson_ratio)
    return float(getattr(values, parameter.field))
