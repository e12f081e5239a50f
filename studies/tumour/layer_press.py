# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A soft layer pressed onto the dome, solved by CalculiX with both bodies deformable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dotsim_ros.gel.make import law_of
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import ContactSpecification, SensorSpecification
from studies.reference.blocks import MM, StepControl
from studies.reference.mesh import MeshedPress, dome_mesh, interpolate_skin
from studies.reference.run import run
from studies.tumour.layer_deck import LayerDeck, half_dome, half_layer_mesh
from studies.tumour.pair.layer import Insert, LayerSpecification

_SKIN_MOVED, _HELD = ("displacements", "SKIN"), ("forces", "HELD")
FINE_RADIUS_M = 8.0e-3
"""Arc length from the apex within which the gel's mesh is fine."""


@dataclass(frozen=True)
class LayerPressSettings:
    """Resolution and effort.

    Attributes:
        gel_spacing_m: size of the gel's elements at the press; their nodes lie half as far apart.
        layer_spacing_m: of the layer's.
        friction: of gel on layer.
        control: of the increments.
    """

    gel_spacing_m: float = 2.0e-3
    layer_spacing_m: float = 2.0e-3
    friction: float = 0.0
    control: StepControl = field(default_factory=lambda: StepControl(first=0.5))


@dataclass(frozen=True)
class SolvedLayerPress:
    """The end of each step that was solved.

    Attributes:
        displacement_m: (F, N, 3) of half the gel's nodes; only those on the skin are filled in.
        force_n: (F, 3) of the gel on the layer, base frame.
        failure: why the other steps were not solved, empty where all were.
        deck: what was computed.
    """

    displacement_m: FloatArray
    force_n: FloatArray
    failure: str
    deck: LayerDeck

    def skin_m(self, rest_m: FloatArray, turn_rad: float = 0.0) -> FloatArray:
        """Return the skin (F, V, 3) of a press that is turned about the sensor's axis.

        Args:
            rest_m: (V, 3) the skin's points at rest.
            turn_rad: from +x towards +y. The dome is round, so that this is exact.
        """
        c, s = np.cos(turn_rad), np.sin(turn_rad)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        solved = rest_m @ turn
        side = np.where(solved[:, 1] < 0.0, -1.0, 1.0)
        solved[:, 1] *= side
        at = interpolate_skin(self.deck.gel, solved)
        moved = np.stack([at.of(displacement) for displacement in self.displacement_m])
        moved[..., 1] *= side
        return np.asarray(rest_m + moved @ turn.T)


def solve_layer_press(
    sensor: SensorSpecification,
    layer: LayerSpecification,
    insert: Insert,
    poses: Sequence[Pose],
    settings: LayerPressSettings,
) -> SolvedLayerPress:
    """Run CalculiX on a press.

    Args:
        sensor: its gel and its gel's law.
        layer: size and material; its own resolution plays no part.
        insert: what it is bonded to, on the plane y = 0.
        poses: of the layer's frame in the base frame, symmetric about y = 0; the first without
            contact.
        settings: resolution, effort, friction.

    Raises:
        CalculixMissingError: it is not installed.
        CalculixError: it solved no step.
        ValueError: the gel is no dome around a core, or the press is not symmetric.
    """
    if sensor.gel.shape != "dome":
        raise ValueError(f"the reference is for domes only, not for gel.shape {sensor.gel.shape!r}")
    for pose in poses:
        turned = pose.rotation()
        if abs(pose.position_m[1]) > 1e-12 or np.abs(turned[1] * [1, 0, 1]).max() > 1e-9:
            raise ValueError(
                "the layer is tilted or moved out of the plane y = 0; half of both bodies is "
                "solved, so tilt it about y and move it along x"
            )
    whole = dome_mesh(
        core_radius_m=sensor.gel.core_radius_m,
        outer_radius_m=sensor.gel.outer_radius_m,
        press=MeshedPress(np.array([0.0, 0.0, 1.0]), FINE_RADIUS_M),
        spacing_m=settings.gel_spacing_m,
    )
    mesh = half_layer_mesh(layer, insert, settings.layer_spacing_m)
    law = NeoHookean(layer.youngs_modulus_pa, layer.poisson_ratio)
    contact = ContactSpecification(friction_coefficient=settings.friction)
    deck = LayerDeck(
        half_dome(whole), mesh, poses, law_of(sensor.material), law, contact, settings.control
    )
    printed = run(deck.text(), held="HELD")
    failure, count = printed.failure(len(poses) - 1), len(printed.held)
    displacement = np.zeros((count, len(deck.gel.node_m), 3))
    force = np.zeros((count, 3))
    for step, (moved, held) in enumerate(zip(printed.moved, printed.held, strict=True)):
        displacement[step, moved[:, 0].astype(np.int64) - 1] = moved[:, 1:] / MM
        # What holds half of the layer is opposite to the gel's force on it.
        force[step] = -2.0 * held[:, 1:].sum(axis=0)
    force[:, 1] = 0.0
    return SolvedLayerPress(displacement, force, failure, deck)
