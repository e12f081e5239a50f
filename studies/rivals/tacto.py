# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tacto's geometry: the gel's surface is the rigid indenter's where that is deeper.

Wang, Lambeta, Chou, Calandra: "TACTO: A Fast, Flexible, and Open-Source Simulator for
High-Resolution Vision-Based Tactile Sensors", RA-L 7(2), 2022. Tacto renders the object that has
sunk into the elastomer and the undeformed elastomer next to it into one depth buffer, of which the
nearer to the camera is seen. On a skin mesh that is the skin, with every vertex
inside the indenter moved along its normal onto the indenter's surface.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from studies.rivals.clipping import clip_depths, clipped_skin
from studies.rivals.penalty_force import fit_stiffness, penetration_vectors
from studies.rivals.training import check_training


@dataclass(frozen=True)
class Tacto:
    """The clipped skin, with the force of a rigid penalty.

    Attributes:
        stiffness_n_m: force for each metre of the deepest penetration.
        name: how tables call it.
    """

    stiffness_n_m: float
    name: str = "tacto"

    def predict(self, press: Press, indenter: Indenter, skin: SkinMesh) -> Prediction:
        """Return skin and force at the poses of a press; see `studies.geometry.scores.Model`."""
        depth = clip_depths(skin, press.poses, indenter)
        force = self.stiffness_n_m * penetration_vectors(skin, depth)
        return Prediction(clipped_skin(skin, depth), force)


def fit(train: Sequence[Press], indenters: Mapping[str, Indenter], skin: SkinMesh) -> Tacto:
    """Return Tacto with the stiffness of least squares over all frames; its shape has no parameter.

    Args:
        train: presses with skin and force.
        indenters: their indenters, by name.
        skin: the measured skin at rest.

    Raises:
        ValueError: no press, one without skin or force, or no contact.
    """
    check_training(train)
    penetration = [
        penetration_vectors(skin, clip_depths(skin, press.poses, indenters[press.indenter]))
        for press in train
    ]
    force = np.concatenate([press.force_n for press in train if press.force_n is not None])
    return Tacto(fit_stiffness(np.concatenate(penetration), force))
