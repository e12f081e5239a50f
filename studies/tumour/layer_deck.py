# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The input file of CalculiX for a soft layer that is pressed onto a dome: two deformable bodies.

Layer, tilt and offset are symmetric about the plane y = 0, so that half of both bodies is solved.
In mm, N and MPa.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from dotsim_ros.gel.material import ElasticLaw, NeoHookean
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, IntArray
from dotsim_ros.specification import ContactSpecification
from studies.reference import blocks
from studies.reference.blocks import MM, StepControl
from studies.reference.mesh import DomeMesh
from studies.tumour.pair.layer import Insert, LayerSpecification

ON_PLANE_M = 1.0e-9
"""Nodes closer to the plane of symmetry lie on it."""
BRICK = (
    *((0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)),
    *((1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2)),
    *((0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)),
)
"""Places of an element's nodes, in half cells, as CalculiX numbers those of C3D20R."""


@dataclass(frozen=True)
class LayerMesh:
    """Half a layer in bricks of 20 nodes: y <= 0, which is the gel's y >= 0 once it faces the gel.

    Attributes:
        node_m: (N, 3) at rest, layer's frame.
        element: (E, 20) node numbers from 0; the second face is the upper one.
        top_element: (Q,) elements at the top.
        bonded: (B,) nodes on the insert.
    """

    node_m: FloatArray
    element: IntArray
    top_element: IntArray
    bonded: IntArray


def half_layer_mesh(layer: LayerSpecification, insert: Insert, spacing_m: float) -> LayerMesh:
    """Return the mesh of half a layer.

    Args:
        layer: its size; its own resolution plays no part.
        insert: what it is bonded to.
        spacing_m: about the size of the elements.

    Raises:
        ValueError: an insert next to the plane of symmetry, or a spacing that is not positive.
    """
    if insert.centre_m[1] != 0.0:
        raise ValueError(
            f"the insert lies {insert.centre_m[1]} m next to the plane y = 0, expected 0: half of "
            "the layer is solved; turn the layer instead"
        )
    if not spacing_m > 0.0:
        raise ValueError(f"element spacing is {spacing_m} m, expected a positive one")
    half = 0.5 * layer.side_m
    count = max(1, round(half / spacing_m))
    through = max(2, round(layer.thickness_m / spacing_m))
    marks = (2 * 2 * count + 1, 2 * count + 1, 2 * through + 1)
    x, y, share = np.meshgrid(
        np.linspace(-half, half, marks[0]),
        np.linspace(-half, 0.0, marks[1]),
        np.linspace(0.0, 1.0, marks[2]),
        indexing="ij",
    )
    height, _ = insert.heights_m(np.stack([x.ravel(), y.ravel()], axis=1))
    low = height.reshape(x.shape)
    point = np.stack([x, y, low + share * (layer.thickness_m - low)], axis=-1).reshape(-1, 3)
    number = np.arange(len(point)).reshape(marks)
    reach = [slice(None, -2, 2)] * 3
    first = number[tuple(reach)].ravel()
    step = np.array([number[1, 0, 0], number[0, 1, 0], 1])
    grid_element = first[:, None] + (np.array(BRICK) @ step)[None, :]
    used, element = np.unique(grid_element, return_inverse=True)
    at_bottom = np.isin(used, number[:, :, 0])
    return LayerMesh(
        node_m=point[used],
        element=element.reshape(-1, 20),
        top_element=np.arange(through - 1, len(first), through),
        bonded=np.flatnonzero(at_bottom),
    )


def half_dome(mesh: DomeMesh) -> DomeMesh:
    """Return the half y >= 0 of a dome's mesh that is symmetric about y = 0.

    Raises:
        ValueError: it is not, since an element lies across that plane.
    """
    side = mesh.node_m[mesh.element][..., 1]
    kept = np.all(side > -ON_PLANE_M, axis=1)
    if np.any(~kept & np.any(side > ON_PLANE_M, axis=1)):
        raise ValueError("the dome's mesh has elements across the plane y = 0, expected none")
    used, element = np.unique(mesh.element[kept], return_inverse=True)
    number = np.full(len(mesh.node_m), -1)
    number[used] = np.arange(len(used))
    rank = np.cumsum(kept) - 1
    on_skin = kept[mesh.skin_element]
    bonded = number[mesh.bonded]
    return DomeMesh(
        node_m=mesh.node_m[used],
        element=element.reshape(-1, 20),
        skin_element=rank[mesh.skin_element[on_skin]],
        skin_face=number[mesh.skin_face[on_skin]],
        bonded=bonded[bonded >= 0],
    )


@dataclass(frozen=True)
class LayerDeck:
    """What a run computes.

    Attributes:
        gel: half of the dome's mesh.
        layer: half of the layer's.
        poses: of the layer's frame in the base frame, symmetric about y = 0 and alike but for
            their places: the first without contact, then one at the end of each step.
        gel_law, layer_law: of the two bodies.
        contact: friction and stiffness, this in units of the layer's Young's modulus.
        control: of each step's increments.
    """

    gel: DomeMesh
    layer: LayerMesh
    poses: Sequence[Pose]
    gel_law: ElasticLaw
    layer_law: NeoHookean
    contact: ContactSpecification
    control: StepControl = field(default_factory=StepControl)

    def text(self) -> str:
        """Return the input file."""
        return "\n".join(self._lines()) + "\n"

    def _lines(self) -> Iterator[str]:
        gel, layer = self.gel, self.layer
        first, elements = len(gel.node_m) + 1, len(gel.element)
        start = self.poses[0].apply(layer.node_m)
        in_plane = np.abs(np.concatenate([gel.node_m[:, 1], start[:, 1]])) < ON_PLANE_M
        yield from blocks.node_lines("GEL", 1, gel.node_m)
        yield from blocks.node_lines("LAYER", first, start)
        yield from blocks.element_lines("C3D20R", "GEL", 1, gel.element + 1)
        yield from blocks.element_lines("C3D20R", "LAYER", elements + 1, layer.element + first)
        yield from blocks.set_lines("BONDED", gel.bonded + 1)
        yield from blocks.set_lines("SKIN", np.unique(gel.skin_face) + 1)
        yield from blocks.set_lines("HELD", layer.bonded + first)
        yield from blocks.set_lines("PLANE", np.flatnonzero(in_plane) + 1)
        yield from blocks.surface_lines("SKIN_FACES", gel.skin_element + 1, "S2")
        # The contact is that of an indenter, in whose place the layer is.
        yield from blocks.surface_lines("INDENTER_FACES", layer.top_element + elements + 1, "S2")
        yield from blocks.matter_lines("OF_GEL", blocks.law_lines(self.gel_law), "GEL")
        yield from blocks.matter_lines("OF_LAYER", blocks.law_lines(self.layer_law), "LAYER")
        yield from blocks.contact_lines(self.layer_law, self.contact)
        yield from ("*BOUNDARY", "BONDED, 1, 3", "PLANE, 2, 2")
        for pose in self.poses[1:]:
            moved_mm = (MM * (pose.position_m - self.poses[0].position_m)).tolist()
            yield from blocks.step_lines(
                self.control.count,
                self.control.procedure_lines(),
                [f"HELD, {axis}, {axis}, {mm:.9e}" for axis, mm in enumerate(moved_mm, start=1)],
                {"SKIN": "U", "HELD": "RF"},
            )
