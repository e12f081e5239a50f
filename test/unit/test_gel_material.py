# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Materials: what they accept, refuse and say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dotsim_ros.gel.implicit.relaxation import Relaxation
from dotsim_ros.gel.material import (
    MooneyRivlin,
    NeoHookean,
    PronySeries,
    Yeoh,
    bulk_modulus_pa,
    shear_modulus_pa,
    small_strain_moduli_pa,
)

NAN = float("nan")


def test_neo_hookean_has_the_moduli_of_its_parameters() -> None:
    law = NeoHookean(3.0e5, 0.48)
    c10, c01, c20, c30, bulk = law.coefficients_pa()
    assert 2.0 * c10 == pytest.approx(shear_modulus_pa(3.0e5, 0.48))
    assert bulk == pytest.approx(bulk_modulus_pa(3.0e5, 0.48))
    assert (c01, c20, c30) == (0.0, 0.0, 0.0)
    assert small_strain_moduli_pa(law) == pytest.approx((3.0e5, bulk))


@pytest.mark.parametrize(
    ("law", "coefficients"),
    [
        (MooneyRivlin(3e4, 1e4, 1e6), [3e4, 1e4, 0.0, 0.0, 1e6]),
        (Yeoh(3e4, -1e3, 2e2, 1e6), [3e4, 0.0, -1e3, 2e2, 1e6]),
    ],
)
def test_coefficients(law: MooneyRivlin | Yeoh, coefficients: list[float]) -> None:
    assert law.coefficients_pa().tolist() == coefficients
    youngs, bulk = small_strain_moduli_pa(law)
    shear = 2.0 * (coefficients[0] + coefficients[1])
    assert youngs == pytest.approx(9.0 * bulk * shear / (3.0 * bulk + shear))


@pytest.mark.parametrize(
    ("law", "constants", "named"),
    [
        (NeoHookean, (0.0, 0.4), "youngs_modulus_pa"),
        (NeoHookean, (NAN, 0.4), "youngs_modulus_pa"),
        (NeoHookean, (1e5, -0.1), "poisson_ratio"),
        (NeoHookean, (1e5, 0.49995), "poisson_ratio"),
        (MooneyRivlin, (-2e4, 1e4, 1e6), "c10_pa"),
        (MooneyRivlin, (1e4, 1e4, 0.0), "c10_pa"),
        (Yeoh, (0.0, 0.0, 0.0, 1e6), "c10_pa"),
        (Yeoh, (1e4, 0.0, 0.0, -1.0), "c10_pa"),
    ],
)
def test_bad_constants_are_refused(
    law: Callable[..., object], constants: tuple[float, ...], named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        law(*constants)


@pytest.mark.parametrize(
    ("shares", "times"),
    [((0.2,), ()), ((0.5, 0.5), (1.0, 2.0)), ((-0.1,), (1.0,)), ((0.2,), (0.0,)), ((0.2,), (NAN,))],
)
def test_bad_prony_series_is_refused(shares: tuple[float, ...], times: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="Prony"):
        PronySeries(shares, times)


def test_without_a_series_nothing_is_remembered() -> None:
    relaxation = Relaxation(PronySeries())
    fast, history = relaxation.step_terms(0.1, 3)
    relaxation.finish_step(0.1, np.ones((3, 3, 3)))
    assert fast == 1.0
    assert np.all(history == 0.0)
    assert np.all(relaxation.step_terms(0.1, 3)[1] == 0.0)
