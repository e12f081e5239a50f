# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gels of one batch, moved and judged as the implicit gel is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.gel.batched.gel import BatchedGel
from dotsim_ros.gel.batched.memory import Grid
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import follow


@dataclass(frozen=True)
class OneState:
    """What is judged of a gel after a step, as `GelState` has it, and how far the last step of the
    iteration moved any node: infinite where the gel could not follow its indenter."""

    skin_position_m: FloatArray
    wrench: Wrench
    max_penetration_m: float
    converged: bool
    left_m: float


class GelsOfBatch:
    """One batch of gels, each as `ImplicitGel` gives its own.

    Args:
        specification: of the sensor.
        grid: of the gels.
        indenters: the rigid shape of each.
        skin: whose vertices are the markers; None for the sensor's own.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        grid: Grid,
        indenters: Sequence[Indenter],
        skin: SkinMesh | None = None,
    ) -> None:
        self._gel = BatchedGel(specification, indenters, len(indenters), grid=grid, skin=skin)
        self.reset, self.set_indenters = self._gel.reset, self._gel.set_indenters

    def step(self, poses: Sequence[Pose], dt_s: float) -> list[OneState]:
        """Move each indenter to its pose."""
        state = self._gel.step(
            np.array([pose.position_m for pose in poses]),
            np.array([pose.quaternion_xyzw for pose in poses]),
            dt_s,
        )
        skin_m = state.skin_position_m.double().numpy()
        force_n, torque_nm = state.force_n.double().numpy(), state.torque_nm.double().numpy()
        return [
            OneState(
                skin_m[b],
                Wrench(force_n[b], torque_nm[b]),
                float(state.max_penetration_m[b]),
                left_m < self._gel.effort.tolerance_m,
                left_m,
            )
            for b, left_m in enumerate(state.left_m.tolist())
        ]


class BatchedModel:
    """The batched gel on the measured skin, from pose to pose.

    Args:
        specification: of the sensor; the spacing of its own skin plays no part.
        grid: of the gel.
    """

    def __init__(self, specification: SensorSpecification, grid: Grid) -> None:
        self.specification, self.name = specification, f"batched, {grid}"
        self._grid = grid
        self._gel: GelsOfBatch | None = None
        self._skin: SkinMesh | None = None

    def predict(self, press: Press, indenter: Indenter, skin: SkinMesh) -> Prediction:
        """Return skin and force at the poses of a press, one after the other from rest.

        Raises:
            SolveError: the gel could not be solved.
        """
        if self._gel is None or self._skin is not skin:
            self._gel = GelsOfBatch(self.specification, self._grid, [indenter], skin)
            self._skin = skin
        gel = self._gel
        # At rest too.
        gel.set_indenters(indenter)

        def step(pose: Pose, dt_s: float) -> OneState:
            [state] = gel.step([pose], dt_s)
            if not np.isfinite(state.left_m):
                raise ValueError("the gel could not follow its indenter")
            return state

        found = follow(step, press.poses, press.stamp_s)
        return Prediction(found.skin_position_m, found.force_n)
