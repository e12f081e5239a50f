# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Constitutive laws of the gel, behind one set of coefficients.

Every law here is a special case of the strain energy per rest volume

    psi(F) = C10 (I1b - 3) + C01 (I2b - 3) + C20 (I1b - 3)^2 + C30 (I1b - 3)^3 + K/2 (J - 1)^2

with J = det F, I1b = J^(-2/3) tr(F^T F), I2b = J^(-4/3) I2(F^T F) (Bonet and Wood, "Nonlinear
Continuum Mechanics for Finite Element Analysis", 2008, chapter 6; Yeoh 1993; Mooney 1940). At small
strain mu = 2 (C10 + C01). A Prony series lets the part of psi without K relax in time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.specification import MaterialSpecification


class ElasticLaw(Protocol):
    """A law that can be written with the coefficients C10, C01, C20, C30 and K."""

    def coefficients_pa(self) -> NDArray[np.float64]:
        """Return (5,) C10, C01, C20, C30, K."""


def shear_modulus_pa(youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Return mu = E / (2 (1 + nu))."""
    return youngs_modulus_pa / (2.0 * (1.0 + poisson_ratio))


def bulk_modulus_pa(youngs_modulus_pa: float, poisson_ratio: float) -> float:
    """Return K = E / (3 (1 - 2 nu))."""
    return youngs_modulus_pa / (3.0 * (1.0 - 2.0 * poisson_ratio))


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass(frozen=True)
class NeoHookean:
    """The paper's two parameters, theta = (E, nu).

    Attributes:
        youngs_modulus_pa: E > 0.
        poisson_ratio: nu in [0, 0.4999].
    """

    youngs_modulus_pa: float
    poisson_ratio: float

    def __post_init__(self) -> None:
        _require(
            self.youngs_modulus_pa > 0.0,
            f"youngs_modulus_pa is {self.youngs_modulus_pa}, expected a positive number of pascals",
        )
        _require(
            0.0 <= self.poisson_ratio <= 0.4999,
            f"poisson_ratio is {self.poisson_ratio}, expected 0 to 0.4999",
        )

    def coefficients_pa(self) -> NDArray[np.float64]:
        mu = shear_modulus_pa(self.youngs_modulus_pa, self.poisson_ratio)
        bulk = bulk_modulus_pa(self.youngs_modulus_pa, self.poisson_ratio)
        return np.array([0.5 * mu, 0.0, 0.0, 0.0, bulk])


@dataclass(frozen=True)
class MooneyRivlin:
    """Two invariants: C10, C01 (Pa) and the bulk modulus K (Pa)."""

    c10_pa: float
    c01_pa: float
    bulk_modulus_pa: float

    def __post_init__(self) -> None:
        _require(
            self.c10_pa + self.c01_pa > 0.0 and self.bulk_modulus_pa > 0.0,
            f"c10_pa + c01_pa is {self.c10_pa + self.c01_pa} and bulk_modulus_pa is "
            f"{self.bulk_modulus_pa}, expected both positive",
        )

    def coefficients_pa(self) -> NDArray[np.float64]:
        return np.array([self.c10_pa, self.c01_pa, 0.0, 0.0, self.bulk_modulus_pa])


@dataclass(frozen=True)
class Yeoh:
    """A cubic in the first invariant: C10, C20, C30 (Pa) and the bulk modulus K (Pa)."""

    c10_pa: float
    c20_pa: float
    c30_pa: float
    bulk_modulus_pa: float

    def __post_init__(self) -> None:
        _require(
            self.c10_pa > 0.0 and self.bulk_modulus_pa > 0.0,
            f"c10_pa is {self.c10_pa} and bulk_modulus_pa is {self.bulk_modulus_pa}, expected "
            "both positive",
        )

    def coefficients_pa(self) -> NDArray[np.float64]:
        return np.array([self.c10_pa, 0.0, self.c20_pa, self.c30_pa, self.bulk_modulus_pa])


@dataclass(frozen=True)
class PronySeries:
    """Relaxation of the shape-changing stress: G(t) / G(0) = 1 - sum g_k (1 - exp(-t / tau_k)).

    The elastic coefficients are those of the fast (unrelaxed) response.

    Attributes:
        shares: g_k, each positive, together below 1.
        times_s: tau_k > 0.
    """

    shares: tuple[float, ...] = ()
    times_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        _require(
            len(self.shares) == len(self.times_s),
            f"{len(self.shares)} Prony shares but {len(self.times_s)} times, expected as many",
        )
        _require(
            all(g > 0.0 for g in self.shares) and sum(self.shares) < 1.0,
            f"Prony shares are {self.shares}, expected positive numbers that sum below 1",
        )
        _require(
            all(tau > 0.0 for tau in self.times_s),
            f"Prony times are {self.times_s} s, expected positive numbers",
        )


@dataclass(frozen=True)
class Material:
    """A law, its relaxation, and the density (kg/m^3)."""

    law: ElasticLaw
    prony: PronySeries = PronySeries()
    density_kg_m3: float = 1070.0


def law_of(specification: MaterialSpecification) -> ElasticLaw:
    """Return the elastic law.

    Raises:
        ValueError: a constant is out of range.
    """
    s = specification
    if s.law == "mooney_rivlin":
        return MooneyRivlin(s.c10_pa, s.c01_pa, s.bulk_modulus_pa)
    if s.law == "yeoh":
        return Yeoh(s.c10_pa, s.c20_pa, s.c30_pa, s.bulk_modulus_pa)
    return NeoHookean(s.youngs_modulus_pa, s.poisson_ratio)


def material_of(specification: MaterialSpecification) -> Material:
    """Return the law with its relaxation and density."""
    s = specification
    prony = PronySeries(s.prony_shares, s.prony_times_s)
    return Material(law_of(s), prony, s.density_kg_m3)


def small_strain_moduli_pa(law: ElasticLaw) -> tuple[float, float]:
    """Return Young's modulus and bulk modulus of a law at small strain."""
    c10, c01, _, _, bulk = law.coefficients_pa()
    mu = 2.0 * (c10 + c01)
    return 9.0 * bulk * mu / (3.0 * bulk + mu), bulk
