# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A cylinder between two plates that it sticks to, as a problem of two dimensions in CalculiX.

The upper half is solved, which the plane in the middle mirrors. Where it bulges, its side folds
onto the plate, which reaches beyond the cylinder; what has folded slides on it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dotsim_ros.gel.material import ElasticLaw, small_strain_moduli_pa
from dotsim_ros.io.arrays import FloatArray
from studies.reference.axisymmetric import WEDGE_COUNT, section_of
from studies.reference.deck import MEGAPASCAL, MM, NEVER, StepControl, hyperelastic_lines
from studies.reference.mesh import halved_marks
from studies.reference.run import JOB, execute, failure_of, read_tables

_HELD = ("forces", "HELD")
PLATE_REACH = 2.0
"""Radius of the plate over the cylinder's: at two thirds an incompressible one is 1.73 wide."""
PLATE_STIFFNESS = 5.0
"""Of the contact that a folded side has, in units of the gel's Young's modulus over an element."""


@dataclass(frozen=True)
class Compression:
    """What a run computes.

    Attributes:
        radius_m, height_m: of the cylinder.
        law: of the gel.
        share: of the height that it is compressed by, at the end of each step; rising.
        spacing_m: size of the elements.
        is_stuck: whether the plates hold it; else they are frictionless.
        control: of the increments.
    """

    radius_m: float
    height_m: float
    law: ElasticLaw
    share: Sequence[float]
    spacing_m: float
    is_stuck: bool = True
    control: StepControl = field(default_factory=lambda: StepControl(first=0.25, largest=0.25))

    def text(self) -> str:
        """Return the input file."""
        return "\n".join(self._lines()) + "\n"

    def place_m(self) -> FloatArray:
        """Return (A, D, 2) the grid of nodes, from the axis outwards and from the plate down."""
        half = 0.5 * self.height_m
        across, down = (
            halved_marks(np.linspace(0.0, length, int(np.ceil(length / self.spacing_m)) + 1))
            for length in (self.radius_m, half)
        )
        return np.stack(np.meshgrid(across, half - down, indexing="ij"), axis=-1)

    def plate_m(self) -> FloatArray:
        """Return (A, 3, 2) the grid of nodes of the plate's part beyond the cylinder."""
        half, thickness = 0.5 * self.height_m, self.spacing_m
        reach = halved_marks(np.linspace(self.radius_m, PLATE_REACH * self.radius_m, 25))
        up = half + np.array([thickness, 0.5 * thickness, 0.0])
        return np.stack(np.meshgrid(reach, up, indexing="ij"), axis=-1)

    def _lines(self) -> Iterator[str]:
        section = section_of(self.place_m(), bonded_side=False)
        plate = section_of(self.plate_m(), bonded_side=False)
        at, count = section.node_m, len(section.element)
        for name, first, nodes_m in (("GEL", 1, at), ("PLATE", len(at) + 1, plate.node_m)):
            yield f"*NODE, NSET={name}"
            for number, (across, height) in enumerate((MM * nodes_m).tolist(), start=first):
                yield f"{number}, {across:.9e}, {height:.9e}, 0.0"
        for name, first, elements in (
            ("GEL", 1, section.element + 1),
            ("PLATE", count + 1, plate.element + len(at) + 1),
        ):
            yield f"*ELEMENT, TYPE=CAX8R, ELSET={name}"
            for number, nodes in enumerate(elements.tolist(), start=first):
                yield f"{number}, {', '.join(map(str, nodes))}"
        for name, members in (
            ("TOP", section.skin_node),
            ("MIDDLE", section.bonded),
            ("AXIS", np.flatnonzero(at[:, 0] < 1e-12)),
        ):
            yield f"*NSET, NSET={name}"
            yield from (f"{number + 1}," for number in members.tolist())
        yield "*NSET, NSET=HELD"
        yield "TOP, PLATE"
        yield "*SURFACE, NAME=SIDE, TYPE=ELEMENT"
        rows = len(section.skin_element)
        # The second edge of an element in the outermost column is the side's.
        yield from (f"{number}, S2" for number in range(count - count // rows + 1, count + 1))
        yield "*SURFACE, NAME=PLATE_FACE, TYPE=ELEMENT"
        yield "PLATE, S1"
        yield "*MATERIAL, NAME=SILICONE"
        yield from hyperelastic_lines(self.law)
        yield "*MATERIAL, NAME=RIGID"
        yield "*ELASTIC"
        yield "1.0, 0.3"
        yield "*SOLID SECTION, ELSET=GEL, MATERIAL=SILICONE"
        yield "*SOLID SECTION, ELSET=PLATE, MATERIAL=RIGID"
        youngs_modulus, _ = small_strain_moduli_pa(self.law)
        yield "*SURFACE INTERACTION, NAME=TOUCH"
        yield "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"
        yield f"{PLATE_STIFFNESS * MEGAPASCAL * youngs_modulus / (MM * self.spacing_m):.9e}"
        yield "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=NODE TO SURFACE"
        yield "SIDE, PLATE_FACE"
        yield "*BOUNDARY"
        yield "PLATE, 1, 1"
        yield "MIDDLE, 2, 2"
        yield "AXIS, 1, 1"
        if self.is_stuck:
            yield "TOP, 1, 1"
        c = self.control
        for share in self.share:
            yield f"*STEP, NLGEOM, INC={c.count}"
            yield "*STATIC"
            yield f"{c.first}, 1.0, {c.smallest}, {c.largest}"
            yield "*BOUNDARY"
            yield f"HELD, 2, 2, {-0.5 * MM * share * self.height_m:.9e}"
            yield f"*NODE PRINT, NSET=HELD, FREQUENCY={NEVER}"
            yield "RF"
            yield "*END STEP"


@dataclass(frozen=True)
class Compressed:
    """What a run gave, F steps.

    Attributes:
        share: (F,) of the height that the cylinder is compressed by.
        force_n: (F,) on a plate.
        failure: why steps are missing, empty where none are.
    """

    share: FloatArray
    force_n: FloatArray
    failure: str


def compressed(problem: Compression, *, time_limit_s: float | None = None) -> Compressed:
    """Run CalculiX.

    Args:
        problem: what to compute.
        time_limit_s: it is ended after this long, and what it has solved by then is returned.

    Raises:
        CalculixMissingError: it is not installed.
        CalculixError: it solved no step.
        ValueError: it has no form of the law.
    """
    with tempfile.TemporaryDirectory(prefix="dotsim_reference_") as folder:
        text = problem.text()
        reason = execute(text, Path(folder), thread_count=1, time_limit_s=time_limit_s)
        tables = read_tables(Path(folder) / f"{JOB}.dat")
    held = [rows for quantity, name, rows in tables if (quantity, name) == _HELD]
    failure = failure_of(len(held), len(problem.share), reason)
    share = np.asarray(problem.share[: len(held)])
    force = [-WEDGE_COUNT * float(rows[:, 2].sum()) for rows in held]
    return Compressed(share, np.asarray(force), failure)
