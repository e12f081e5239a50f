# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The input file of CalculiX for a rigid indenter that presses a dome, in mm, N and MPa."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.implicit.contact import ONSET_M, REFERENCE_SPACING_M, SMOOTHING_M
from dotsim_ros.gel.material import ElasticLaw, small_strain_moduli_pa
from dotsim_ros.geometry.closed_mesh import IndenterMesh
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, IntArray
from dotsim_ros.specification import ContactSpecification
from studies.reference.mesh import DomeMesh

MM = 1e3
MEGAPASCAL = 1e-6

EARLY_M = ONSET_M - 0.5 * SMOOTHING_M
"""The gel's pressure is stiffness times (this - distance): its contact begins so far outside of the
indenter, that penetration and gap share the error. Here the indenter's surface is moved instead."""

WEDGE_THICKNESS_M = 0.1e-3
"""Thickness of the elements behind the indenter's surface; they are rigid, so any will do."""

NEVER = 1_000_000
"""Printed every so many increments; the last one of a step is printed anyway."""

NEGLIGIBLE = 1e6
"""D2 and D3 over D1: CalculiX divides by them, and needs them positive."""


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


@dataclass(frozen=True)
class Deck:
    """What a run computes.

    Attributes:
        gel: the dome's mesh.
        surface: the part of the indenter that can touch, in its frame.
        poses: of the indenter's frame in the base frame: the first without contact, then one at
            the end of each step.
        law: of the gel.
        contact: friction and stiffness; frictionless without a coefficient.
        controls: of the increments, one for each pose but the first.

    Raises:
        ValueError: as many controls as steps are needed.
    """

    gel: DomeMesh
    surface: IndenterMesh
    poses: Sequence[Pose]
    law: ElasticLaw
    contact: ContactSpecification
    controls: Sequence[StepControl]

    def __post_init__(self) -> None:
        if len(self.controls) != len(self.poses) - 1:
            raise ValueError(
                f"{len(self.controls)} step controls for {len(self.poses)} poses, expected one for "
                "each pose but the first"
            )

    @property
    def gel_node_count(self) -> int:
        """Nodes of the gel; they are numbered first."""
        return len(self.gel.node_m)

    def indenter_nodes_m(self) -> FloatArray:
        """Return (2 M, 3) nodes in the indenter's frame: those inside, then the surface's own,
        which lie where contact begins."""
        vertices, triangles = self.surface.vertices_m, self.surface.triangles
        corner = vertices[triangles]
        face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal = np.zeros_like(vertices)
        np.add.at(normal, triangles.ravel(), np.repeat(face, 3, axis=0))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return np.concatenate([vertices - WEDGE_THICKNESS_M * normal, vertices + EARLY_M * normal])

    def text(self) -> str:
        """Return the input file."""
        return "\n".join(self._lines()) + "\n"

    def _lines(self) -> Iterator[str]:
        first = self.gel_node_count + 1
        local = self.indenter_nodes_m()
        start = self.poses[0].apply(local)
        half = len(local) // 2
        wedge = np.concatenate([self.surface.triangles, self.surface.triangles + half], axis=1)
        gel_elements = len(self.gel.element)
        yield "*NODE, NSET=GEL"
        yield from _rows(1, MM * self.gel.node_m)
        yield "*NODE, NSET=INDENTER"
        yield from _rows(first, MM * start)
        yield "*ELEMENT, TYPE=C3D20R, ELSET=GEL"
        yield from brick_lines(1, self.gel.element + 1)
        yield "*ELEMENT, TYPE=C3D6, ELSET=INDENTER"
        for number, nodes in enumerate(wedge + first, start=gel_elements + 1):
            yield f"{number}, {', '.join(map(str, nodes.tolist()))}"
        yield "*NSET, NSET=BONDED"
        yield from listed(self.gel.bonded + 1)
        yield "*NSET, NSET=SKIN"
        yield from listed(np.unique(self.gel.skin_face) + 1)
        yield "*SURFACE, NAME=SKIN_FACES, TYPE=ELEMENT"
        # The second face of a brick and of a wedge is that of their outer nodes.
        yield from (f"{number}, S2" for number in (self.gel.skin_element + 1).tolist())
        yield "*SURFACE, NAME=INDENTER_FACES, TYPE=ELEMENT"
        yield "INDENTER, S2"
        yield from self.matter_lines()
        yield from contact_lines(self.law, self.contact)
        yield from self.support_lines()
        for index, pose in enumerate(self.poses[1:]):
            yield from self._step_lines(first, MM * (pose.apply(local) - start), index)

    def matter_lines(self) -> Iterator[str]:
        """Yield what gel and indenter consist of."""
        yield from material_lines(self.law)

    def support_lines(self) -> Iterator[str]:
        """Yield what holds the gel."""
        yield "*BOUNDARY"
        yield "BONDED, 1, 3"

    def procedure_lines(self, index: int) -> Iterator[str]:
        """Yield how the step of an index, from 0, is solved."""
        c = self.controls[index]
        yield "*STATIC"
        yield f"{c.first}, 1.0, {c.smallest}, {c.largest}"

    def _step_lines(self, first: int, displacement_mm: FloatArray, index: int) -> Iterator[str]:
        yield f"*STEP, NLGEOM, INC={self.controls[index].count}"
        yield from self.procedure_lines(index)
        yield "*BOUNDARY"
        for node, vector in enumerate(displacement_mm.tolist(), start=first):
            for axis, value in enumerate(vector, start=1):
                yield f"{node}, {axis}, {axis}, {value:.9e}"
        yield f"*NODE PRINT, NSET=SKIN, FREQUENCY={NEVER}"
        yield "U"
        yield f"*NODE PRINT, NSET=INDENTER, FREQUENCY={NEVER}"
        yield "RF"
        yield "*END STEP"


