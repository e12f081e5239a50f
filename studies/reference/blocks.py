# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The blocks that an input file of CalculiX consists of, in mm, N and MPa."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from dotsim_ros.gel.implicit.contact import REFERENCE_SPACING_M
from dotsim_ros.gel.material import ElasticLaw, small_strain_moduli_pa
from dotsim_ros.io.arrays import FloatArray, IntArray
from dotsim_ros.specification import ContactSpecification

MM = 1e3
MEGAPASCAL = 1e-6

NEVER = 1_000_000
"""Printed every so many increments; the last one of a step is printed anyway."""

NEGLIGIBLE = 1e6
"""D2 and D3 over D1: CalculiX divides by them, and needs them positive."""

LINE_ENTRIES = 16
"""That a line holds at most."""


@dataclass(frozen=True)
class StepControl:
    """Increments of a step, as shares of it, and how many at most.

    Attributes:
        first: the first one.
        smallest: a step that needs smaller ones has failed.
        largest: none is larger.
        count: most increments of a step.
    """

    first: float = 0.5
    smallest: float = 1e-3
    largest: float = 1.0
    count: int = 200

    def procedure_lines(self) -> Iterator[str]:
        """Yield that a step is solved as a sequence of equilibria."""
        yield "*STATIC"
        yield f"{self.first}, 1.0, {self.smallest}, {self.largest}"


def node_lines(name: str, first: int, points_m: FloatArray) -> Iterator[str]:
    """Yield a set of nodes at points (N, 3), or (N, 2) of a plane, numbered from the first on."""
    yield f"*NODE, NSET={name}"
    for number, point in enumerate((MM * points_m).tolist(), start=first):
        coordinates = [f"{value:.9e}" for value in point] + ["0.0"] * (3 - len(point))
        yield f"{number}, {', '.join(coordinates)}"


def element_lines(kind: str, name: str, first: int, nodes: IntArray) -> Iterator[str]:
    """Yield a set of elements of a kind with the nodes (E, n), numbered from the first on."""
    yield f"*ELEMENT, TYPE={kind}, ELSET={name}"
    for number, row in enumerate(nodes.tolist(), start=first):
        yield from listed([number, *row], end="")


def set_lines(name: str, numbers: Iterable[int], kind: str = "NSET") -> Iterator[str]:
    """Yield a set of nodes, or of elements (ELSET), by their numbers."""
    yield f"*{kind}, {kind}={name}"
    yield from listed(numbers)


def listed(numbers: Iterable[int], end: str = ",") -> Iterator[str]:
    """Yield numbers in as many lines as they need; all but the last end with a comma."""
    entries = [str(number) for number in numbers]
    for start in range(0, len(entries), LINE_ENTRIES):
        line = ", ".join(entries[start : start + LINE_ENTRIES])
        yield line + ("," if start + LINE_ENTRIES < len(entries) else end)


def surface_lines(name: str, elements: Iterable[int | str], face: str) -> Iterator[str]:
    """Yield a surface of one face of each of some elements or sets of them."""
    yield f"*SURFACE, NAME={name}, TYPE=ELEMENT"
    yield from (f"{element}, {face}" for element in elements)


def matter_lines(name: str, law: Iterable[str], elements: str) -> Iterator[str]:
    """Yield a material of a law, and the set of elements that consists of it."""
    yield f"*MATERIAL, NAME={name}"
    yield from law
    yield f"*SOLID SECTION, ELSET={elements}, MATERIAL={name}"


def rigid_lines(elements: str) -> Iterator[str]:
    """Yield that a set of elements is rigid: all of its nodes are held or moved, so any modulus
    will do."""
    yield from matter_lines("RIGID", ("*ELASTIC", "1.0, 0.3"), elements)


def numbers_line(values: Iterable[float]) -> str:
    """Return values in one line."""
    return ", ".join(f"{value:.9e}" for value in values)


def law_lines(law: ElasticLaw, share: float = 1.0) -> Iterator[str]:
    """Yield the form of a law and its constants, with a share of its moduli.

    Raises:
        ValueError: CalculiX has no form of the law.
    """
    c10, c01, c20, c30, bulk = (MEGAPASCAL * share * law.coefficients_pa()).tolist()
    d1 = 2.0 / bulk
    if c20 or c30:
        if c01:
            raise ValueError("a law with C01 and C20 or C30 has no form in the reference")
        yield "*HYPERELASTIC, YEOH"
        yield numbers_line([c10, c20, c30, d1, NEGLIGIBLE * d1, NEGLIGIBLE * d1])
    elif c01:
        yield "*HYPERELASTIC, MOONEY-RIVLIN"
        yield numbers_line([c10, c01, d1])
    else:
        yield "*HYPERELASTIC, NEO HOOKE"
        yield numbers_line([c10, d1])


def contact_lines(law: ElasticLaw, contact: ContactSpecification) -> Iterator[str]:
    """Yield the contact of the surfaces SKIN_FACES and INDENTER_FACES."""
    youngs_modulus, _ = small_strain_moduli_pa(law)
    stiffness = contact.stiffness * MEGAPASCAL * youngs_modulus / (MM * REFERENCE_SPACING_M)
    yield "*SURFACE INTERACTION, NAME=TOUCH"
    yield "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"
    yield f"{stiffness:.9e}"
    if contact.friction_coefficient > 0.0:
        yield "*FRICTION"
        yield numbers_line([contact.friction_coefficient, contact.tangential_ratio * stiffness])
    yield "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE"
    yield "SKIN_FACES, INDENTER_FACES"


def step_lines(
    increments: int,
    procedure: Iterable[str],
    moved: Iterable[str],
    printed: Mapping[str, str],
    *,
    when: str = f"FREQUENCY={NEVER}",
) -> Iterator[str]:
    """Yield a step.

    Args:
        increments: at most.
        procedure: how it is solved.
        moved: what is moved by then.
        printed: at its end, of sets of nodes by their names: U or RF.
        when: they are printed earlier too.
    """
    yield f"*STEP, NLGEOM, INC={increments}"
    yield from procedure
    yield "*BOUNDARY"
    yield from moved
    for name, quantity in printed.items():
        yield f"*NODE PRINT, NSET={name}, {when}"
        yield quantity
    yield "*END STEP"
