# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The state of one gel carried to another that differs in its grid alone.

Friction remembers where each marker of the skin stuck, so a gel that is merely pressed at the same
pose has another skin than one that was slid there. Both gels have the same markers: their contact
is carried as it is. The displacement is fitted to the other grid, and the equilibrium found there.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from dotsim_ros.gel.discretization import interpolation_at
from dotsim_ros.gel.implicit.gel import ImplicitGel, World
from dotsim_ros.io.arrays import FloatArray

SETTLE_ITERATIONS = 15
SETTLE_TOLERANCE_M = 10.0e-6
SETTLE_S = 1.0
"""The duration of the step that finds the equilibrium; a gel without memory does not know it."""


class SkinJumpError(ValueError):
    """The skin would jump too far; the gel that the state was to be taken from is as it was.

    Attributes:
        jump_m: how far; infinite where no equilibrium was found.
    """

    def __init__(self, jump_m: float, largest_m: float) -> None:
        found = f"by {1e3 * jump_m:.2f} mm" if math.isfinite(jump_m) else "to no equilibrium"
        super().__init__(f"the skin would jump {found}, expected at most {1e3 * largest_m:.2f} mm")
        self.jump_m = jump_m


class Handover:
    """Carries the state of one gel to another of the same shape, skin, material and indenter.

    Args:
        source: the gel whose state is taken.
        target: the gel that goes on with it.

    Raises:
        ValueError: a gel remembers more than its contact, or holds more than one world.
    """

    def __init__(self, source: ImplicitGel, target: ImplicitGel) -> None:
        for gel in (source, target):
            if gel.remembers or gel.environment_count != 1:
                raise ValueError(
                    "only a single gel without relaxation and inertia can be handed over"
                )
        self._source, self._target = source, target
        to = target.discretization
        interpolation, _, _ = interpolation_at(source.discretization, to.particle_position_m)
        # A particle in a sliver that the source's grid does not reach takes no part in the fit.
        covered = np.all(interpolation.node_index >= 0, axis=1)
        volume_m3 = np.where(covered, to.particle_volume_m3, 0.0)
        known = replace(interpolation, node_index=np.maximum(interpolation.node_index, 0))
        weight = to.particle_interpolation.matrix(to.node_count)
        self._project = (
            weight.T @ sparse.diags(volume_m3) @ known.matrix(source.discretization.node_count)
        ).tocsr()
        smooth = to.ghost * to.spacing_m**3
        self._fit = linalg.splu((weight.T @ sparse.diags(volume_m3) @ weight + smooth).tocsc())

    def fitted(self, displacement_m: FloatArray) -> FloatArray:
        """Return the displacements (M, 3) of the target's nodes that are nearest to the source's
        (N, 3), in the mean over the gel."""
        fitted: FloatArray = self._fit.solve(self._project @ displacement_m)
        return fitted

    def carry(self, *, largest_jump_m: float) -> float:
        """Bring the target to the state of the source; return how far a marker's place differs.

        Args:
            largest_jump_m: the most that is allowed.

        Raises:
            SkinJumpError: a marker would jump farther; the source is as it was.
        """
        before = self._source.worlds[0]
        if before.pose is None or before.history is None:
            self._target.reset()
            self._target.worlds[0].pose = before.pose
            return 0.0
        self._target.worlds = [self._carried(before)]
        jump_m = self._settle(before)
        if jump_m > largest_jump_m:
            raise SkinJumpError(jump_m, largest_jump_m)
        return jump_m

    def _carried(self, before: World) -> World:
        assert before.history is not None
        history = replace(
            before.history,
            local_position_m=before.history.local_position_m.copy(),
            slip_m=before.history.slip_m.copy(),
            pressure_pa=before.history.pressure_pa.copy(),
        )
        displacement_m = self.fitted(before.displacement_m)
        return World(
            displacement_m,
            np.zeros_like(displacement_m),
            before.marker_force_n.copy(),
            before.skin_position_m.copy(),
            pose=before.pose,
            history=history,
        )

    def _settle(self, before: World) -> float:
        """Find the target's equilibrium under the held indenter; return the skin's jump, infinite
        where there is none."""
        target = self._target
        own = target.solver
        target.solver = replace(
            own,
            iterations=max(own.iterations, SETTLE_ITERATIONS),
            tolerance_m=min(own.tolerance_m, SETTLE_TOLERANCE_M),
        )
        try:
            state = target.step([before.pose], SETTLE_S)[0]
        except np.linalg.LinAlgError:
            return math.inf
        finally:
            target.solver = own
        if not (state.converged and np.all(np.isfinite(state.skin_position_m))):
            return math.inf
        # The next motion begins with the last one of the source, as if there had been no change.
        if before.last_change is not None:
            target.worlds[0].last_change = replace(
                before.last_change, displacement_m=self.fitted(before.last_change.displacement_m)
            )
        moved = np.linalg.norm(state.skin_position_m - before.skin_position_m, axis=1)
        return float(moved.max())
