# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of a loss of skin and wrench by everything that the implicit gel depends on.

Each substep ends at an equilibrium g(u, x; theta) = 0 (see `equilibrium`), and hands on to the next
one the contact's memory, the relaxed stresses and the velocity. Going back through the substeps,
each takes one solve with the transposed exact derivative, A^T lambda = dL/du, and
dL/dtheta = -lambda . dg/dtheta (Giles and Pierce, "An introduction to the adjoint approach to
design", 2000). Warp's tape differentiates the residual.

    recorder = Recorder(gel)
    states = [recorder.step([pose], dt_s) for pose in poses]
    gradient = trajectory_gradient(gel, recorder.trajectories[0], losses)

With a refinement its added compliance counts as 1/E times a constant, unless the derivative by
Poisson's ratio is given; how it varies with the gel's lengths is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from dotsim_ros.gel.adjoint.differentiable_contact import ContactAdjoint
from dotsim_ros.gel.adjoint.gradient import Gradient, LossGradient
from dotsim_ros.gel.adjoint.kernels import adjoint_kernels
from dotsim_ros.gel.adjoint.loaded_contact import LoadedContact
from dotsim_ros.gel.adjoint.recorder import ContactRecord, GelTrajectory, Substep, elastic_forces
from dotsim_ros.gel.adjoint.rest_points import RestPoints, pulled
from dotsim_ros.gel.elasticity import BOND_STIFFNESS, GHOST_PENALTY
from dotsim_ros.gel.implicit.contact import REFERENCE_SPACING_M
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.implicit.refinement import Refinement
from dotsim_ros.gel.implicit.relaxation import StressMemory
from dotsim_ros.gel.reshape import shape_rates
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.cores import single_threaded
from dotsim_ros.io.warp_runtime import wp


@single_threaded()
def trajectory_gradient(
    gel: ImplicitGel,
    trajectory: GelTrajectory,
    loss_gradient: Sequence[LossGradient | None],
    *,
    environment: int = 0,
    by_poisson: Refinement | None = None,
    points: RestPoints | None = None,
) -> Gradient:
    """Return the derivatives of a loss of one environment's recorded steps.

    Args:
        gel: as it was recorded, with the same indenter.
        trajectory: of that environment.
        loss_gradient: for each recorded step; None where the loss does not depend on it.
        environment: which of the gel's.
        by_poisson: `refinement_rate.poisson_rate` of the gel; None leaves out how the refinement
            varies with Poisson's ratio.
        points: of the gel; None to compute them, which takes longer than a substep.

    Raises:
        ValueError: another number of steps than recorded, or a derivative of a wrong shape.
    """
    if len(loss_gradient) != len(trajectory.step_end):
        raise ValueError(
            f"{len(loss_gradient)} loss gradients for {len(trajectory.step_end)} recorded steps"
        )
    shape = gel.skin.rest_position_m.shape
    backward = _Backward(gel, environment, by_poisson, points or RestPoints(gel))
    losses: list[LossGradient | None] = [None] * len(trajectory.substeps)
    for step, loss in enumerate(loss_gradient):
        if loss is None:
            continue
        if loss.skin is not None and loss.skin.shape != shape:
            raise ValueError(f"step {step}: skin has shape {loss.skin.shape}, expected {shape}")
        if trajectory.is_at_rest[step]:
            if loss.skin is not None:
                backward.sums.marker += loss.skin
        else:
            losses[trajectory.step_end[step] - 1] = loss
    for substep, loss in zip(reversed(trajectory.substeps), reversed(losses), strict=True):
        backward.go_back(substep, loss or LossGradient())
    return backward.gradient()


@dataclass
class _Carried:
    """Derivatives by what a substep hands on to the next one."""

    memory: FloatArray
    skin: FloatArray
    displacement: FloatArray
    velocity: FloatArray
    relaxation: StressMemory


@dataclass
class _Sums:
    """Derivatives that add up over the substeps: by the law's constants alone (`coefficients`), by
    the moduli that contact, bond, ghost penalty and refinement are made with (`youngs_modulus`,
    `shear_modulus`, `poisson_ratio`), by the rest positions, volumes and areas of particles,
    markers and bonded points, and by the rest."""

    coefficients: FloatArray
    shares: FloatArray
    times_s: FloatArray
    shape: FloatArray
    particle: FloatArray
    volume: FloatArray
    marker: FloatArray
    marker_area: FloatArray
    bonded: FloatArray
    bonded_area: FloatArray
    offset: FloatArray = field(default_factory=lambda: np.zeros(6))
    twists: list[FloatArray] = field(default_factory=list)
    youngs_modulus: float = 0.0
    shear_modulus: float = 0.0
    poisson_ratio: float = 0.0
    density: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    tangential_ratio: float = 0.0


class _Backward:
    """Goes back through the substeps, last first."""

    def __init__(
        self,
        gel: ImplicitGel,
        environment: int,
        by_poisson: Refinement | None,
        points: RestPoints,
    ) -> None:
        self.gel, self.environment, self.by_poisson = gel, environment, by_poisson
        self.points = points
        d = gel.discretization
        terms = len(gel.material.prony.shares)
        self.carried = _Carried(
            np.zeros((gel.skin.vertex_count, 3)),
            np.zeros((gel.skin.vertex_count, 3)),
            np.zeros((d.node_count, 3)),
            np.zeros((d.node_count, 3)),
            StressMemory(
                np.zeros((terms, d.particle_count, 3, 3)), np.zeros((d.particle_count, 3, 3))
            ),
        )
        bonded = len(self.points.bonded_m)
        self.sums = _Sums(
            coefficients=np.zeros(5),
            shares=np.zeros(terms),
            times_s=np.zeros(terms),
            shape=np.zeros(len(gel.contact.field.parameters)),
            particle=np.zeros((d.particle_count, 3)),
            volume=np.zeros(d.particle_count),
            marker=np.zeros((gel.skin.vertex_count, 3)),
            marker_area=np.zeros(gel.skin.vertex_count),
            bonded=np.zeros((bonded, 3)),
            bonded_area=np.zeros(bonded),
        )
        self.kernels = adjoint_kernels()

    def go_back(self, substep: Substep, loss: LossGradient) -> None:
        """Add a substep's share of the derivatives, and replace what it was handed on by what was
        handed on to it."""
        gel = self.gel
        self.twist = np.zeros(6)
        by_skin = self.carried.skin
        if loss.skin is not None:
            by_skin = by_skin + loss.skin
        by_node = self.carried.displacement + self.carried.velocity / substep.dt_s
        stress = self._stress_adjoint(substep)
        if stress is not None:
            by_node = by_node + stress
        record = substep.contact
        if record is not None:
            by_skin = by_skin + self._remembered_position(substep, record.pose)
        contact = LoadedContact(gel, substep, record, loss, self.carried.memory)
        by_skin = contact.add_to(by_skin)
        fast_share, history_pa = self._history(substep)
        virtual, by_force, by_position = contact.solve(
            partial(elastic_forces, gel, substep.inertia, self.environment),
            by_node,
            by_skin,
        )
        self._add_markers(substep, contact, virtual, by_force, by_position)
        power = self._add_particles(substep, virtual, fast_share, history_pa)
        self._add_bond_and_ghost(substep, virtual)
        carried_displacement = self._add_inertia(substep, virtual)
        velocity = carried_displacement * substep.dt_s
        carried_displacement = carried_displacement - self.carried.velocity / substep.dt_s
        self.carried.displacement, self.carried.velocity = carried_displacement, velocity
        self._go_back_in_relaxation(substep, *power)
        self.carried.skin = np.zeros_like(by_skin)
        self.carried.memory = np.zeros_like(by_skin)
        if record is not None and contact.marker_contact is not None:
            adjoint = contact.marker_contact.adjoint(by_force, contact.by_slip)
            self._add_contact(substep, record, adjoint)
        self.sums.twists.append(self.twist)
        if record is not None:
            self.sums.offset += _in_frame(self.twist, record.pose)

    def _remembered_position(self, substep: Substep, pose: Pose) -> FloatArray:
        """Return the derivatives (V, 3) by the skin through the position that contact remembers."""
        by_position = -self.carried.memory @ pose.rotation().T
        self._turn_indenter(substep.skin_position_m, by_position)
        return by_position

    def _turn_indenter(self, position_m: FloatArray, by_position: FloatArray) -> None:
        """Add the twist of a pose that sees positions (V, 3) in its frame."""
        self.twist[:3] -= by_position.sum(axis=0)
        self.twist[3:] -= np.cross(position_m, by_position).sum(axis=0)

    def _add_contact(
        self, substep: Substep, record: ContactRecord, adjoint: ContactAdjoint
    ) -> None:
        sums, specification = self.sums, self.gel.contact_specification
        youngs = self.gel.body.youngs_modulus_pa
        normal = adjoint.stiffness + specification.tangential_ratio * adjoint.tangential_stiffness
        sums.stiffness += normal * youngs / REFERENCE_SPACING_M
        sums.youngs_modulus += normal * specification.stiffness / REFERENCE_SPACING_M
        sums.tangential_ratio += adjoint.tangential_stiffness * self.gel.contact.law.stiffness
        sums.friction += adjoint.friction
        sums.shape += adjoint.shape
        self.twist += adjoint.twist
        if not record.is_fresh:
            self.carried.memory[record.marker] = adjoint.memory
            return
        by_position = -adjoint.memory @ record.pose.rotation().T
        self._turn_indenter(substep.skin_before_m[record.marker], by_position)
        if self.gel.remembers:
            self.carried.skin[record.marker] = by_position
        else:
            sums.marker[record.marker] += by_position

    def _add_markers(
        self,
        substep: Substep,
        contact: LoadedContact,
        virtual: FloatArray,
        by_force: FloatArray,
        by_position: FloatArray,
    ) -> None:
        sums, gradient = self.sums, self.points.marker_gradient
        sums.marker += by_position
        sums.marker += pulled(gradient.at(substep.displacement_m), by_position)
        if contact.marker_contact is None:
            return
        marker, force = contact.marker, contact.marker_contact.force_n
        sums.marker[marker] += pulled(gradient.at(virtual)[marker], force)
        assert substep.contact is not None
        by_area = np.zeros(self.gel.skin.vertex_count)
        by_area[marker] = np.sum(force * by_force, axis=1) / substep.contact.area_m2
        sums.marker_area += by_area[substep.contact.bearer]
        refinement = self.gel.refinement
        if refinement is not None:
            added = contact.added_displacement(refinement, force)
            youngs = self.gel.body.youngs_modulus_pa
            sums.youngs_modulus -= float(np.vdot(by_position, added)) / youngs
        if self.by_poisson is not None:
            added = contact.added_displacement(self.by_poisson, force)
            sums.poisson_ratio += float(np.vdot(by_position, added))

    def _history(self, substep: Substep) -> tuple[float, FloatArray]:
        """Give the body the relaxation of a substep; return its fast share and history."""
        if not self.gel.material.prony.shares:
            return 1.0, substep.relaxation.last_pa
        relaxation = self.gel._relaxation[self.environment]
        fast_share, history_pa = relaxation.terms_of(substep.dt_s, substep.relaxation)
        self.gel.body.set_history(fast_share, history_pa, self.environment)
        return fast_share, history_pa

    def _add_particles(
        self, substep: Substep, virtual: FloatArray, fast: float, history_pa: FloatArray
    ) -> tuple[float, FloatArray]:
        """Add what elasticity depends on; return the derivatives by the fast share and by the
        history (P, 3, 3) of relaxation."""
        body, k = self.gel.body, self.kernels
        d = self.gel.discretization
        weight_gradient = self._array(d.particle_weight_gradient, k.vec3)
        coefficients = self._coefficients()
        fast_share = self._array(np.array([fast]), wp.float64)
        history_stress = self._array(history_pa[None], k.mat33)
        power = self._array(np.zeros(d.particle_count), wp.float64)
        with wp.Tape() as tape:
            wp.launch(
                k.stress_power,
                dim=d.particle_count,
                inputs=[
                    body.node_index,
                    weight_gradient,
                    body.volume,
                    coefficients,
                    fast_share,
                    history_stress,
                    self._array(substep.displacement_m[None], k.vec3),
                    self._array(virtual[None], k.vec3),
                ],
                outputs=[power],
                device=body.device,
            )
        power.grad.fill_(-1.0)
        tape.backward()
        self.sums.coefficients += coefficients.grad.numpy()[0]
        self.sums.volume -= power.numpy() / d.particle_volume_m3
        self._move_particles(weight_gradient.grad.numpy())
        return float(fast_share.grad.numpy()[0]), history_stress.grad.numpy()[0].copy()

    def _stress_adjoint(self, substep: Substep) -> FloatArray | None:
        """Return the derivatives (N, 3) by the nodes through the stress that relaxation remembers;
        add those by the law and the geometry."""
        self.stress: FloatArray | None = None
        if not self.gel.material.prony.shares:
            return None
        body, k = self.gel.body, self.kernels
        relaxation = self.gel._relaxation[self.environment]
        seed = relaxation.stress_adjoint(substep.dt_s, self.carried.relaxation)
        weight_gradient = self._array(self.gel.discretization.particle_weight_gradient, k.vec3)
        coefficients = self._coefficients()
        displacement = self._array(substep.displacement_m[None], k.vec3)
        stress = self._array(np.zeros((1, *seed.shape)), k.mat33)
        with wp.Tape() as tape:
            wp.launch(
                k.material_stress,
                dim=stress.shape,
                inputs=[body.node_index, weight_gradient, coefficients, displacement],
                outputs=[stress],
                device=body.device,
            )
        stress.grad.assign(seed[None])
        tape.backward()
        self.stress = stress.numpy()[0].copy()
        self.sums.coefficients += coefficients.grad.numpy()[0]
        self._move_particles(weight_gradient.grad.numpy())
        by_node: FloatArray = displacement.grad.numpy()[0].copy()
        return by_node

    def _go_back_in_relaxation(
        self, substep: Substep, by_fast: float, by_history: FloatArray
    ) -> None:
        if self.stress is None:
            return
        adjoint = self.gel._relaxation[self.environment].step_adjoint(
            substep.dt_s,
            substep.relaxation,
            self.stress,
            after=self.carried.relaxation,
            fast_share=by_fast,
            history_pa=by_history,
        )
        self.carried.relaxation = adjoint.memory
        self.sums.shares += adjoint.shares
        self.sums.times_s += adjoint.times_s

    def _move_particles(self, by_weight_gradient: FloatArray) -> None:
        self.sums.particle += np.einsum(
            "paj,paij->pi", by_weight_gradient, self.points.particle_curvature
        )

    def _add_bond_and_ghost(self, substep: Substep, virtual: FloatArray) -> None:
        gel, sums, points = self.gel, self.sums, self.points
        d, h, u = gel.discretization, gel.discretization.spacing_m, substep.displacement_m
        scale = BOND_STIFFNESS / h
        sums.youngs_modulus -= scale * float(np.vdot(virtual, d.bond @ u))
        sums.shear_modulus -= GHOST_PENALTY * h * float(np.vdot(virtual, d.ghost @ u))
        scale *= gel.body.youngs_modulus_pa
        here, there = points.bonded_weight @ u, points.bonded_weight @ virtual
        sums.bonded_area -= scale * np.sum(here * there, axis=1)
        moved = pulled(points.bonded_gradient.at(u), there)
        moved += pulled(points.bonded_gradient.at(virtual), here)
        sums.bonded -= scale * points.bonded_area_m2[:, None] * moved

    def _add_inertia(self, substep: Substep, virtual: FloatArray) -> FloatArray:
        """Return the derivatives (N, 3) by where the nodes would go without forces."""
        inertia = substep.inertia
        if inertia is None:
            return np.zeros_like(virtual)
        sums, points = self.sums, self.points
        change = substep.displacement_m - inertia.predicted_m
        pull = inertia.stiffness @ virtual
        density = self.gel.material.density_kg_m3
        sums.density -= float(np.vdot(pull, change)) / density
        scale = density / substep.dt_s**2
        here, there = points.particle_weight @ change, points.particle_weight @ virtual
        sums.volume -= scale * np.sum(here * there, axis=1)
        moved = pulled(points.particle_gradient.at(change), there)
        moved += pulled(points.particle_gradient.at(virtual), here)
        volume = self.gel.discretization.particle_volume_m3
        sums.particle -= scale * volume[:, None] * moved
        return np.asarray(pull)

    def _coefficients(self) -> Any:
        chosen = self.gel.body.coefficients.numpy()[self.environment : self.environment + 1]
        return self._array(chosen, self.kernels.vec5)

    def _array(self, values: FloatArray, dtype: Any) -> Any:
        contiguous = np.ascontiguousarray(values)
        return wp.array(contiguous, dtype=dtype, device=self.gel.device, requires_grad=True)

    def gradient(self) -> Gradient:
        """Return the sums, as derivatives by the parameters that the gel is made from."""
        sums, gel = self.sums, self.gel
        # What still is carried belongs to the skin at rest, before the first substep.
        sums.marker += self.carried.skin
        coefficients = sums.coefficients.copy()
        c10, c01, *_, bulk = gel.material.law.coefficients_pa()
        mu = 2.0 * (c10 + c01)
        # nu = 1/2 - E / (6 K)
        sums.youngs_modulus -= sums.poisson_ratio / (6.0 * bulk)
        coefficients[4] += sums.poisson_ratio * gel.body.youngs_modulus_pa / (6.0 * bulk**2)
        by_mu = sums.shear_modulus + sums.youngs_modulus * 27.0 * bulk**2 / (3.0 * bulk + mu) ** 2
        coefficients[:2] += 2.0 * by_mu
        coefficients[4] += sums.youngs_modulus * 9.0 * mu**2 / (3.0 * bulk + mu) ** 2
        twists = np.array(sums.twists[::-1]).reshape(-1, 6)
        return Gradient(
            coefficients=coefficients,
            prony_shares=sums.shares,
            prony_times_s=sums.times_s,
            density_kg_m3=sums.density,
            friction_coefficient=sums.friction,
            contact_stiffness=sums.stiffness,
            tangential_ratio=sums.tangential_ratio,
            indenter_parameters=sums.shape[: len(gel.contact.indenter.parameters)],
            indenter_twist=twists.sum(axis=0),
            indenter_offset=sums.offset,
            substep_twist=twists,
            geometry=self._geometry(),
        )

    def _geometry(self) -> dict[str, float]:
        gel, sums = self.gel, self.sums
        d = gel.discretization
        particle = shape_rates(gel.shape, d.particle_position_m)
        marker = shape_rates(gel.shape, gel.skin.rest_position_m)
        bonded = shape_rates(gel.shape, self.points.bonded_m)
        result = {}
        for name in particle:
            total = float(np.vdot(sums.particle, particle[name].velocity))
            total += float(sums.volume @ (particle[name].volume * d.particle_volume_m3))
            total += float(np.vdot(sums.marker, marker[name].velocity))
            total += float(sums.marker_area @ (marker[name].area * gel.skin.rest_area_m2))
            total += float(np.vdot(sums.bonded, bonded[name].velocity))
            total += float(sums.bonded_area @ (bonded[name].area * self.points.bonded_area_m2))
            result[name] = total
        return result


def _in_frame(twist: FloatArray, pose: Pose) -> FloatArray:
    """Return the derivatives by a motion along a pose's axes and about its origin, from those by a
    motion along the base's axes and about the base's origin."""
    about_origin = twist[3:] - np.cross(pose.position_m, twist[:3])
    return (np.stack([twist[:3], about_origin]) @ pose.rotation()).ravel()
