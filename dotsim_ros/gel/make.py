# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel that a specification asks for: its shape, its skin, its law, and what solves it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from dotsim_ros.gel.body import Body, Dome, Pad
from dotsim_ros.gel.bond import LooseBond
from dotsim_ros.gel.explicit.gel import ExplicitGel, ExplicitSettings
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.material import NeoHookean, law_of, material_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin, pad_skin
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import GelSpecification, SensorSpecification

__all__ = [
    "Gel",
    "GelFrame",
    "SingleExplicitGel",
    "SingleImplicitGel",
    "body_of",
    "bond_of",
    "law_of",
    "make_gel",
    "make_gel_batch",
    "material_of",
    "skin_of",
]


@dataclass(frozen=True)
class GelFrame:
    """The gel after a step; attributes as those of `Frame`.

    Attributes:
        skin_position_m: (V, 3) skin markers, base frame.
        wrench: of the gel on the indenter.
        max_penetration_m: largest penetration of a marker into the indenter.
        converged: whether the gel's solver expects to be within its tolerance of an equilibrium,
            on the skin and in the force: docs/gel.md.
        timings_s: seconds spent on contact and solve.
        time_s: simulated time since the last reset.
    """

    skin_position_m: FloatArray
    wrench: Wrench
    max_penetration_m: float
    converged: bool
    timings_s: dict[str, float]
    time_s: float = 0.0


class Gel(Protocol):
    """A gel with one indenter, whatever solves it."""

    def step(self, pose: Pose | None, dt_s: float) -> GelFrame:
        """Move the indenter to a pose and find the gel."""

    def place(self, pose: Pose) -> None:
        """Put the indenter where it touches nothing, without a way there."""

    def reset(self) -> None:
        """Return to rest."""

    def set_indenter(self, indenter: Indenter) -> None:
        """Replace the indenter and return to rest."""

    def check_depth(self, pose: Pose) -> None:
        """Refuse a pose that presses too deep by ValueError, without moving there."""

    def wrench_stiffness(self) -> FloatArray:
        """Return minus the derivative (6, 6) of the wrench on the indenter by its twist."""


def body_of(specification: GelSpecification) -> Body:
    """Return the gel's shape."""
    if specification.shape == "dome":
        return Dome(specification.outer_radius_m, specification.core_radius_m)
    return Pad(specification.pad_size_m, curvature_per_m=specification.face_curvature_per_m)


def bond_of(specification: GelSpecification) -> LooseBond | None:
    """Return where the gel has come off its core, None for one that is bonded everywhere."""
    if specification.bond_slip_share == 0.0:
        return None
    return LooseBond(specification.bond_slip_share, *specification.loose_patch_rad)


def skin_of(specification: GelSpecification) -> SkinMesh:
    """Return the gel's skin at rest."""
    if specification.shape == "dome":
        return dome_skin(specification.outer_radius_m, specification.skin_spacing_m)
    return pad_skin(
        specification.pad_size_m,
        specification.skin_spacing_m,
        curvature_per_m=specification.face_curvature_per_m,
    )


class SingleImplicitGel:
    """One environment of an implicit gel as a `Gel`.

    Attributes:
        gel: the implicit one.
    """

    def __init__(self, gel: ImplicitGel) -> None:
        self.gel = gel
        self.reset, self.set_indenter = gel.reset, gel.set_indenter
        self.check_depth = gel.check_depth

    def place(self, pose: Pose) -> None:
        self.gel.place(0, pose)

    def wrench_stiffness(self) -> FloatArray:
        return self.gel.wrench_stiffness(0)

    def step(self, pose: Pose | None, dt_s: float) -> GelFrame:
        state = self.gel.step([pose], dt_s)[0]
        spent = state.timings_s
        contact = spent.pop("contact", 0.0)
        return GelFrame(
            state.skin_position_m,
            state.wrench,
            state.max_penetration_m,
            state.converged,
            {"contact": contact, "solve": sum(spent.values())},
        )


class SingleExplicitGel:
    """One environment of an explicit gel as a `Gel`."""

    def __init__(self, gel: ExplicitGel) -> None:
        self._gel = gel
        self.reset, self.set_indenter, self.place = gel.reset, gel.set_indenter, gel.place

    def check_depth(self, pose: Pose) -> None:
        """Refuse nothing: the explicit gel has no depth that it cannot take."""

    def wrench_stiffness(self) -> FloatArray:
        """Raise, since nothing is linearised here.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            "solver.method is 'explicit', expected 'implicit': the explicit gel has no stiffness "
            "to couple with other dynamics"
        )

    def step(self, pose: Pose | None, dt_s: float) -> GelFrame:
        start = time.perf_counter()
        state = self._gel.step(pose, dt_s)
        return GelFrame(
            state.skin_position_m[0],
            Wrench(state.force_n[0], state.torque_nm[0]),
            float(state.max_penetration_m[0]),
            True,
            {"contact": 0.0, "solve": time.perf_counter() - start},
        )


def make_gel_batch(
    specification: SensorSpecification,
    *,
    indenter: Indenter,
    environment_count: int,
    skin: SkinMesh | None = None,
    device: str = "cpu",
    progress: Callable[[float], None] | None = None,
) -> ImplicitGel:
    """Return independent worlds of one gel, which are solved together.

    Args:
        specification: of the sensor; its camera has no part in it.
        indenter: what presses in all of them.
        environment_count: number of worlds.
        skin: the skin's markers; None for the sensor's own.
        device: Warp's name of the device.
        progress: told the finished share of tables that are computed once and cached.

    Raises:
        ValueError: the specification asks for another method than the implicit one.
    """
    s = specification
    if s.solver.method != "implicit":
        raise ValueError(f"solver.method is {s.solver.method!r}, expected 'implicit' for a batch")
    return ImplicitGel(
        body_of(s.gel),
        skin_of(s.gel) if skin is None else skin,
        material_of(s.material),
        contact=s.contact,
        solver=s.solver,
        indenter=indenter,
        bond=bond_of(s.gel),
        environment_count=environment_count,
        device=device,
        progress=progress,
    )


def make_gel(
    specification: SensorSpecification,
    skin: SkinMesh,
    indenter: Indenter,
    *,
    device: str = "cpu",
    progress: Callable[[float], None] | None = None,
) -> Gel:
    """Return the gel that a specification asks for."""
    s = specification
    if s.solver.method == "implicit":
        return SingleImplicitGel(
            make_gel_batch(
                s,
                indenter=indenter,
                environment_count=1,
                skin=skin,
                device=device,
                progress=progress,
            )
        )
    law = law_of(s.material)
    # The specification takes no other law with this method.
    assert isinstance(law, NeoHookean)
    return SingleExplicitGel(
        ExplicitGel(
            body_of(s.gel),
            skin,
            material=law,
            density_kg_m3=s.material.density_kg_m3,
            friction_coefficient=s.contact.friction_coefficient,
            indenter=indenter,
            settings=ExplicitSettings(spacing_m=s.solver.grid_spacing_m),
            device=device,
        )
    )
