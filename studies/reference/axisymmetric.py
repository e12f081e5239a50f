# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presses of a body of revolution on a dome's apex or a round pad as a problem of two dimensions.

Elements of 0.25 mm, which resolve a narrow contact, cost seconds here and hours in three
dimensions. CalculiX expands each (CAX8R) into a wedge of two degrees, whose force it prints.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from dotsim_ros.gel.material import ElasticLaw
from dotsim_ros.geometry.indenter import Indenter, IndenterKind
from dotsim_ros.geometry.surface import meridian
from dotsim_ros.io.arrays import FloatArray, IntArray
from dotsim_ros.specification import ContactSpecification, GelSpecification
from studies.reference import blocks
from studies.reference.blocks import MM, StepControl
from studies.reference.deck import EARLY_M, WEDGE_THICKNESS_M
from studies.reference.mesh import growing_marks, halved_marks

WEDGE_COUNT = 180
"""Number of wedges in a full turn."""

GROWTH = 1.15
"""Ratio of the sizes of two neighbouring elements away from the contact."""

CORNERS_AND_MIDDLES = ((0, 2), (2, 2), (2, 0), (0, 0), (1, 2), (2, 1), (1, 0), (0, 1))
"""Places of an element's nodes, in half cells along and across: from the base outwards, along the
skin inwards, and back."""


@dataclass(frozen=True)
class AxisymmetricSettings:
    """Resolution and effort.

    Attributes:
        spacing_m: size of the gel's elements at the press.
        reach_m: arc length from the apex over which they are that small.
        surface_step_m: length of the indenter's elements along its meridian.
        control: of the increments.
    """

    spacing_m: float = 0.25e-3
    reach_m: float = 4.5e-3
    surface_step_m: float = 0.15e-3
    control: StepControl = field(default_factory=lambda: StepControl(first=0.25, largest=0.25))


@dataclass(frozen=True)
class GelSection:
    """A gel's half section, in quadrilaterals of 8 nodes.

    Attributes:
        node_m: (N, 2) distance from the axis, and height.
        element: (E, 8) node numbers from 0: corners, against the clock, then middles of the edges;
            the third edge of an element at the skin lies on it.
        skin_element: (Q,) those.
        skin_node: (K,) nodes on the skin, from the axis outwards.
        bonded, on_axis: nodes that are held, and the others on the axis.
    """

    node_m: FloatArray
    element: IntArray
    skin_element: IntArray
    skin_node: IntArray
    bonded: IntArray
    on_axis: IntArray


def dome_section(gel: GelSpecification, settings: AxisymmetricSettings) -> GelSection:
    """Return the mesh of a dome's half section, fine at the apex, bonded on core and base.

    Raises:
        ValueError: the gel is no dome around a core.
    """
    if gel.shape != "dome" or not gel.core_radius_m > 0.0:
        raise ValueError(
            "the reference is for domes around a rigid core only, not for gel.shape "
            f"{gel.shape!r} with a core of {gel.core_radius_m} m"
        )
    outer, spacing = gel.outer_radius_m, settings.spacing_m
    fine = settings.reach_m / outer
    count = int(np.ceil(settings.reach_m / spacing))
    beyond = growing_marks(0.5 * np.pi - fine, GROWTH * spacing / outer, largest_ratio=GROWTH)
    angle = halved_marks(np.concatenate([np.linspace(0.0, fine, count + 1), fine + beyond[1:]]))
    depth = halved_marks(growing_marks(outer - gel.core_radius_m, spacing, largest_ratio=GROWTH))
    turn, reach = np.meshgrid(angle, outer - depth, indexing="ij")
    place = np.stack([reach * np.sin(turn), reach * np.cos(turn)], axis=-1)
    return section_of(place, bonded_side=True)


def disc_section(radius_m: float, thickness_m: float, settings: AxisymmetricSettings) -> GelSection:
    """Return the mesh of a round pad's half section, fine in its middle, bonded at its base.

    Args:
        radius_m: of the pad, whose side is free.
        thickness_m: its base lies at the height 0, its skin at this.
        settings: `reach_m` is the distance from the axis up to which the elements are small.

    Raises:
        ValueError: the pad is not larger than what is to be fine.
    """
    if not radius_m > settings.reach_m > 0.0 or not thickness_m > settings.spacing_m:
        raise ValueError(
            f"a pad of {radius_m} m radius and {thickness_m} m thickness, expected more than the "
            f"{settings.reach_m} m and {settings.spacing_m} m of its fine elements"
        )
    spacing = settings.spacing_m
    count = int(np.ceil(settings.reach_m / spacing))
    beyond = growing_marks(radius_m - settings.reach_m, GROWTH * spacing, largest_ratio=GROWTH)
    fine = np.linspace(0.0, settings.reach_m, count + 1)
    across = halved_marks(np.concatenate([fine, settings.reach_m + beyond[1:]]))
    depth = halved_marks(growing_marks(thickness_m, spacing, largest_ratio=GROWTH))
    place = np.stack(np.meshgrid(across, thickness_m - depth, indexing="ij"), axis=-1)
    return section_of(place, bonded_side=False)


