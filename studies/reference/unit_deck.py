# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The input file of CalculiX for a dome in which something is wrong: relaxation, stiffening by
another law, parts that are stiffer, a core that the gel slides on, a base that gives way.

CalculiX has no Prony series (its 2.20 knows *CREEP, but no *VISCOELASTIC). A generalized Maxwell
solid is solved instead, branch by branch: each is a second set of elements on the gel's own nodes,
elastic and creeping by Norton's law of first power, at finite strain (Simo and Hughes,
"Computational inelasticity", 1998, chapter 9), next to the hyperelastic gel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from dotsim_ros.gel.material import small_strain_moduli_pa
from dotsim_ros.io.arrays import IntArray
from studies.reference import blocks
from studies.reference.blocks import MEGAPASCAL, MM, NEGLIGIBLE
from studies.reference.deck import Deck

LARGEST_CREEP_CHANGE = 1.0
"""CETOL: so much that it never sets an increment."""
CREEP_INCREMENT_S = 0.15
"""Longest increment of a gel that relaxes: a quarter of the fast branch's time."""


@dataclass(frozen=True)
class MaxwellBranch:
    """A spring and a dashpot in series; the dashpot flows by shape alone.

    Attributes:
        share: of the gel's fast moduli that it carries.
        time_s: in which its stress falls by e.

    Raises:
        ValueError: a share or a time out of range.
    """

    share: float
    time_s: float

    def __post_init__(self) -> None:
        if not (0.0 < self.share < 1.0 and self.time_s > 0.0):
            raise ValueError(
                f"a branch of the share {self.share} and {self.time_s} s, expected a share "
                "between 0 and 1 and a positive time"
            )


@dataclass(frozen=True)
class OgdenStiffening:
    """A share of the shear modulus that stiffens as powers of the stretches do.

    The law is Ogden's with the exponents 2, a and -a (Ogden, "Large deformation isotropic
    elasticity", 1972). The last two have parts of the share, 1/2 + 1/a and 1/2 - 1/a, with which
    the energy of an incompressible gel is to fourth order in the logarithmic strain that of
    Yeoh's with C20 / C10 = share (a^2 - 4) / 48.

    Attributes:
        share: of the shear modulus.
        exponent: a, above 2.
    """

    share: float
    exponent: float = 6.0

    @classmethod
    def like(cls, c20_ratio: float) -> OgdenStiffening:
        """Return the law that is to fourth order Yeoh's with a C20 of so many C10."""
        return cls(48.0 * c20_ratio / (cls.exponent**2 - 4.0))

    def __post_init__(self) -> None:
        if not (0.0 < self.share < 1.0 and self.exponent > 2.0):
            raise ValueError(
                f"a stiffening share of {self.share} with the exponent {self.exponent}, expected "
                "a share between 0 and 1 and an exponent above 2"
            )

    def lines(self, shear_pa: float, bulk_pa: float) -> Iterator[str]:
        """Yield the law of a gel with these small-strain moduli, in the form of CalculiX."""
        mu, d1 = MEGAPASCAL * shear_pa, 2.0 / (MEGAPASCAL * bulk_pa)
        up, down = (self.share * mu * (0.5 + sign / self.exponent) for sign in (1.0, -1.0))
        constants = [(1.0 - self.share) * mu, 2.0, up, self.exponent, down, -self.exponent]
        constants += [d1, NEGLIGIBLE * d1, NEGLIGIBLE * d1]
        yield "*HYPERELASTIC, OGDEN, N=3"
        # A line holds eight constants.
        for part in (constants[:8], constants[8:]):
            yield blocks.numbers_line(part)


@dataclass(frozen=True)
class StiffPart:
    """Elements of another stiffness.

    Attributes:
        element: (E,) their numbers, from 0.
        ratio: of their moduli to the gel's.
    """

    element: IntArray
    ratio: float


