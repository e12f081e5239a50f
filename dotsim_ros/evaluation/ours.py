"""This package's gels as models of measured presses."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from dotsim_ros.evaluation.presses import Prediction, Press
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.geometry.specification import SensorSpecification
from dotsim_ros.sensor import Gel, GelFrame, make_gel

FIRST_STEP_S = 0.1
"""Duration of the way to the first pose, which no stamp tells."""


class GelModel:
    """The gel of a sensor's specification, whatever solves it, on the measured skin.

    Args:
        specification: of the sensor; its skin's spacing plays no part.
        name: how tables call it.
        longest_step_s: what lies between two frames is divided into steps no longer than this.
        device: Warp's name of the device.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        *,
        name: str,
        longest_step_s: float = np.inf,
        device: str = "cpu",
    ) -> None:
        self.specification, self.name = specification, name
        self._longest_step_s, self._device = longest_step_s, device
        self._gel: Gel | None = None
        self._made_for: tuple[SkinMesh, Indenter] | None = None

    def gel(self, indenter: Indenter, skin: SkinMesh) -> Gel:
        """Return the gel at rest with an indenter; building one for another skin takes seconds."""
        if self._gel is None or self._made_for is None or self._made_for[0] is not skin:
            self._gel = make_gel(self.specification, skin, indenter, device=self._device)
        elif self._made_for[1] is not indenter:
            self._gel.set_indenter(indenter)
        self._gel.reset()
        self._made_for = (skin, indenter)
        return self._gel

    def predict(self, press: Press, indenter: Indenter, skin: SkinMesh) -> Prediction:
        """Return skin and force at the poses of a press, one after the other from rest.

        Raises:
            ValueError: a pose presses too deep, or the gel could not be solved.
            RuntimeError: the explicit gel diverged.
        """
        gel = self.gel(indenter, skin)
        frames: list[GelFrame] = []
        for way in steps(press, longest_step_s=self._longest_step_s):
            for pose, dt_s in way:
                frame = gel.step(pose, dt_s)
            frames.append(frame)
        return Prediction(
            np.stack([frame.skin_position_m for frame in frames]),
            np.stack([frame.wrench.force_n for frame in frames]),
        )


def steps(press: Press, *, longest_step_s: float) -> Iterator[list[tuple[Pose, float]]]:
    """Yield, for each frame of a press, the (pose, duration in seconds) of the steps that lead to
    it from the frame before; one step leads to the first."""
    yield [(press.poses[0], min(FIRST_STEP_S, longest_step_s))]
    for (start, end), (before_s, after_s) in zip(
        pairwise(press.poses), pairwise(press.stamp_s.tolist()), strict=True
    ):
        # A share of a step too long is rounding, not another step.
        count = max(1, int(np.ceil((after_s - before_s) / longest_step_s - 1e-9)))
        yield [
            (interpolate(start, end, (k + 1) / count), (after_s - before_s) / count)
            for k in range(count)
        ]
