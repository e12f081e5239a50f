# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How the refinement's added compliance varies with Poisson's ratio, for derivatives by it."""

from __future__ import annotations

from collections.abc import Callable

from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.implicit.refinement import Refinement, refine
from dotsim_ros.gel.implicit.tangent import inverse_at_rest
from dotsim_ros.gel.material import NeoHookean, small_strain_moduli_pa

POISSON_STEP = 0.05
"""Step of the difference, in units of 1/2 - nu: compliance is smooth in the latter's logarithm."""


def poisson_rate(
    gel: ImplicitGel, *, progress: Callable[[float], None] | None = None
) -> Refinement:
    """Return the derivative of the gel's refinement by Poisson's ratio at constant E, as one.

    It is the difference of two refinements, each computed as long as the gel's own, and cached.

    Args:
        gel: a refined one.
        progress: called with the finished share of each of the two.

    Raises:
        ValueError: the gel has no refinement, or a ratio too close to 1/2 to be raised.
    """
    if gel.refinement is None:
        raise ValueError("the gel has no refinement, expected solver.refined to be true")
    youngs, bulk = small_strain_moduli_pa(gel.material.law)
    poisson = 0.5 - youngs / (6.0 * bulk)
    step = POISSON_STEP * (0.5 - poisson)
    upper, lower = (
        _refinement(gel, NeoHookean(youngs, poisson + sign * step), progress)
        for sign in (1.0, -1.0)
    )
    difference = (upper.block - lower.block) / (2.0 * step)
    return Refinement(upper.skin_weight, upper.indptr, upper.index, difference)


def _refinement(
    gel: ImplicitGel, law: NeoHookean, progress: Callable[[float], None] | None
) -> Refinement:
    coarse = gel.discretization
    body = ElasticBody(coarse, law, dtype=gel._single.dtype)
    return refine(
        gel.shape,
        gel.skin.rest_position_m,
        coarse,
        lambda: inverse_at_rest(body),
        law,
        progress=progress,
    )
