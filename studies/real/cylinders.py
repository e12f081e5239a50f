# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cylinders between plates: which law, fitted on one specimen, gives the force of another.

Two ends are held against each other: plates on which the gel slips, where the deformation is
uniform and known in closed form, and plates that it sticks to, solved by CalculiX. The force is
linear in a law's constants where it slips. Where it sticks it is so to first order about a
neo-Hookean gel, since at equilibrium the energy does not depend on a small change of the shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.importers.ecoflex_compression import (
    HEIGHT_M,
    RADIUS_M,
    CompressionTest,
)
from dotsim_ros.gel.material import ElasticLaw, MooneyRivlin, NeoHookean, Yeoh
from dotsim_ros.io.arrays import FloatArray
from studies.reference.compression import Compression, compressed

SHARE = np.linspace(0.10, 0.50, 9)
"""Compressions that are fitted and judged, over the height: below, the plates find their seat."""
LAWS = {"neo_hookean": ("C10",), "mooney_rivlin": ("C10", "C01"), "yeoh": ("C10", "C20", "C30")}
SLIP, STUCK = "slip", "stuck"
FITTED_SPECIMEN = "A"
CHOSEN_ON = (4, 5)
"""Repeats of the fitted specimen on which the law is chosen, fitted on the other ones."""
SAME_ERROR = 0.002
"""Laws whose errors differ by less count as equally good; the one with fewer constants wins."""
TARGET = 0.05
TOLD_APART = 0.01
"""By so much the mean errors of the chosen laws must differ for one end to be named."""
SPACING_M = 2.5e-3
"""At 1.5 mm a stuck cylinder's force is 1.4 % lower at 10 % of compression and 4 % at 30 %."""
BULK_RATIO = 1000.0
"""Of the bulk modulus to C10 in the solves: nu of 0.499."""
PROBES = {"C01": (0.05, 0.1, -0.05), "C20": (0.01, 0.02, -0.01), "C30": (0.003, 0.006, -0.003)}
"""Constants, over C10, whose effect is solved: the first one that CalculiX solves to the end. Where
the side folds onto the plate it fails for some and not for their neighbours."""
SOLVED_C10_PA = 1.0e4
SOLVE_LIMIT_S = 240.0


@dataclass(frozen=True)
class Ends:
    """What a plate does to the gel at its end.

    Attributes:
        name: SLIP or STUCK.
        share: (S,) compressions over the height.
        force_n: (S,) on a gel with that constant of 1 Pa, and nothing else, by constant.
    """

    name: str
    share: FloatArray
    force_n: dict[str, FloatArray]

    def columns(self, law: str) -> FloatArray:
        """Return (S, constants)."""
        return np.stack([self.force_n[constant] for constant in LAWS[law]], axis=1)


def slipping(share: FloatArray = SHARE) -> Ends:
    """Return plates without friction: an incompressible gel is stretched alike everywhere (Ogden,
    "Non-linear elastic deformations", 1984, section 7.2)."""
    stretch = 1.0 - share
    over = stretch**2 + 2.0 / stretch - 3.0
    base = np.pi * RADIUS_M**2 * 2.0 * (stretch**-2 - stretch)
    return Ends(
        SLIP,
        share,
        {"C10": base, "C01": base / stretch, "C20": 2.0 * base * over, "C30": 3.0 * base * over**2},
    )


def sticking() -> Ends:
    """Return plates that hold the gel, as far as CalculiX solves them; minutes.

    Raises:
        CalculixMissingError: it is not installed.
        CalculixError: it solved nothing.
    """

    def force(constant: str, size: float) -> FloatArray:
        print(f"a cylinder that sticks: {constant} {size:g}")
        law = _law(constant, size)
        problem = Compression(RADIUS_M, HEIGHT_M, law, SHARE.tolist(), SPACING_M)
        return compressed(problem, time_limit_s=SOLVE_LIMIT_S).force_n / SOLVED_C10_PA

    base = force("C10", 1.0)
    columns = {"C10": base}
    for constant, sizes in PROBES.items():
        longest = np.zeros(0)
        for size in sizes:
            moved = force(constant, size)
            moved = (moved - base[: len(moved)]) / size if len(moved) <= len(base) else longest
            if len(moved) > len(longest):
                longest = moved
            if len(longest) == len(base):
                break
        columns[constant] = longest
    count = min(map(len, columns.values()))
    return Ends(STUCK, SHARE[:count], {name: column[:count] for name, column in columns.items()})


def _law(constant: str, size: float) -> ElasticLaw:
    """Return a law with a C10 of `SOLVED_C10_PA` and another constant of so many of it."""
    c10, bulk = SOLVED_C10_PA, BULK_RATIO * SOLVED_C10_PA
    other = size * c10
    if constant == "C01":
        return MooneyRivlin(c10, other, bulk)
    if constant == "C20":
        return Yeoh(c10, other, 0.0, bulk)
    if constant == "C30":
        return Yeoh(c10, 0.0, other, bulk)
    # K = E / (3 (1 - 2 nu)) and 2 C10 = E / (2 (1 + nu)).
    modulus = 9.0 * bulk * 2.0 * c10 / (3.0 * bulk + 2.0 * c10)
    return NeoHookean(modulus, 0.5 - modulus / (6.0 * bulk))


@dataclass(frozen=True)
class Fitted:
    """A law fitted to tests.

    Attributes:
        ends: what the plates do.
        law: its name.
        constants_pa: in the order of `LAWS`.
    """

    ends: Ends
    law: str
    constants_pa: FloatArray

    def errors(self, tests: Sequence[CompressionTest]) -> FloatArray:
        """Return (T, S) of the fitted over the measured force, less 1."""
        force = self.ends.columns(self.law) @ self.constants_pa
        return np.stack([force / test.force_at(self.ends.share) - 1.0 for test in tests])


def fitted(ends: Ends, law: str, tests: Sequence[CompressionTest]) -> Fitted:
    """Return the constants with the least sum of squared relative errors over tests."""
    columns = ends.columns(law)
    rows = np.concatenate([columns / test.force_at(ends.share)[:, None] for test in tests])
    constants, *_ = np.linalg.lstsq(rows, np.ones(len(rows)), rcond=None)
    return Fitted(ends, law, constants)


def chosen_law(ends: Ends, tests: Sequence[CompressionTest]) -> tuple[str, dict[str, float]]:
    """Return the law that is chosen on one specimen, and the mean error of each.

    Args:
        ends: what the plates do.
        tests: of the specimen that is fitted on.
    """
    first = [test for test in tests if test.repeat not in CHOSEN_ON]
    last = [test for test in tests if test.repeat in CHOSEN_ON]
    error = {law: float(np.abs(fitted(ends, law, first).errors(last)).mean()) for law in LAWS}
    least = min(error.values())
    return next(law for law in LAWS if error[law] <= least + SAME_ERROR), error