@dataclass(frozen=True)
class UnitDeck(Deck):
    """What a run computes, in a gel in which something may be wrong.

    Attributes:
        duration_s: of each step; what creeps needs it.
        branches: what relaxes; `law` is that of the fast response.
        stiffening: in place of the law's own shape, of its small-strain moduli.
        stiff: a part of another stiffness.
        slipping: (S,) nodes, bonded in the mesh, that slide along the core and do not leave it.
        base_compliance_m_n: what core and base plane together give way by, along the force.

    Raises:
        ValueError: another number of durations than steps, shares of branches that leave nothing,
            or parts that cannot be solved together.
    """

    duration_s: tuple[float, ...] = ()
    branches: tuple[MaxwellBranch, ...] = ()
    stiffening: OgdenStiffening | None = None
    stiff: StiffPart | None = None
    slipping: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    base_compliance_m_n: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.duration_s) != len(self.controls) or min(self.duration_s) <= 0.0:
            raise ValueError(
                f"step durations are {self.duration_s} s, expected a positive one for each of "
                f"{len(self.controls)} steps"
            )
        if self.slow_share <= 0.0:
            raise ValueError("the branches carry all of the gel, expected shares below 1 in all")
        if len(self.slipping) and self.base_compliance_m_n > 0.0:
            raise ValueError("a gel that slips on a base that gives way is not solved together")
        if self.stiff is not None and self.branches:
            raise ValueError("a stiff part of a gel that relaxes is not solved together")

    @property
    def slow_share(self) -> float:
        """What of the moduli is left when all branches have relaxed."""
        return 1.0 - sum(branch.share for branch in self.branches)

    def matter_lines(self) -> Iterator[str]:
        """Yield what the gel consists of."""
        young_pa, bulk_pa = small_strain_moduli_pa(self.law)
        poisson = 0.5 - young_pa / (6.0 * bulk_pa)
        yield from blocks.matter_lines("SILICONE", self._gel_lines(self.slow_share), "GEL")
        count = len(self.gel.element) + len(self.surface.triangles)
        for number, branch in enumerate(self.branches, start=1):
            name, e = f"BRANCH{number}", MEGAPASCAL * young_pa * branch.share
            yield from blocks.element_lines("C3D20R", name, count + 1, self.gel.element + 1)
            count += len(self.gel.element)
            # The strain rate is A times the von Mises stress: 1 / time is 3 A times the modulus.
            rate = 2.0 * (1.0 + poisson) / (3.0 * e * branch.time_s)
            elastic = ("*ELASTIC", blocks.numbers_line([e, poisson]))
            creep = ("*CREEP, LAW=NORTON", f"{rate:.9e}, 1.0, 0.0")
            yield from blocks.matter_lines(f"OF_{name}", (*elastic, *creep), name)
        if self.stiff is not None:
            # Its section takes the place of the one before.
            yield from blocks.set_lines("STIFF", self.stiff.element + 1, "ELSET")
            yield from blocks.matter_lines("STIFF", self._gel_lines(self.stiff.ratio), "STIFF")

    def _gel_lines(self, share: float) -> Iterator[str]:
        if self.stiffening is None:
            yield from blocks.law_lines(self.law, share)
            return
        c10, c01, _, _, bulk = self.law.coefficients_pa().tolist()
        yield from self.stiffening.lines(2.0 * share * (c10 + c01), share * bulk)

    def support_lines(self) -> Iterator[str]:
        """Yield what holds the gel."""
        slips = set(self.slipping.tolist())
        held = [node for node in self.gel.bonded.tolist() if node not in slips]
        yield from blocks.set_lines("HELD", [node + 1 for node in held])
        if len(self.slipping):
            yield "*EQUATION"
            for node in self.slipping.tolist():
                yield from self._along_core(node)
        if self.base_compliance_m_n == 0.0:
            yield "*BOUNDARY"
            yield "HELD, 1, 3"
            return
        base = self.gel_node_count + 2 * len(self.surface.vertices_m) + 1
        springs = len(self.gel.element) * (1 + len(self.branches)) + len(self.surface.triangles)
        yield from blocks.node_lines("BASE", base, np.zeros((1, 3)))
        for axis in (1, 2, 3):
            yield f"*ELEMENT, TYPE=SPRING1, ELSET=SPRING{axis}"
            yield f"{springs + axis}, {base}"
            yield f"*SPRING, ELSET=SPRING{axis}"
            yield f"{axis}"
            yield f"{1.0 / (MM * self.base_compliance_m_n):.9e}"
        yield "*EQUATION"
        for node in held:
            for axis in (1, 2, 3):
                yield "2"
                yield f"{node + 1}, {axis}, 1.0, {base}, {axis}, -1.0"

    def _along_core(self, node: int) -> Iterator[str]:
        """Yield that a node on the core moves along it, to first order."""
        normal = self.gel.node_m[node] / np.linalg.norm(self.gel.node_m[node])
        # The first term is eliminated, so it must not vanish; terms of nothing are left out.
        order = [axis for axis in np.argsort(-np.abs(normal)).tolist() if abs(normal[axis]) > 1e-6]
        yield str(len(order))
        yield ", ".join(f"{node + 1}, {axis + 1}, {normal[axis]:.9e}" for axis in order)

    def procedure_lines(self, index: int) -> Iterator[str]:
        """Yield how the step of an index, from 0, is solved."""
        if not self.branches:
            yield from super().procedure_lines(index)
            return
        c, duration = self.controls[index], self.duration_s[index]
        yield f"*VISCO, CETOL={LARGEST_CREEP_CHANGE}"
        longest = min(1.0, CREEP_INCREMENT_S / duration)
        increments = (min(c.first, longest), 1.0, c.smallest, min(c.largest, longest))
        yield blocks.numbers_line(share * duration for share in increments)
