# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What can be fitted: the gel's parameters by their names, and values at their coordinates.

Fits work in coordinates in which the response is close to linear: the logarithm of a stiffness, of
friction and of 1/2 - nu (compliance is smooth in it up to incompressibility); ratios and lengths as
they are. A prior is a normal distribution of the coordinate around the value that the sensor's
file has. `dotsim_ros.gel.values.GelValues` declares each of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dotsim_ros.gel.material import bulk_modulus_pa
from dotsim_ros.gel.values import GEL_PARAMETERS, GelParameter, GelValues
from dotsim_ros.io.arrays import FloatArray

BULK_MODULUS = "bulk_modulus"
PARAMETERS = {
    **{parameter.name: parameter for parameter in GEL_PARAMETERS.values() if parameter.name},
    # nu = 1/2 - E / (6 K): the same coordinate by another name.
    BULK_MODULUS: replace(GEL_PARAMETERS["poisson_ratio"], name=BULK_MODULUS, unit="Pa"),
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
    if parameter.name == BULK_MODULUS:
        return bulk_modulus_pa(values.youngs_modulus_pa, values.poisson_ratio)
    return float(getattr(values, parameter.field))
