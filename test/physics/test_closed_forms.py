# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The closed forms agree with their energy and with each other."""

from __future__ import annotations

import numpy as np
import pytest
from closed_forms import (
    Coefficients,
    equibiaxial_stress_pa,
    incompressible_uniaxial_stress_pa,
    principal_cauchy_stress,
    simple_shear_stress_pa,
    strain_energy,
    uniaxial,
)

LAWS = {
    "neo_hookean": Coefficients(50e3, bulk_modulus_pa=2e6),
    "mooney_rivlin": Coefficients(35e3, 15e3, bulk_modulus_pa=2e6),
    "yeoh": Coefficients(50e3, 0.0, 4e3, 0.8e3, bulk_modulus_pa=2e6),
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("stretches", [(1.3, 0.9, 0.95), (0.6, 1.2, 1.3)])
def test_stress_is_the_slope_of_the_energy(
    name: str, stretches: tuple[float, float, float]
) -> None:
    law = LAWS[name]
    stress = principal_cauchy_stress(law, stretches)
    volume = np.prod(stretches)
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        slope = (
            strain_energy(law, tuple(stretches + step))
            - strain_energy(law, tuple(stretches - step))
        ) / 2e-6
        assert stress[axis] == pytest.approx(stretches[axis] / volume * slope, rel=1e-6, abs=1e-2)


@pytest.mark.parametrize("name", LAWS)
def test_small_strain_gives_the_elastic_constants(name: str) -> None:
    law = LAWS[name]
    state = uniaxial(law, 1.0 + 1e-6)
    assert state.nominal_stress_pa / 1e-6 == pytest.approx(law.youngs_modulus_pa, rel=1e-4)
    poisson = (1.0 - state.lateral_stretch) / 1e-6
    expected = law.youngs_modulus_pa / (2.0 * law.shear_modulus_pa) - 1.0
    assert poisson == pytest.approx(expected, rel=1e-4)
    assert simple_shear_stress_pa(law, 1e-6) / 1e-6 == pytest.approx(law.shear_modulus_pa)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("stretch", [0.6, 2.0])
def test_stiff_bulk_tends_to_the_incompressible_bar(name: str, stretch: float) -> None:
    law = LAWS[name]
    stiff = Coefficients(law.c10_pa, law.c01_pa, law.c20_pa, law.c30_pa, bulk_modulus_pa=1e10)
    expected = incompressible_uniaxial_stress_pa(law, stretch)
    assert uniaxial(stiff, stretch).nominal_stress_pa == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("name", LAWS)
def test_shear_and_biaxial_stress_do_the_work_that_is_stored(name: str) -> None:
    law = LAWS[name]
    step = 1e-6
    for amount in (0.2, 0.7):
        # Principal stretches of simple shear (Ogden, section 2.2).
        energy = [
            strain_energy(law, (s, 1.0, 1.0 / s))
            for s in (np.exp(np.arcsinh((amount + sign * step) / 2.0)) for sign in (-1, 1))
        ]
        slope = (energy[1] - energy[0]) / (2 * step)
        assert simple_shear_stress_pa(law, amount) == pytest.approx(slope, rel=1e-6)
    for stretch in (0.8, 1.5):
        energy = [strain_energy(law, (s, s, s**-2)) for s in (stretch - step, stretch + step)]
        slope = (energy[1] - energy[0]) / (2 * step)
        assert 2.0 * equibiaxial_stress_pa(law, stretch) == pytest.approx(slope, rel=1e-6)
