# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The bond between gel and core where it holds less than a sound one: the gel slides on the core.

A sound bond is a stiff spring per area (`elasticity.BOND_STIFFNESS`). Here it gives way along the
core's surface, by the share of the sliding that a layer of the gel would otherwise take up in
shear; across the surface it holds as before. A gel that has come off a closed core does not open:
the pressure of the air, 100 kPa, presses it on, against the some 10 kPa of a touch. What is not in
this: friction on the core, and a gap that air has entered.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from dotsim_ros.gel.body import Body
from dotsim_ros.gel.discretization import Discretization, bonded_points, interpolation_at
from dotsim_ros.gel.elasticity import BOND_STIFFNESS
from dotsim_ros.gel.material import ElasticLaw, shear_modulus_pa, small_strain_moduli_pa
from dotsim_ros.io.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class LooseBond:
    """Where the gel slides on its core, and how easily.

    Attributes:
        slip_share: of the sliding between skin and core under a uniform shear, what the bond lets
            through; 0 is bonded, 1 slides freely.
        x_rad, y_rad: of the middle of the loose patch, an angle from the z axis towards x and
            towards y.
        radius_rad: of the patch, seen from the core's centre; pi is all of the core.
    """

    slip_share: float
    x_rad: float = 0.0
    y_rad: float = 0.0
    radius_rad: float = float(np.pi)

    def holds(self, direction: FloatArray) -> BoolArray:
        """Return for unit vectors (B, 3) from the core's centre whether the bond there is sound."""
        angle = float(np.hypot(self.x_rad, self.y_rad))
        scale = np.sinc(angle / np.pi)
        middle = np.array([self.x_rad * scale, self.y_rad * scale, np.cos(angle)])
        away: FloatArray = np.arccos(np.clip(direction @ middle, -1.0, 1.0))
        return np.asarray(away > self.radius_rad)


def lost_stiffness(
    body: Body, discretization: Discretization, bond: LooseBond, law: ElasticLaw
) -> sparse.csr_matrix:
    """Return the stiffness (3 N, 3 N), N/m, that a loose bond takes from the sound one; negative
    semidefinite, unknown 3 n + i is node n's displacement along axis i.

    Args:
        body: the gel's shape.
        discretization: its grid.
        bond: the loose one.
        law: of the gel.
    """
    points, area = bonded_points(body, discretization.spacing_m)
    direction = points / np.linalg.norm(points, axis=1)[:, None]
    loose = ~bond.holds(direction)
    points, area, direction = points[loose], area[loose], direction[loose]
    n = discretization.node_count
    if bond.slip_share == 0.0 or len(points) == 0:
        return sparse.csr_matrix((3 * n, 3 * n))
    # Two springs, one behind the other: the sound bond, and what lets slip through.
    youngs, bulk = small_strain_moduli_pa(law)
    sound = BOND_STIFFNESS * youngs / discretization.spacing_m
    thickness_m = float(body.bounds_m()[1, 2] - np.linalg.norm(points[0]))
    layer = shear_modulus_pa(youngs, 0.5 - youngs / (6.0 * bulk)) / thickness_m
    given_way = bond.slip_share * sound
    lost = sound * given_way / ((1.0 - bond.slip_share) * layer + given_way)
    weight = interpolation_at(discretization, points)[0].matrix(n)
    along = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    blocks = [
        [weight.T @ sparse.diags(-lost * area * along[:, i, j]) @ weight for j in range(3)]
        for i in range(3)
    ]
    by_axis = sparse.bmat(blocks, format="csr")
    order = np.arange(3 * n).reshape(3, n).T.ravel()
    return by_axis[order][:, order].tocsr()
