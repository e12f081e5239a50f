# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A bed of springs that stands for the gel, so that a whole search takes seconds: normal and
tangential springs below each marker, friction, stiffening and relaxation."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np

from dotsim_ros.effects.simulate import EffectSolver
from dotsim_ros.geometry.pose import compose, inverse
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SimulatedPress
from dotsim_ros.twin.solver import SolveRequest

STEP_M = 1e-6
NEIGHBOURHOOD_M = 3e-3
SHEAR = 1.2
"""Of the tangential springs over the normal ones."""


class SpringGel:
    """Solves presses on a skin, as `dotsim_ros.twin.solver.PressSolver` does."""

    solve_count = 0
    _kept: ClassVar[dict[Hashable, SimulatedPress]] = {}

    def __init__(self, skin: SkinMesh) -> None:
        self._skin = skin

    def prepare(self, requests: Sequence[SolveRequest], progress: Any = None) -> None:
        """Prepare nothing."""

    def work_of(self, requests: Sequence[SolveRequest]) -> int:
        """Return their number."""
        return len(requests)

    def run_each(
        self, requests: Sequence[SolveRequest], progress: Any = None
    ) -> list[SimulatedPress]:
        """Return skin and force of each."""
        return [self._kept_press(request) for request in requests]

    def _kept_press(self, request: SolveRequest) -> SimulatedPress:
        way = [(p.position_m.tobytes(), p.quaternion_xyzw.tobytes()) for p in request.poses]
        own = (request.relaxation.shares, request.relaxation.times_s)
        key = (self._skin.vertex_count, request.name, request.values, own, *way)
        if key not in self._kept:
            self._kept[key] = self._press(request)
        return self._kept[key]

    def _press(self, request: SolveRequest) -> SimulatedPress:
        rest_m, area_m2 = self._skin.rest_position_m, self._skin.rest_area_m2
        v, relaxation = request.values, request.relaxation
        stiffness = (
            4.0 * v.youngs_modulus_pa / v.thickness_m / (4.0 * (1.0 - v.poisson_ratio) - 1.0)
        )
        shares = np.array(relaxation.shares)[:, None]
        times_s = np.array(relaxation.times_s)[:, None]
        slip_m = np.zeros_like(rest_m)
        faded = np.zeros((len(shares), len(rest_m)))
        skins, forces = [], []
        before, before_s, pressure_before = request.poses[0], float(request.stamp_s[0]), 0.0
        for pose, stamp_s in zip(request.poses, request.stamp_s.tolist(), strict=True):
            depth_m = np.maximum(-request.indenter.distance_from(rest_m, pose), 0.0)
            touched = np.flatnonzero(depth_m)
            away = np.zeros_like(rest_m)
            away[touched] = np.transpose(
                [
                    request.indenter.distance_from(rest_m[touched] + step, pose)
                    - request.indenter.distance_from(rest_m[touched] - step, pose)
                    for step in STEP_M * np.eye(3)
                ]
            )
            away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
            pressed = stiffness * depth_m * (1.0 + 8.0 * v.c20_ratio * depth_m / v.thickness_m)
            share = 1.0 - np.exp(-(stamp_s - before_s) / times_s)
            faded += share * (0.5 * (pressed + pressure_before) - faded)
            pressure = np.maximum(pressed - (shares * faded).sum(axis=0), 0.0)
            moved_m = compose(pose, inverse(before)).apply(rest_m) - rest_m
            slip_m += moved_m - np.sum(moved_m * away, axis=1, keepdims=True) * away
            limit_m = v.friction * pressure / (SHEAR * stiffness)
            length_m = np.maximum(np.linalg.norm(slip_m, axis=1), 1e-12)
            slip_m *= np.minimum(limit_m / length_m, 1.0)[:, None]
            on_skin = pressure[:, None] * away + SHEAR * stiffness * slip_m
            forces.append(-(area_m2[:, None] * on_skin).sum(axis=0))
            skins.append(rest_m + depth_m[:, None] * away + slip_m + self._bulge(depth_m, v))
            before, before_s, pressure_before = pose, stamp_s, pressed
        return SimulatedPress(np.stack(skins), np.stack(forces), converged=True)

    def _bulge(self, depth_m: np.ndarray, v: Any) -> np.ndarray:
        """Return how far (V, 3) the free skin stands out: in proportion to Poisson's ratio."""
        rest_m = self._skin.rest_position_m
        inside = depth_m > 0.0
        if not inside.any():
            return np.zeros_like(rest_m)
        middle_m = np.average(rest_m[inside], axis=0, weights=depth_m[inside])
        near = np.exp(
            -np.sum((rest_m - middle_m) ** 2, axis=1) / (2.0 * (2.0 * NEIGHBOURHOOD_M) ** 2)
        )
        height_m = (
            0.5 * (v.poisson_ratio - 0.3) * depth_m.max() * near * ~inside * ~self._skin.on_base
        )
        outward = rest_m / np.linalg.norm(rest_m, axis=1, keepdims=True)
        return height_m[:, None] * outward


@contextmanager
def open_spring_gel(
    specification: SensorSpecification, skin: SkinMesh, *_: Any, **__: Any
) -> Iterator[EffectSolver]:
    """Open a solver of requests on springs, in place of `effects.simulate.open_solver`."""
    yield EffectSolver(SpringGel(skin), specification, skin)  # type: ignore[arg-type]
