# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of a loss by what a step of the gel returns, and by what the gel is made from."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from dotsim_ros.gel.material import ElasticLaw
from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class LossGradient:
    """Derivatives of a loss by what a step returned, in units of the loss per SI unit.

    Attributes:
        skin: (V, 3) by `skin_position_m`; None for zero.
        force, torque: (3,) by the wrench on the indenter.
    """

    skin: FloatArray | None = None
    force: FloatArray = field(default_factory=lambda: np.zeros(3))
    torque: FloatArray = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Gradient:
    """Derivatives of a loss by the gel's parameters, in units of the loss per SI unit.

    Attributes:
        coefficients: (5,) by C10, C01, C20, C30, K. What the gel scales with Young's modulus at
            small strain follows: the contact's stiffness, the bond, the ghost penalty and the
            refinement.
        prony_shares, prony_times_s: (K,) by the Prony series.
        density_kg_m3: by the density; zero without inertia.
        friction_coefficient, contact_stiffness, tangential_ratio: by `ContactSpecification`.
        indenter_parameters: (n,) by `Indenter.parameters`.
        indenter_twist: (6,) by a translation (m) and a rotation (rad) about the base's origin, both
            along the axes of the base, that the poses of all steps have in common.
        indenter_offset: (6,) the same along the indenter's axes and about its origin.
        substep_twist: (S, 6) `indenter_twist` of each recorded substep alone.
        geometry: by the gel's lengths (`reshape.shape_rates`); the skin moves with them, and so do
            its rest positions, by which the loss has further derivatives of its own.
    """

    coefficients: FloatArray
    prony_shares: FloatArray
    prony_times_s: FloatArray
    density_kg_m3: float
    friction_coefficient: float
    contact_stiffness: float
    tangential_ratio: float
    indenter_parameters: FloatArray
    indenter_twist: FloatArray
    indenter_offset: FloatArray
    substep_twist: FloatArray
    geometry: dict[str, float]

    def by_law(self, law: ElasticLaw) -> dict[str, float]:
        """Return the derivatives by a law's own parameters, such as Young's modulus and nu.

        Raises:
            TypeError: the law is no dataclass of numbers.
        """
        if not dataclasses.is_dataclass(law) or isinstance(law, type):
            raise TypeError(f"{type(law).__name__} is no dataclass, expected one of numbers")
        result = {}
        for name, value in dataclasses.asdict(law).items():
            # Laws are smooth and cheap: a five-point difference is exact to rounding.
            step = 1.0e-3 * (abs(value) or 1.0)
            if name == "poisson_ratio":
                step = 1.0e-3 * (0.5 - value)
            result[name] = self.along(
                lambda moved, name=name: dataclasses.replace(law, **{name: moved}), value, step
            )
        return result

    def along(self, law_at: Callable[[float], ElasticLaw], value: float, step: float) -> float:
        """Return the derivative by what a law is made from, at a value, by a five-point
        difference."""
        slope = np.zeros(5)
        for shift, weight in ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0)):
            slope += weight * law_at(value + shift * step).coefficients_pa()
        return float(self.coefficients @ slope) / (12.0 * step)
