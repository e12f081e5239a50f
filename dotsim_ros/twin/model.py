"""This package's implicit gel as a model of measured presses."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.make import body_of, material_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.measured.presses import Prediction, Press
from dotsim_ros.specification import SensorSpecification

FIRST_STEP_S = 0.1
"""Duration of the way to the first pose, which no stamp tells."""


def steps(press: Press, *, longest_step_s: float = np.inf) -> Iterator[tuple[Pose, float, bool]]:
    """Yield (pose, duration in seconds, whether it ends a frame) along a press.

    One step leads to the first frame; what lies between two frames is divided evenly.

    Args:
        press: its poses and stamps.
        longest_step_s: no step is longer.
    """
    yield press.poses[0], min(FIRST_STEP_S, longest_step_s), True
    for (start, end), (before_s, after_s) in zip(
        pairwise(press.poses), pairwise(press.stamp_s.tolist()), strict=True
    ):
        # A share of a step too long is rounding, not another step.
        count = max(1, int(np.ceil((after_s - before_s) / longest_step_s - 1e-9)))
        for part in range(1, count + 1):
            pose = end if part == count else interpolate(start, end, part / count)
            yield pose, (after_s - before_s) / count, part == count


class ImplicitModel:
    """The implicit gel on the measured skin, from pose to pose.

    Args:
        specification: of the sensor; the spacing of its own skin plays no part.
        name: how tables call it.
        longest_step_s: steps between two frames are no longer; the gel itself takes substeps.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        *,
        name: str = "ours",
        longest_step_s: float = np.inf,
    ) -> None:
        self.specification, self.name = specification, name
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
            )
        elif gel.contact.indenter is not indenter:
            gel.set_indenter(indenter)
        gel.reset()
        return gel

    def predict(self, press: Press, indenter: Indenter, skin: SkinMesh) -> Prediction:
        """Return skin and force at the poses of a press, one after the other from rest.

        Raises:
            ValueError: a pose presses too deep, or the gel could not be solved.
        """
        gel = self.prepare(indenter, skin)
        position, force = [], []
        for pose, dt_s, ends_frame in steps(press, longest_step_s=self._longest_step_s):
            state = gel.step([pose], dt_s)[0]
            if ends_frame:
                position.append(state.skin_position_m)
                force.append(state.wrench.force_n)
        return Prediction(np.stack(position), np.stack(force))
