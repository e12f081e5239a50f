# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Closed forms of homogeneous deformations, to compare a gel with.

The strain energy per rest volume is, with I1b = J^(-2/3) I1 and I2b = J^(-4/3) I2 of the right
Cauchy-Green tensor,

    psi = C10 (I1b - 3) + C01 (I2b - 3) + C20 (I1b - 3)^2 + C30 (I1b - 3)^3 + K/2 (J - 1)^2

(Ogden, "Non-Linear Elastic Deformations", 1997, sections 4.3 and 7.2; Bonet and Wood, "Nonlinear
Continuum Mechanics for Finite Element Analysis", 2008, chapter 6). Everything here is written in
principal stretches or in the shear angle, independently of how a simulation differentiates psi.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq


@dataclass(frozen=True)
class Coefficients:
    """Constants of psi, pascals; neo-Hookean, Mooney-Rivlin and Yeoh set the others to zero."""

    c10_pa: float
    c01_pa: float = 0.0
    c20_pa: float = 0.0
    c30_pa: float = 0.0
    bulk_modulus_pa: float = 1.0e9

    @property
    def shear_modulus_pa(self) -> float:
        return 2.0 * (self.c10_pa + self.c01_pa)

    @property
    def youngs_modulus_pa(self) -> float:
        mu, bulk = self.shear_modulus_pa, self.bulk_modulus_pa
        return 9.0 * bulk * mu / (3.0 * bulk + mu)


@dataclass(frozen=True)
class UniaxialState:
    """A bar pulled along one axis, free on its sides.

    Attributes:
        lateral_stretch: of both other axes.
        nominal_stress_pa: force per rest area along the axis.
    """

    lateral_stretch: float
    nominal_stress_pa: float


def strain_energy(coefficients: Coefficients, stretches: tuple[float, float, float]) -> float:
    """Return psi (J/m^3) at three principal stretches."""
    squared = np.square(stretches)
    volume = float(np.prod(stretches))
    first = volume ** (-2.0 / 3.0) * squared.sum() - 3.0
    products = squared[0] * squared[1] + squared[1] * squared[2] + squared[2] * squared[0]
    second = volume ** (-4.0 / 3.0) * products - 3.0
    c = coefficients
    return float(
        c.c10_pa * first
        + c.c01_pa * second
        + c.c20_pa * first**2
        + c.c30_pa * first**3
        + 0.5 * c.bulk_modulus_pa * (volume - 1.0) ** 2
    )


def principal_cauchy_stress(
    coefficients: Coefficients, stretches: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the three principal Cauchy stresses (Pa): lambda_i / J dpsi/dlambda_i."""
    squared = np.square(stretches)
    volume = float(np.prod(stretches))
    first = volume ** (-2.0 / 3.0) * squared
    inverse = volume ** (2.0 / 3.0) / squared
    strain = first.sum() - 3.0
    c = coefficients
    slope = c.c10_pa + 2.0 * c.c20_pa * strain + 3.0 * c.c30_pa * strain**2
    # With J^(-1/3) lambda_i as variables, I2b is the sum of the inverse squares.
    shape = 2.0 * slope * (first - first.mean()) - 2.0 * c.c01_pa * (inverse - inverse.mean())
    stress = shape / volume + c.bulk_modulus_pa * (volume - 1.0)
    return float(stress[0]), float(stress[1]), float(stress[2])


def uniaxial(coefficients: Coefficients, stretch: float) -> UniaxialState:
    """Return the state of a bar at an axial stretch; the sides find their stress-free width."""

    def side_stress(lateral: float) -> float:
        return principal_cauchy_stress(coefficients, (stretch, lateral, lateral))[1]

    incompressible = stretch**-0.5
    lateral = float(brentq(side_stress, 0.5 * incompressible, 2.0 * incompressible, xtol=1e-15))
    axial = principal_cauchy_stress(coefficients, (stretch, lateral, lateral))[0]
    return UniaxialState(lateral, axial * lateral**2)


def incompressible_uniaxial_stress_pa(coefficients: Coefficients, stretch: float) -> float:
    """Return force per rest area (Pa) of an incompressible bar.

    2 (lambda - lambda^-2) (dpsi/dI1 + dpsi/dI2 / lambda), the textbook's formula.
    """
    strain = stretch**2 + 2.0 / stretch - 3.0
    c = coefficients
    slope = c.c10_pa + 2.0 * c.c20_pa * strain + 3.0 * c.c30_pa * strain**2
    return 2.0 * (stretch - stretch**-2) * (slope + c.c01_pa / stretch)


def simple_shear_stress_pa(coefficients: Coefficients, amount: float) -> float:
    """Return the shear stress (Pa) of simple shear x + amount y; J = 1, so K plays no part.

    2 amount (dpsi/dI1 + dpsi/dI2), with I1 = I2 = 3 + amount^2; Cauchy and nominal stress agree.
    """
    strain = amount**2
    c = coefficients
    slope = c.c10_pa + 2.0 * c.c20_pa * strain + 3.0 * c.c30_pa * strain**2
    return 2.0 * amount * (slope + c.c01_pa)


def simple_shear_normal_stress_difference_pa(coefficients: Coefficients, amount: float) -> float:
    """Return sigma_xx - sigma_yy (Pa) of simple shear: amount times the shear stress
    (Rivlin's universal relation)."""
    return amount * simple_shear_stress_pa(coefficients, amount)


def equibiaxial_stress_pa(coefficients: Coefficients, stretch: float) -> float:
    """Return force per rest area (Pa) of an incompressible sheet stretched along both axes.

    2 (lambda - lambda^-5) (dpsi/dI1 + lambda^2 dpsi/dI2).
    """
    strain = 2.0 * stretch**2 + stretch**-4 - 3.0
    c = coefficients
    slope = c.c10_pa + 2.0 * c.c20_pa * strain + 3.0 * c.c30_pa * strain**2
    return 2.0 * (stretch - stretch**-5) * (slope + stretch**2 * c.c01_pa)


def pressure_pa(coefficients: Coefficients, volume_ratio: float) -> float:
    """Return the mean Cauchy stress (Pa), positive in tension: K (J - 1) for every law."""
    return coefficients.bulk_modulus_pa * (volume_ratio - 1.0)


def hertz_force_n(
    radius_m: float, youngs_modulus_pa: float, poisson_ratio: float, depth_m: float
) -> float:
    """Return the force (N) of a rigid sphere on an elastic half space (Hertz 1882; Johnson,
    "Contact Mechanics", 1985, section 4.2): 4/3 E / (1 - nu^2) sqrt(R) d^(3/2)."""
    modulus = youngs_modulus_pa / (1.0 - poisson_ratio**2)
    return 4.0 / 3.0 * modulus * np.sqrt(radius_m) * depth_m**1.5


def flat_punch_force_n(
    radius_m: float, youngs_modulus_pa: float, poisson_ratio: float, depth_m: float
) -> float:
    """Return the force (N) of a rigid, frictionless, flat cylinder on an elastic half space
    (Boussinesq 1885; Johnson, section 3.8): 2 E / (1 - nu^2) a d."""
    return 2.0 * youngs_modulus_pa / (1.0 - poisson_ratio**2) * radius_m * depth_m


def bonded_layer_factor(poisson_ratio: float, confinement: float) -> float:
    """Return by how much a bonded layer of finite thickness is stiffer than Hertz's half space.

    Dimitriadis et al., "Determination of elastic moduli of thin layers of soft material using the
    atomic force microscope", 2002, equations 11 and 12; confinement is sqrt(R d) / thickness.
    """
    nu, x = poisson_ratio, confinement
    alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1.0 - nu)
    beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1.0 - nu)
    return float(
        1.0
        - 2.0 * alpha / np.pi * x
        + 4.0 * alpha**2 / np.pi**2 * x**2
        - 8.0 / np.pi**3 * (alpha**3 + 4.0 * np.pi**2 / 15.0 * beta) * x**3
        + 16.0 * alpha / np.pi**4 * (alpha**3 + 3.0 * np.pi**2 / 5.0 * beta) * x**4
    )
