# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The input file of CalculiX for a rigid indenter that presses a dome, in mm, N and MPa."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.implicit.contact import ONSET_M, SMOOTHING_M
from dotsim_ros.gel.material import ElasticLaw
from dotsim_ros.geometry.closed_mesh import IndenterMesh
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import ContactSpecification
from studies.reference import blocks
from studies.reference.blocks import MM, StepControl
from studies.reference.mesh import DomeMesh

EARLY_M = ONSET_M - 0.5 * SMOOTHING_M
"""The gel's pressure is stiffness times (this - distance): its contact begins so far outside of the
indenter, that penetration and gap share the error. Here the indenter's surface is moved instead."""

WEDGE_THICKNESS_M = 0.1e-3
"""Thickness of the elements behind the indenter's surface; they are rigid, so any will do."""


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
        frames: of each step, evenly spaced; one without.

    Raises:
        ValueError: as many controls as steps are needed.
    """

    gel: DomeMesh
    surface: IndenterMesh
    poses: Sequence[Pose]
    law: ElasticLaw
    contact: ContactSpecification
    controls: Sequence[StepControl]
    frames: Sequence[int] = ()

    def __post_init__(self) -> None:
        if len(self.controls) != len(self.poses) - 1:
            raise ValueError(
                f"{len(self.controls)} step controls for {len(self.poses)} poses, expected one for "
                "each pose but the first"
            )

    def frame_times(self) -> FloatArray:
        """Return when the frames but the first are printed; a step takes 1."""
        counts = self.frames or [1] * len(self.controls)
        return np.concatenate([k + np.arange(1, n + 1) / n for k, n in enumerate(counts)])

    def frame_poses(self) -> list[Pose]:
        """Return the indenter's poses in the frames. Within a step each of its nodes moves along a
        straight line: turns of more than a few degrees need steps of their own."""
        steps = np.ceil(self.frame_times() - 1e-9).astype(int).tolist()
        return [
            self.poses[0],
            *(
                interpolate(self.poses[step - 1], self.poses[step], time - step + 1)
                for step, time in zip(steps, self.frame_times().tolist(), strict=True)
            ),
        ]

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
        gel, first = self.gel, self.gel_node_count + 1
        local = self.indenter_nodes_m()
        start = self.poses[0].apply(local)
        wedge = np.concatenate(
            [self.surface.triangles, self.surface.triangles + len(local) // 2], 1
        )
        yield from blocks.node_lines("GEL", 1, gel.node_m)
        yield from blocks.node_lines("INDENTER", first, start)
        yield from blocks.element_lines("C3D20R", "GEL", 1, gel.element + 1)
        yield from blocks.element_lines("C3D6", "INDENTER", len(gel.element) + 1, wedge + first)
        yield from blocks.set_lines("BONDED", gel.bonded + 1)
        yield from blocks.set_lines("SKIN", np.unique(gel.skin_face) + 1)
        # The second face of a brick and of a wedge is that of their outer nodes.
        yield from blocks.surface_lines("SKIN_FACES", gel.skin_element + 1, "S2")
        yield from blocks.surface_lines("INDENTER_FACES", ["INDENTER"], "S2")
        yield from self.matter_lines()
        yield from blocks.rigid_lines("INDENTER")
        yield from blocks.contact_lines(self.law, self.contact)
        yield from self.support_lines()
        for index, count in enumerate(self.frames):
            yield f"*TIME POINTS, NAME=FRAMES{index}"
            yield from (f"{k / count:.9e}" for k in range(1, count + 1))
        for index, (control, pose) in enumerate(zip(self.controls, self.poses[1:], strict=True)):
            moved_mm = (MM * (pose.apply(local) - start)).tolist()
            yield from blocks.step_lines(
                control.count,
                self.procedure_lines(index),
                (
                    f"{node}, {axis}, {axis}, {value:.9e}"
                    for node, vector in enumerate(moved_mm, start=first)
                    for axis, value in enumerate(vector, start=1)
                ),
                {"SKIN": "U", "INDENTER": "RF"},
                **({"when": f"TIME POINTS=FRAMES{index}"} if self.frames else {}),
            )

    def matter_lines(self) -> Iterator[str]:
        """Yield what the gel consists of."""
        yield from blocks.matter_lines("SILICONE", blocks.law_lines(self.law), "GEL")

    def support_lines(self) -> Iterator[str]:
        """Yield what holds the gel."""
        yield "*BOUNDARY"
        yield "BONDED, 1, 3"

    def procedure_lines(self, index: int) -> Iterator[str]:
        """Yield how the step of an index, from 0, is solved."""
        return self.controls[index].procedure_lines()


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
