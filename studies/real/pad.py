# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The force of a pad under a ball, tabulated over what is not known of it.

The table is this package's gel: a flat pad on a rigid base, neo-Hookean, solved at some Poisson's
ratios and coefficients of friction. What acts outside of the gel is worked out from it: a support
that gives way along the force, and a zero of depth that is off. A stiffening law changes the
logarithm of the force by a column of its own, taken at one ratio and one friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from dotsim_ros.data.importers.gelsight_mini_force import PAD_SIZE_M
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.values import GelValues, values_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.cache import PHYSICS, content_key, load_arrays, store_arrays
from dotsim_ros.io.documents import ArrayForm
from dotsim_ros.specification import (
    ContactSpecification,
    GelSpecification,
    MaterialSpecification,
    SensorSpecification,
    SolverSpecification,
)
from dotsim_ros.twin.simulator import REFERENCE_MODULUS_PA, TABLE_SPACING, GelSimulator

SENSOR = SensorSpecification(
    name="gelsight_mini_pad",
    gel=GelSpecification(shape="flat_pad", pad_size_m=PAD_SIZE_M),
    material=MaterialSpecification(youngs_modulus_pa=REFERENCE_MODULUS_PA, poisson_ratio=0.49),
    contact=ContactSpecification(friction_coefficient=1.0),
    solver=SolverSpecification(grid_spacing_m=PAD_SIZE_M[2] / 3.0),
)
"""Three cells in the thickness, refined: 2 % from CalculiX, with two it is 4 %."""
COMPRESSIBILITY = TABLE_SPACING * np.array([-11.0, -9.0, -7.0, -5.0])
"""log(1/2 - nu) of the table: nu from 0.418 to 0.496, where the gel has its own tables."""
FRICTION = np.array([0.0, 0.1, 0.3, 1.0])
DEPTH_M = 1e-3 * np.array([0.3, 0.4, 0.5, 0.625, 0.75, 0.875, 1.0, 1.25, 1.5, 1.75, 2.0, 2.15])
CLEARANCE_M = 0.1e-3
STIFFENING_STEP = 0.03
"""C20 over C10 of the column of stiffening."""
FRAME_S = 0.1
SUPPORT_ROUNDS = 30
"""Of the force on a support that gives way: each is closer by what the support takes of the depth,
a fifth at most."""
LARGEST_CHANGE = 1.6
"""Between two rounds; it only bounds what is far from an answer."""


@dataclass(frozen=True)
class PadState:
    """What is not known of a press, N at once or one.

    Attributes:
        compressibility: log(1/2 - nu).
        friction: of the ball on the pad.
        support_m_n: what holds the pad, and the ball, gives way by so much a newton.
        zero_m: the pad is touched so much before the depth that counts as 0.
        stiffening: Yeoh's C20 over C10.
    """

    compressibility: FloatArray | float = float(np.log(0.01))
    friction: FloatArray | float = 1.0
    support_m_n: FloatArray | float = 0.0
    zero_m: FloatArray | float = 0.0
    stiffening: FloatArray | float = 0.0

    @property
    def poisson_ratio(self) -> FloatArray:
        """nu."""
        return np.asarray(0.5 - np.exp(self.compressibility))


@dataclass(frozen=True)
class PadTable:
    """Logarithms of the force, N, with a Young's modulus of `REFERENCE_MODULUS_PA`.

    Attributes:
        log_force: (C, F, D) over `COMPRESSIBILITY`, `FRICTION` and `DEPTH_M`.
        stiffening: (D,) change of it by C20 of one C10.
    """

    log_force: FloatArray
    stiffening: FloatArray

    @cached_property
    def _at(self) -> RegularGridInterpolator:
        axes = (COMPRESSIBILITY, FRICTION, np.log(DEPTH_M))
        return RegularGridInterpolator(axes, self.log_force, bounds_error=False, fill_value=None)

    def log_force_at(self, state: PadState, depth_m: FloatArray) -> FloatArray:
        """Return log of the force at depths into the gel itself, broadcast with the state."""
        log_depth = np.log(np.maximum(depth_m, 1e-5))
        point = np.broadcast_arrays(state.compressibility, state.friction, log_depth)
        column = np.interp(log_depth, np.log(DEPTH_M), self.stiffening)
        return np.asarray(self._at(np.stack(point, axis=-1)) + state.stiffening * column)

    def depth_inside_m(self, state: PadState, depth_m: float, force_n: FloatArray) -> FloatArray:
        """Return the depth into the gel at a depth and a force that were recorded."""
        return np.asarray(depth_m + state.zero_m - state.support_m_n * force_n)

    def force_n(self, state: PadState, log_scale: FloatArray, depth_m: float) -> FloatArray:
        """Return the force at a recorded depth.

        Args:
            state: N of what is not known.
            log_scale: (N,) log of Young's modulus over the table's.
            depth_m: as recorded.
        """
        free = replace(state, support_m_n=0.0)
        depth = self.depth_inside_m(free, depth_m, np.zeros_like(log_scale))
        force = np.exp(log_scale + self.log_force_at(state, depth))
        for _ in range(SUPPORT_ROUNDS):
            inside = self.depth_inside_m(state, depth_m, force)
            found = np.exp(log_scale + self.log_force_at(state, inside))
            # A mean of two rounds: a soft support would let them swing.
            force = np.clip(np.sqrt(found * force), force / LARGEST_CHANGE, force * LARGEST_CHANGE)
        return np.asarray(force)