def material_lines(law: ElasticLaw) -> Iterator[str]:
    """Yield the materials of gel and indenter and the sets of elements that have them.

    Raises:
        ValueError: CalculiX has no form of the law.
    """
    yield "*MATERIAL, NAME=SILICONE"
    yield from hyperelastic_lines(law)
    yield "*MATERIAL, NAME=RIGID"
    yield "*ELASTIC"
    yield "1.0, 0.3"
    yield "*SOLID SECTION, ELSET=GEL, MATERIAL=SILICONE"
    yield "*SOLID SECTION, ELSET=INDENTER, MATERIAL=RIGID"


def hyperelastic_lines(law: ElasticLaw) -> Iterator[str]:
    """Yield the form of a law and its constants.

    Raises:
        ValueError: CalculiX has no form of the law.
    """
    c10, c01, c20, c30, bulk = (MEGAPASCAL * law.coefficients_pa()).tolist()
    d1 = 2.0 / bulk
    if c20 or c30:
        if c01:
            raise ValueError("a law with C01 and C20 or C30 has no form in the reference")
        yield "*HYPERELASTIC, YEOH"
        constants = [c10, c20, c30, d1, NEGLIGIBLE * d1, NEGLIGIBLE * d1]
    elif c01:
        yield "*HYPERELASTIC, MOONEY-RIVLIN"
        constants = [c10, c01, d1]
    else:
        yield "*HYPERELASTIC, NEO HOOKE"
        constants = [c10, d1]
    yield ", ".join(f"{constant:.9e}" for constant in constants)


def contact_lines(law: ElasticLaw, contact: ContactSpecification) -> Iterator[str]:
    """Yield the contact of the surfaces SKIN_FACES and INDENTER_FACES."""
    youngs_modulus, _ = small_strain_moduli_pa(law)
    stiffness = contact.stiffness * MEGAPASCAL * youngs_modulus / (MM * REFERENCE_SPACING_M)
    yield "*SURFACE INTERACTION, NAME=TOUCH"
    yield "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"
    yield f"{stiffness:.9e}"
    if contact.friction_coefficient > 0.0:
        yield "*FRICTION"
        stick = contact.tangential_ratio * stiffness
        yield f"{contact.friction_coefficient:.9e}, {stick:.9e}"
    yield "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE"
    yield "SKIN_FACES, INDENTER_FACES"


def _rows(first: int, values: FloatArray) -> Iterator[str]:
    for number, row in enumerate(values.tolist(), start=first):
        yield f"{number}, {', '.join(f'{value:.9e}' for value in row)}"


def brick_lines(first: int, nodes: IntArray) -> Iterator[str]:
    """Yield elements with the nodes (E, 20), numbered from the first on."""
    for number, row in enumerate(nodes.tolist(), start=first):
        text = list(map(str, row))
        # A line holds at most 16 entries.
        yield f"{number}, {', '.join(text[:10])},"
        yield ", ".join(text[10:])


def listed(numbers: Iterable[int]) -> Iterator[str]:
    """Yield numbers, 16 a line."""
    entries = [str(int(number)) for number in numbers]
    for start in range(0, len(entries), 16):
        yield ", ".join(entries[start : start + 16]) + ","


def near_part(surface: IndenterMesh, near: NDArray[np.bool_]) -> IndenterMesh:
    """Return the triangles of a surface with a vertex that is near (V,), and their vertices.

    Raises:
        ValueError: none is near.
    """
    kept = surface.triangles[near[surface.triangles].any(axis=1)]
    if len(kept) == 0:
        raise ValueError("no part of the indenter comes near the gel")
    used, merged = np.unique(kept, return_inverse=True)
    return IndenterMesh(surface.vertices_m[used], merged.reshape(-1, 3).astype(np.int32))
