# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""This package's implicit gel as a model of measured presses."""

from __future__ import annotations

import numpy as np

from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.make import body_of, bond_of, material_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import follow


class ImplicitModel:
    """The implicit gel on the measured skin, from pose to pose.

    Args:
        specification: of the sensor; the spacing of its own skin plays no part.
        longest_step_s: steps between two frames are no longer; the gel itself takes substeps.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        *,
        longest_step_s: float = np.inf,
    ) -> None:
        self.specification, self.name = specification, "ours"
        self._longest_step_s = longest_step_s
        self._gel: ImplicitGel | None = None

    def prepare(self, indenter: Indenter, skin: SkinMesh) -> ImplicitGel:
        """Return the gel at rest, its indenter outside; for another skin that takes seconds."""
        gel = self._gel
        if gel is None or gel.skin is not skin:
            s = self.specification
            gel = self._gel = ImplicitGel(
                body_of(s.gel),
                skin,
                material_of(s.material),
                contact=s.contact,
                solver=s.solver,
                indenter=indenter,
                bond=bond_of(s.gel),
            )
        elif gel.contact.indenter is not indenter:
            gel.set_indenter(indenter)
        gel.reset()
        return gel

    def predict(self, press: Press, indenter: Indenter, skin: SkinMesh) -> Prediction:
        """Return skin and force at the poses of a press, one after the other from rest.

        Raises:
            SolveError: a pose presses too deep, or the gel could not be solved.
        """
        gel = self.prepare(indenter, skin)
        found = follow(
            lambda pose, dt_s: gel.step([pose], dt_s)[0],
            press.poses,
            press.stamp_s,
            longest_step_s=self._longest_step_s,
        )
        return Prediction(found.skin_position_m, found.force_n)