def poses_at(depth_m: FloatArray) -> list[Pose]:
    """Return the ball above the pad's middle, and then at depths (D,)."""
    heights = PAD_SIZE_M[2] - np.array([-CLEARANCE_M, *depth_m])
    return [Pose(np.array([0.0, 0.0, height])) for height in heights]


def gel_values(state: PadState) -> GelValues:
    """Return the gel of one state, with the table's Young's modulus."""
    return replace(
        values_of(SENSOR),
        poisson_ratio=float(state.poisson_ratio),
        friction=float(state.friction),
        c20_ratio=float(state.stiffening),
    )


class PadSolves:
    """Presses of the pad, each solved once: one that the same code has solved before is read.

    Args:
        folder: of the solves, which is made where it is missing.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._simulator = GelSimulator(SENSOR, skin_of(SENSOR.gel))

    def force_n(self, state: PadState, indenter: Indenter, poses: list[Pose]) -> FloatArray:
        """Return the force (F, 3) at the poses, with the table's Young's modulus and a rigid base.

        Raises:
            SolveError: the gel cannot be solved there.
            ValueError: a solve did not meet its tolerance.
        """
        values = gel_values(state)
        where = [(pose.position_m, pose.quaternion_xyzw) for pose in poses]
        key = content_key(
            (*PHYSICS, "../studies/real"), replace(SENSOR, name=""), values, indenter, where
        )
        path = self._folder / f"{key}.npz"
        known = load_arrays(path, {"force_n": ArrayForm((len(poses), 3))})
        if known is None:
            known = {"force_n": self._solved(state, indenter, poses)}
            self._folder.mkdir(parents=True, exist_ok=True)
            store_arrays(path, known)
        return known["force_n"]

    def _solved(self, state: PadState, indenter: Indenter, poses: list[Pose]) -> FloatArray:
        stamp_s = FRAME_S * np.arange(len(poses), dtype=np.float64)
        found = self._simulator.press(gel_values(state), indenter, poses, stamp_s)
        if not found.converged:
            name = indenter.name or indenter.kind
            raise ValueError(f"{name}: the gel did not converge at {state}")
        return found.force_n


def pad_table(solves: PadSolves, indenter: Indenter) -> PadTable:
    """Solve the table; minutes, where it was not solved before.

    Args:
        solves: of the pad.
        indenter: the ball.

    Raises:
        SolveError, ValueError: as `PadSolves.force_n`.
    """
    poses = poses_at(DEPTH_M)

    def column(state: PadState) -> FloatArray:
        return np.log(solves.force_n(state, indenter, poses)[1:, 2])

    log_force = np.empty((len(COMPRESSIBILITY), len(FRICTION), len(DEPTH_M)))
    for i, compressibility in enumerate(COMPRESSIBILITY.tolist()):
        for j, friction in enumerate(FRICTION.tolist()):
            state = PadState(compressibility, friction)
            print(f"pad: nu {float(state.poisson_ratio):.3f}, friction {friction:g}")
            log_force[i, j] = column(state)
    base = PadState(float(COMPRESSIBILITY[1]), float(FRICTION[2]))
    up, down = (column(replace(base, stiffening=sign * STIFFENING_STEP)) for sign in (1.0, -1.0))
    return PadTable(log_force, (up - down) / (2.0 * STIFFENING_STEP))
