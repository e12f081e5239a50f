# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One declaration of a gel's parameter: what reads it, and what a further one needs."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

from dotsim_ros.calibration.parameters import PARAMETERS, coordinates, with_coordinates
from dotsim_ros.effects.effect import Active, GelTerm, gel_with
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gap.presses.assumptions import ABSOLUTE, GEL_CONSTANTS
from dotsim_ros.gel.values import GEL_PARAMETERS, GelValues, specification_with, values_of
from dotsim_ros.io.quantity import quantities_of
from dotsim_ros.specification import SensorSpecification, load_sensor
from dotsim_ros.twin.simulator import gel_key

SENSOR = load_sensor("densetact2")
OWN = values_of(SENSOR)
NUMBERS = [name for name in GEL_PARAMETERS if name != "loose_patch_rad"]
LAWS_OR_LENGTH = {"youngs_modulus_pa", "poisson_ratio", "c20_ratio", "c30_ratio", "thickness_m"}
"""What follows from several entries of a sensor's file; a further parameter has an entry."""


def other_value(field: str) -> float:
    """Return a value that the twin does not have."""
    return 0.3 if field == "bond_slip_share" else 0.9 * (getattr(OWN, field) or 0.1)


def approximately(values: GelValues) -> Any:
    return pytest.approx(asdict(values), rel=1e-9)


@pytest.mark.parametrize("field", NUMBERS)
def test_a_declaration_is_all_that_file_fit_and_twin_need(field: str) -> None:
    parameter, value = GEL_PARAMETERS[field], other_value(field)
    change: dict[str, Any] = {field: value}
    changed = replace(OWN, **change)
    written = specification_with(SENSOR, changed)
    assert getattr(values_of(written), field) == pytest.approx(value, rel=1e-9)
    assert gel_key(changed) != gel_key(OWN) or not parameter.is_elastic
    assert (field in LAWS_OR_LENGTH) != bool(parameter.section)
    if parameter.section:
        default, known = quantities_of(type(getattr(SENSOR, parameter.section)))[parameter.entry]
        assert getattr(written, parameter.section) == replace(
            getattr(SENSOR, parameter.section), **{parameter.entry: value}
        )
        assert GelValues.__dataclass_fields__[field].default == default
        assert parameter.unit in (known.unit, "E/1.2 mm")
    if parameter.name:
        assert PARAMETERS[parameter.name] is parameter
        at = coordinates([parameter], changed)
        assert asdict(with_coordinates(OWN, [parameter], at)) == approximately(changed)


def test_defaults_are_those_of_a_sensors_file() -> None:
    assert asdict(GelValues()) == approximately(values_of(SensorSpecification()))


def test_the_search_of_effects_stays_where_a_calibration_searches() -> None:
    acted: dict[str, set[str]] = {}
    for name, effect in load_effects().items():
        if effect.gel is None:
            continue
        size = effect.parameters[0]
        for end in (size.low, size.high):
            active = Active(effect, effect.checked({size.name: end}))
            found = gel_with([active], GelTerm(OWN), None).values
            changes = {f for f in GEL_PARAMETERS if getattr(found, f) != getattr(OWN, f)}
            for parameter in (GEL_PARAMETERS[f] for f in changes if f in NUMBERS):
                low, high = parameter.bounds
                assert low <= getattr(found, parameter.field) <= high
                acted.setdefault(parameter.field, set()).add(name)
                if parameter.field == size.name:
                    assert size.unit == parameter.unit
    assert acted == {
        "c20_ratio": {"hyperelastic_stiffening"},
        "poisson_ratio": {"compressibility"},
        "thickness_m": {"thickness_error"},
        "friction": {"coulomb_slip"},
        "bond_slip_share": {"lost_bond"},
    }


def test_the_gap_finders_constants_have_the_units_of_their_coordinates() -> None:
    units: dict[str, Any] = {n.name: n.unit for n in ABSOLUTE if n.name in GEL_CONSTANTS}
    assert units == {"E": "log", "nu": "log(1/2 - nu)", "friction": "log", "c20": "of C10"}
    for name in GEL_CONSTANTS:
        parameter = PARAMETERS[name]
        low, high = parameter.bounds
        ends = [parameter.to_value(parameter.to_coordinate(end)) for end in (low, high)]
        assert np.allclose(ends, (low, high), rtol=1e-12)
