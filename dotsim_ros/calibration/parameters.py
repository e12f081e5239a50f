# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What can be fitted: each parameter's coordinate, prior, bounds and place in a sensor's file.

Fits work in coordinates in which the response is close to linear: the logarithm of a stiffness, of
friction and of 1/2 - nu (compliance is smooth in it up to incompressibility); ratios and lengths as
they are. A prior is a normal distribution of the coordinate around the value that the sensor's
file has.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dotsim_ros.gel.material import bulk_modulus_pa
from dotsim_ros.gel.values import GelValues
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class GelParameter:
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
        model_error: RMS of the coordinate, by which the constant that fits a unit differs from that
            of its material, which another solver was given; None where that is not known. Learnt
            from five units of the series of the gap finder's study, judged on five others
            (docs/calibration.md).
    """

    name: str
    field: str
    unit: str
    prior_width: float
    bounds: tuple[float, float]
    step: float
    to_coordinate: Callable[[float], float]
    to_value: Callable[[float], float]
    model_error: float | None = None

    def bound_of(self, value: float) -> float | None:
        """Return the bound that a value of the field lies at; None for one between them."""
        return next((bound for bound in self.bounds if np.isclose(value, bound, rtol=1e-6)), None)


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


def _poisson(name: str, unit: str) -> GelParameter:
    return GelParameter(
        name,
        "poisson_ratio",
        unit,
        0.8,
        (0.2, 0.4999),
        0.2,
        _log_compressibility,
        _poisson_ratio,
        0.515,
    )


PARAMETERS = {
    parameter.name: parameter
    for parameter in (
        GelParameter("E", "youngs_modulus_pa", "Pa", 0.5, (1e3, 1e8), 0.05, _log, _exp, 0.018),
        _poisson("nu", ""),
        # nu = 1/2 - E / (6 K): the same coordinate by another name.
        _poisson("bulk_modulus", "Pa"),
        GelParameter("friction", "friction", "", 0.5, (0.02, 3.0), 0.1, _log, _exp, 0.192),
        GelParameter(
            "contact_stiffness", "contact_stiffness", "E/1.2 mm", 1.0, (2.0, 1e3), 0.2, _log, _exp
        ),
        GelParameter("c20", "c20_ratio", "of C10", 0.2, (-0.3, 2.0), 0.05, _same, _same),
        GelParameter("c30", "c30_ratio", "of C10", 0.1, (-0.1, 2.0), 0.05, _same, _same),
        GelParameter("thickness", "thickness_m", "m", 0.3e-3, (1e-3, 0.1), 0.1e-3, _same, _same),
    )
}
"""What `--fit` may name, next to `offset`."""


def chosen_parameters(names: Sequence[str]) -> tuple[GelParameter, ...]:
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


def coordinates(parameters: Sequence[GelParameter], values: GelValues) -> FloatArray:
    """Return the coordinates (P,) of the chosen parameters."""
    return np.array([p.to_coordinate(getattr(values, p.field)) for p in parameters])


def coordinate_bounds(parameters: Sequence[GelParameter]) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and the largest coordinates (P,) of the chosen parameters."""
    ends = np.array([[p.to_coordinate(bound) for bound in p.bounds] for p in parameters])
    return ends.min(axis=1), ends.max(axis=1)


def with_coordinates(
    values: GelValues, parameters: Sequence[GelParameter], coordinate: FloatArray
) -> GelValues:
    """Return the values with the chosen parameters at coordinates (P,), kept within bounds."""
    # Every field that can be fitted is a number.
    changes: dict[str, Any] = {
        p.field: float(np.clip(p.to_value(float(x)), *p.bounds))
        for p, x in zip(parameters, coordinate, strict=True)
    }
    return replace(values, **changes)


def shown_value(parameter: GelParameter, values: GelValues) -> float:
    """Return a parameter's value in its unit."""
    if parameter.name == "bulk_modulus":
        return bulk_modulus_pa(values.youngs_modulus_pa, values.poisson_ratio)
    return float(getattr(values, parameter.field))
