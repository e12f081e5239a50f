# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The compliance of the whole gel at rest, kept on disk.

To invert the stiffness takes longer than all else that a sensor needs at its start, to read the
inverse a tenth of that. It scales as 1/E.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dotsim_ros.gel.body import Body
from dotsim_ros.gel.discretization import Discretization
from dotsim_ros.gel.elasticity import GHOST_PENALTY, ElasticBody
from dotsim_ros.gel.implicit.tangent import inverse_at_rest
from dotsim_ros.gel.material import ElasticLaw, NeoHookean, small_strain_moduli_pa
from dotsim_ros.io.arrays import Float32Array, FloatArray
from dotsim_ros.io.cache import GEL, content_key, keep_table, load_arrays
from dotsim_ros.io.documents import ArrayForm
from dotsim_ros.io.files import cache_directory


def kept_compliance(
    shape: Body, skin_position_m: FloatArray, grid: Discretization, law: ElasticLaw
) -> Float32Array:
    """Return the (3 N, 3 N) inverse of a bonded gel's stiffness at rest, m/N, from the cache if it
    is there.

    Args:
        shape: the gel's.
        skin_position_m: (V, 3) rest positions of the markers, which the grid must hold.
        grid: of the gel.
        law: its material; only its Poisson's ratio matters for the cache.
    """
    form = ArrayForm((3 * grid.node_count,) * 2)
    return kept_inverse("rest", form, inverse_at_rest, shape, skin_position_m, grid, law)


def kept_inverse(
    name: str,
    form: ArrayForm,
    invert: Callable[[ElasticBody], Float32Array],
    shape: Body,
    skin_position_m: FloatArray,
    grid: Discretization,
    law: ElasticLaw,
) -> Float32Array:
    """Return an inverse of the stiffness at rest that scales as 1/E, from the cache if it is there.

    Args:
        name: of the table, before its key.
        form: of the inverse.
        invert: computes it for a body of 1 Pa.
        shape, skin_position_m, grid, law: as for `kept_compliance`.
    """
    youngs, bulk = small_strain_moduli_pa(law)
    key = content_key(
        GEL, shape, grid.spacing_m, round(bulk / youngs, 9), GHOST_PENALTY, skin_position_m
    )
    path = cache_directory() / f"{name}-{key}.npz"
    stored = load_arrays(path, {"compliance": form})
    if stored is None:
        # At 1 Pa, so that its last digits do not depend on which modulus asked for it first.
        unit = ElasticBody(grid, NeoHookean(1.0, 0.5 - youngs / (6.0 * bulk)), dtype=np.float32)
        stored = {"compliance": invert(unit)}
        keep_table(path, stored)
    compliance = np.asarray(stored["compliance"], dtype=np.float32)
    return np.divide(compliance, np.float32(youngs), out=compliance)