def section_of(place_m: FloatArray, *, bonded_side: bool) -> GelSection:
    """Return the section whose nodes lie on a grid of doubled marks.

    Args:
        place_m: (A, D, 2) distance from the axis and height, from the axis outwards and from the
            skin inwards; A and D are odd.
        bonded_side: whether the gel is held at its outer end too, not at its base only.
    """
    rows, columns = np.arange(place_m.shape[0]), np.arange(place_m.shape[1])
    is_node = (rows[:, None] % 2 == 0) | (columns % 2 == 0)
    number = np.where(is_node, np.cumsum(is_node).reshape(is_node.shape) - 1, -1)
    last, deepest = len(rows) - 2, len(columns) - 2
    element = np.stack(
        [number[i : i + last : 2, j : j + deepest : 2] for i, j in CORNERS_AND_MIDDLES], axis=-1
    )
    fixed = np.concatenate([number[:, -1], number[-1] if bonded_side else []]).astype(np.int64)
    bonded = np.unique(fixed[fixed >= 0])
    return GelSection(
        node_m=place_m[is_node],
        element=element.reshape(-1, 8),
        skin_element=np.arange(element.shape[0]) * element.shape[1],
        skin_node=number[:, 0],
        bonded=bonded,
        on_axis=np.setdiff1d(number[0], bonded),
    )


@dataclass(frozen=True)
class AxisymmetricDeck:
    """What a run computes.

    Attributes:
        section: the gel's mesh.
        indenter: a body of revolution.
        apex_m: height of the skin on the axis.
        depth_m: of the tip below it, at the start and then at the end of each step.
        law: of the gel.
        contact: friction and stiffness.
        settings: resolution and effort.

    Raises:
        ValueError: the indenter is no body of revolution that stands on its tip.
    """

    section: GelSection
    indenter: Indenter
    apex_m: float
    depth_m: Sequence[float]
    law: ElasticLaw
    contact: ContactSpecification
    settings: AxisymmetricSettings

    def __post_init__(self) -> None:
        kind, mount = self.indenter.kind, self.indenter.mount
        is_upright = np.allclose(mount.rotation(), np.eye(3)) and not np.any(mount.position_m)
        if kind in (IndenterKind.BOX, IndenterKind.MESH) or not is_upright:
            raise ValueError(
                f"indenter {self.indenter.name} is no upright body of revolution; solve it in "
                "three dimensions"
            )

    def indenter_nodes_m(self) -> FloatArray:
        """Return (3, M, 2) nodes within the indenter, on the middle of its elements and where
        contact begins, along the meridian from the tip, in its frame; M is odd."""
        line = meridian(self.indenter, 0.5 * self.settings.surface_step_m)
        if self.indenter.kind is IndenterKind.TORUS:
            # Closed: its ends meet where nothing touches, at the top.
            line = np.roll(line[:-1], len(line) // 2, axis=0)
        line = line[: len(line) - 1 + len(line) % 2]
        along = np.gradient(line, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        outwards = np.stack([along[:, 1], -along[:, 0]], axis=1)
        on_axis = line[:, 0] < 1e-9
        outwards[on_axis] = np.stack([0.0 * line[on_axis, 0], np.sign(outwards[on_axis, 1])], 1)
        offsets = (-WEDGE_THICKNESS_M, 0.5 * (EARLY_M - WEDGE_THICKNESS_M), EARLY_M)
        return np.stack([line + offset * outwards for offset in offsets])

    def text(self) -> str:
        """Return the input file."""
        return "\n".join(self._lines()) + "\n"

    def _lines(self) -> Iterator[str]:
        section, local = self.section, self.indenter_nodes_m()
        first, per_layer = len(section.node_m) + 1, local.shape[1]
        start = local.reshape(-1, 2) + np.array([0.0, self.apex_m - self.depth_m[0]])
        layer, along = np.array(CORNERS_AND_MIDDLES).T[::-1]
        begin = np.arange(0, per_layer - 2, 2)[:, None]
        yield from blocks.node_lines("GEL", 1, section.node_m)
        yield from blocks.node_lines("INDENTER", first, start)
        yield from blocks.element_lines("CAX8R", "GEL", 1, section.element + 1)
        elements = first + begin + along + layer * per_layer
        yield from blocks.element_lines("CAX8R", "INDENTER", len(section.element) + 1, elements)
        yield from blocks.set_lines("BONDED", section.bonded + 1)
        yield from blocks.set_lines("AXIS", section.on_axis + 1)
        yield from blocks.set_lines("SKIN", section.skin_node + 1)
        yield from blocks.surface_lines("SKIN_FACES", section.skin_element + 1, "S3")
        yield from blocks.surface_lines("INDENTER_FACES", ["INDENTER"], "S1")
        yield from blocks.matter_lines("SILICONE", blocks.law_lines(self.law), "GEL")
        yield from blocks.rigid_lines("INDENTER")
        yield from blocks.contact_lines(self.law, self.contact)
        yield from ("*BOUNDARY", "BONDED, 1, 2", "AXIS, 1, 1", "INDENTER, 1, 1")
        control = self.settings.control
        for depth_m in self.depth_m[1:]:
            yield from blocks.step_lines(
                control.count,
                control.procedure_lines(),
                [f"INDENTER, 2, 2, {-MM * (depth_m - self.depth_m[0]):.9e}"],
                {"SKIN": "U", "INDENTER": "RF"},
            )
