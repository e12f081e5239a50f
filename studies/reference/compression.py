# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A cylinder between two plates that it sticks to, as a problem of two dimensions in CalculiX.

The upper half is solved, which the plane in the middle mirrors. Where it bulges, its side folds
onto the plate, which reaches beyond the cylinder; what has folded slides on it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from dotsim_ros.gel.material import ElasticLaw, small_strain_moduli_pa
from dotsim_ros.io.arrays import FloatArray
from studies.reference import blocks
from studies.reference.axisymmetric import WEDGE_COUNT, section_of
from studies.reference.blocks import MEGAPASCAL, MM, StepControl
from studies.reference.mesh import halved_marks
from studies.reference.run import run

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
        yield from blocks.node_lines("GEL", 1, at)
        yield from blocks.node_lines("PLATE", len(at) + 1, plate.node_m)
        yield from blocks.element_lines("CAX8R", "GEL", 1, section.element + 1)
        yield from blocks.element_lines("CAX8R", "PLATE", count + 1, plate.element + len(at) + 1)
        yield from blocks.set_lines("TOP", section.skin_node + 1)
        yield from blocks.set_lines("MIDDLE", section.bonded + 1)
        yield from blocks.set_lines("AXIS", np.flatnonzero(at[:, 0] < 1e-12) + 1)
        yield from ("*NSET, NSET=HELD", "TOP, PLATE")
        # The second edge of an element in the outermost column is the side's.
        outermost = count // len(section.skin_element)
        yield from blocks.surface_lines("SIDE", range(count - outermost + 1, count + 1), "S2")
        yield from blocks.surface_lines("PLATE_FACE", ["PLATE"], "S1")
        yield from blocks.matter_lines("SILICONE", blocks.law_lines(self.law), "GEL")
        yield from blocks.rigid_lines("PLATE")
        youngs_modulus, _ = small_strain_moduli_pa(self.law)
        yield "*SURFACE INTERACTION, NAME=TOUCH"
        yield "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"
        yield f"{PLATE_STIFFNESS * MEGAPASCAL * youngs_modulus / (MM * self.spacing_m):.9e}"
        yield "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=NODE TO SURFACE"
        yield "SIDE, PLATE_FACE"
        yield from ("*BOUNDARY", "PLATE, 1, 1", "MIDDLE, 2, 2", "AXIS, 1, 1")
        if self.is_stuck:
            yield "TOP, 1, 1"
        for share in self.share:
            yield from blocks.step_lines(
                self.control.count,
                self.control.procedure_lines(),
                [f"HELD, 2, 2, {-0.5 * MM * share * self.height_m:.9e}"],
                {"HELD": "RF"},
            )


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
    printed = run(problem.text(), held="HELD", time_limit_s=time_limit_s)
    force = [-WEDGE_COUNT * float(rows[:, 2].sum()) for rows in printed.held]
    share = np.asarray(problem.share[: len(force)])
    return Compressed(share, np.asarray(force), printed.failure(len(problem.share)))
