# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Records an implicit gel's steps, settled to rounding, for the adjoint to go back through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.adjoint.differentiable_contact import MarkerContact
from dotsim_ros.gel.adjoint.equilibrium import Candidates, fine_part, settle
from dotsim_ros.gel.implicit.contact import Lag
from dotsim_ros.gel.implicit.gel import GelState, ImplicitGel, Inertia, World
from dotsim_ros.gel.implicit.newton import Point
from dotsim_ros.gel.implicit.relaxation import StressMemory
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, IndexArray
from dotsim_ros.io.cores import single_threaded


@dataclass(frozen=True)
class ContactRecord:
    """The contact at the end of a substep.

    Attributes:
        pose: of the indenter.
        marker: (A,) numbers of the markers in contact.
        area_m2: (A,) for which they bear.
        bearer: (V,) which marker bears what presses on each of the skin.
        memory_m: (A, 3) their slip minus position at the end of the substep before, in the
            indenter's frame.
        is_fresh: whether the indenter came near only in this substep, so that the memory is minus
            the position, at this pose, of the skin before it.
    """

    pose: Pose
    marker: IndexArray
    area_m2: FloatArray
    bearer: IndexArray
    memory_m: FloatArray
    is_fresh: bool


@dataclass(frozen=True)
class Substep:
    """What the adjoint needs of a substep.

    Attributes:
        dt_s: its duration.
        displacement_m: (N, 3) of the nodes at its end.
        skin_position_m: (V, 3) at its end.
        skin_before_m: (V, 3) at its start.
        contact: None if the indenter was away.
        relaxation: what relaxation remembered at its start.
        inertia: None if quasi-static.
    """

    dt_s: float
    displacement_m: FloatArray
    skin_position_m: FloatArray
    skin_before_m: FloatArray
    contact: ContactRecord | None
    relaxation: StressMemory
    inertia: Inertia | None


@dataclass
class GelTrajectory:
    """The substeps of one environment since the recorder was made.

    Attributes:
        substeps: in the order of time.
        step_end: for each step, how many substeps had been recorded at its end.
        is_at_rest: for each step, whether the gel came to rest exactly in its last substep, which
            is not recorded then.
    """

    substeps: list[Substep] = field(default_factory=list)
    step_end: list[int] = field(default_factory=list)
    is_at_rest: list[bool] = field(default_factory=list)


class Recorder:
    """Steps a gel and keeps what its adjoint needs.

    Every substep is solved to rounding, with friction limited by the current pressure: about five
    times as slow as a plain step. Begin with a pose outside the gel: the way that the gel itself
    chooses to a first pose inside depends on the skin's size, which derivatives leave out.

    Args:
        gel: is reset, and from then on to be stepped by `step` of this recorder alone.

    Raises:
        ValueError: a gel that has come off its core, whose derivatives are not implemented.
    """

    def __init__(self, gel: ImplicitGel) -> None:
        if gel.body.lost_bond is not None:
            raise ValueError(
                "the gel has come off its core, expected one that is bonded everywhere: there are "
                "no derivatives of a loose bond; set gel.bond_slip_share to 0"
            )
        gel.reset()
        self.gel = gel
        self.trajectories = [GelTrajectory() for _ in range(gel.environment_count)]

    @single_threaded()
    def step(self, poses: Sequence[Pose | None], dt_s: float) -> list[GelState]:
        """Step the gel as `ImplicitGel.step` does.

        Raises:
            NoEquilibriumError: a substep did not settle; the gel is left as it was in it.
            PressTooDeepError, ValueError: as `ImplicitGel.step`.
        """
        gel = self.gel
        gel.observer = self._observe
        try:
            states = gel.step(poses, dt_s)
        finally:
            gel.observer = None
        for trajectory, world in zip(self.trajectories, gel.worlds, strict=True):
            trajectory.step_end.append(len(trajectory.substeps))
            trajectory.is_at_rest.append(not gel.remembers and world.response is None)
        return states

    def _observe(
        self,
        world: World,
        pose: Pose | None,
        point: Point,
        inertia: Inertia | None,
        dt_s: float,
        environment: int,
    ) -> Point:
        gel = self.gel

        forces = partial(elastic_forces, gel, inertia, environment)
        candidates = None
        if pose is not None and world.patch is not None and world.history is not None:
            candidates = _candidates(gel, world, pose, point)
        rest = gel.compliance_at_rest
        settled = settle(point.displacement_m, rest, forces, candidates)
        displacement = settled.displacement_m
        contact, lag = None, _present(np.zeros(0))
        if pose is not None and candidates is not None:
            active = np.flatnonzero(np.any(settled.force_n != 0.0, axis=1))
            marker = candidates.marker[active]
            assert world.bearer is not None
            contact = ContactRecord(
                pose,
                marker,
                gel.points.area_m2(world.bearer)[marker],
                world.bearer,
                _memory(world)[marker],
                world.response is None,
            )
            lag = _present(settled.pressure_pa)
        self.trajectories[environment].substeps.append(
            Substep(
                dt_s,
                displacement,
                gel.skin_at(displacement, world.patch, settled.force_n),
                world.skin_position_m,
                contact,
                gel._relaxation[environment].memory(gel.discretization.particle_count),
                inertia,
            )
        )
        problem = gel._problem(world, pose, inertia, environment)
        return problem.at(displacement, settled.force_n, lag)


def _present(pressure_pa: FloatArray) -> Lag:
    """Return what friction needs to use these pressures (C,) and the present normals."""
    return Lag(pressure_pa, np.zeros((len(pressure_pa), 3)))


def elastic_forces(
    gel: ImplicitGel, inertia: Inertia | None, environment: int, displacement_m: FloatArray
) -> FloatArray:
    """Return the nodal forces (N, 3) of elasticity and inertia at displacements (N, 3)."""
    return gel.elastic(displacement_m, inertia, environment)[1]


def _memory(world: World) -> FloatArray:
    """Return slip minus position (V, 3) at the end of the last substep, indenter's frame."""
    assert world.history is not None
    return world.history.slip_m - world.history.local_position_m


def _candidates(gel: ImplicitGel, world: World, pose: Pose, point: Point) -> Candidates:
    assert world.patch is not None
    assert world.bearer is not None
    marker = world.patch.marker
    memory = _memory(world)[marker]
    area = gel.points.area_m2(world.bearer)[marker]

    def respond(rows: NDArray[np.int64], position_m: FloatArray) -> MarkerContact:
        return MarkerContact(gel.contact, area[rows], position_m, pose, memory[rows])

    return Candidates(
        marker,
        gel.skin.rest_position_m[marker],
        gel.skin_at(point.displacement_m, world.patch, point.force_n)[marker],
        gel.skin_weight[marker],
        None if gel.refinement is None else fine_part(gel.refinement, marker),
        respond,
    )
