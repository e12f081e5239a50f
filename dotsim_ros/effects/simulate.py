# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Simulates recordings with effects: what each does to pose, gel, skin and force around a solve."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.recording import Recording
from dotsim_ros.effects.effect import (
    Active,
    GelTerm,
    Response,
    gel_with,
    motion_filters,
    response_filters,
)
from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.values import GelValues
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.worker_pool.pool import Crew
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SimulatedPress, SolveError
from dotsim_ros.twin.solver import PressSolver, Progress, SolveRequest, open_press_solver


@dataclass(frozen=True)
class EffectRequest:
    """A recording to simulate, with a gel, a shift (3,) of all poses in the base frame, and the
    effects at work."""

    recording: Recording
    values: GelValues
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    effects: Sequence[Active] = ()


class EffectSolver:
    """Simulates requests; use `open_solver`."""

    def __init__(
        self, presses: PressSolver, specification: SensorSpecification, skin: SkinMesh
    ) -> None:
        self._presses = presses
        self._rest_m = skin.rest_position_m
        material = specification.material
        self._relaxation = PronySeries(material.prony_shares, material.prony_times_s)
        self._asked: set[tuple[Any, ...]] = set()

    @property
    def asked_count(self) -> int:
        """Solves that were asked for, those included that were on disk; each counts once."""
        return len(self._asked)

    @property
    def solve_count(self) -> int:
        """Recordings that were solved, not taken from disk."""
        return self._presses.solve_count

    def prepare(self, requests: Sequence[EffectRequest], progress: Progress | None = None) -> None:
        """Make what the gels of the requests need, once for all; see `PressSolver.prepare`."""
        self._presses.prepare([self._solve_request(r) for r in requests], progress)

    def work_of(self, requests: Sequence[EffectRequest]) -> int:
        """Return how much of the requests is to be solved, as `Progress` counts it."""
        return self._presses.work_of([self._solve_request(r) for r in requests])

    def run(
        self, requests: Sequence[EffectRequest], progress: Progress | None = None
    ) -> list[SimulatedPress]:
        """Return skins and forces of the requests, all effects on skin and force included.

        Raises:
            SolveError: the gel of one could not be solved; the text names it.
        """
        results, failures = self.run_each(requests, progress)
        if failures:
            raise SolveError(failures[0])
        return [result for result in results if result is not None]

    def run_each(
        self, requests: Sequence[EffectRequest], progress: Progress | None = None
    ) -> tuple[list[SimulatedPress | None], list[str]]:
        """Return as `run`, None for those that could not be solved, and why not."""
        self._asked |= {_solved_of(request) for request in requests}
        solved = self._presses.run_each([self._solve_request(r) for r in requests], progress)
        results: list[SimulatedPress | None] = []
        failures = []
        for request, found in zip(requests, solved, strict=True):
            if isinstance(found, str):
                failures.append(f"{request.recording.name}: {found}")
                results.append(None)
            else:
                results.append(self._answered(request, found))
        return results, failures

    def _solve_request(self, request: EffectRequest) -> SolveRequest:
        """Return what is to be solved: the gel and the poses as the effects make them."""
        recording, press, effects = request.recording, request.recording.press, request.effects
        own = GelTerm(request.values, self._relaxation.shares, self._relaxation.times_s)
        term = gel_with(effects, own, recording)
        filtered = motion_filters(effects)
        shift = np.array(request.shift_m)
        poses = []
        for frame, pose in enumerate(press.poses):
            force = np.zeros(3) if press.force_n is None else press.force_n[frame]
            moved = Pose(pose.position_m + shift, pose.quaternion_xyzw)
            poses.append(filtered(float(press.stamp_s[frame]), moved, force))
        return SolveRequest(
            recording.name,
            recording.indenter,
            tuple(poses),
            press.stamp_s,
            term.values,
            PronySeries(term.prony_shares, term.prony_times_s),
        )

    def _answered(self, request: EffectRequest, found: SimulatedPress) -> SimulatedPress:
        """Return what is measured of a solved gel."""
        if not any(active.effect.response for active in request.effects):
            return found
        filtered = response_filters(request.effects)
        recording = request.recording
        begun_s = float(recording.press.stamp_s[0])
        answers = [
            filtered(
                Response(
                    stamp_s=float(stamp),
                    session_s=recording.session_s + float(stamp) - begun_s,
                    pose=pose,
                    depth_m=float(depth),
                    rest_position_m=self._rest_m,
                    skin_position_m=skin,
                    force_n=load,
                )
            )
            for stamp, pose, depth, skin, load in zip(
                recording.press.stamp_s,
                recording.press.poses,
                recording.depth_m,
                found.skin_position_m,
                found.force_n,
                strict=True,
            )
        ]
        return SimulatedPress(
            np.stack([answer.skin_position_m for answer in answers]),
            np.stack([answer.force_n for answer in answers]),
            found.converged,
        )


def _solved_of(request: EffectRequest) -> tuple[Any, ...]:
    """Return what requests of one solve have in common."""
    effects = [
        (active.effect.name, tuple(sorted(active.values.items())))
        for active in request.effects
        if active.effect.needs_solve
    ]
    return request.recording.name, request.values, request.shift_m, *effects


@contextmanager
def open_solver(
    specification: SensorSpecification, skin: SkinMesh, directory: Path, *, workers: Crew
) -> Iterator[EffectSolver]:
    """Open a pool of workers that each hold the sensor's gel and keep their solves in a
    directory."""
    with open_press_solver(specification, skin, directory, workers=workers) as presses:
        yield EffectSolver(presses, specification, skin)
