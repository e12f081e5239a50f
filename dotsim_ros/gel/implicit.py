"""The gel at equilibrium with the indenter, step by step: quasi-static or backward Euler.

Each step minimises elastic energy + contact energy (+ inertia) over the nodal displacements, by
Newton's method with a line search (Nocedal and Wright, "Numerical Optimization", 2006, chapter 3).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dotsim_ros.gel.block_solver import BlockCholesky
from dotsim_ros.gel.body import Body
from dotsim_ros.gel.contact import (
    ONSET_M,
    SMOOTHING_M,
    Contact,
    ContactHistory,
    ContactResponse,
    Lag,
    fresh_history,
    wrench_on_indenter,
)
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.material import Material
from dotsim_ros.gel.patch import EffectiveContact, NearContact, Patch, contact_set, make_patch
from dotsim_ros.gel.refinement import Refinement, refine
from dotsim_ros.gel.relaxation import Relaxation
from dotsim_ros.gel.tangent import (
    ExactTangent,
    LocalFactor,
    LocalTangent,
    Region,
    compliance_between,
)
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, Wrench, interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.geometry.specification import ContactSpecification, SolverSpecification

Array = NDArray[np.float64]
IntArray = NDArray[np.int32]

LARGEST_SUBSTEP_M = 0.6e-3
"""The indenter moves no farther in a substep, so that no marker passes through it."""
PATCH_MARGIN_M = 2.2e-3
"""Markers closer to the indenter than this are in a new patch..."""
PATCH_KEPT_M = 1.0e-3
"""...which is kept while it holds all that are closer than this."""
REGION_RADIUS_M = 3.5e-3
"""Cells closer than this to a marker in contact are assembled anew."""
REGION_MARGIN_M = 0.8e-3
CORE_CLEARANCE_M = 1.5e-3
"""The indenter must stay this far from whatever the gel is bonded to."""
SMALLEST_SCALE = 1.0e-3
NEAR_CONTACT_M = 60.0e-6
"""Markers that come closer than this may enter contact in the next iteration."""
CARRIED_M = 30.0e-6
"""A motion that extrapolation leaves out by more than this carries the contact along first."""
LARGEST_STEP_M = 0.3e-3
CALM_STEP_M = 50.0e-6
"""Friction takes the newer pressure after an iteration that moves less than this."""
NEGLIGIBLE_FAR_SHARE = 0.5
"""Residual forces outside of the region below this share of those in it can wait."""
RELINEARISE_EVERY = 4
SLOW_CONVERGENCE = 0.4
"""An iteration that moves farther than this share of the one before renews the factor."""


class PressTooDeepError(ValueError):
    """The indenter would come too close to the rigid core or the base; nothing was changed."""


@dataclass(frozen=True)
class GelState:
    """The gel after a step, in one environment.

    Attributes:
        displacement_m: (N, 3) of the grid's nodes.
        skin_position_m: (V, 3) of the skin's markers, base frame.
        wrench: of the gel on the indenter.
        max_penetration_m: largest penetration of a marker into the indenter.
        contact_count: markers in contact.
        iterations: Newton iterations, all substeps together.
        converged: whether every substep met the tolerance.
        timings_s: seconds spent, by part.
    """

    displacement_m: Array
    skin_position_m: Array
    wrench: Wrench
    max_penetration_m: float
    contact_count: int
    iterations: int
    converged: bool
    timings_s: dict[str, float] = field(default_factory=dict)


@dataclass
class World:
    """One environment's memory between steps."""

    displacement_m: Array
    velocity_m_s: Array
    fine_force_n: Array
    skin_position_m: Array
    pose: Pose | None = None
    history: ContactHistory | None = None
    last_change: tuple[Array, Array, Array, Array] | None = None
    patch: Patch | None = None
    region: Region | None = None
    response: ContactResponse | None = None


@dataclass(frozen=True)
class _Point:
    """Where Newton's method stands: unknowns, energy and its elastic gradient, and the contact."""

    displacement_m: Array
    fine_force_n: Array
    added_m: Array
    energy_j: float
    gradient_n: Array
    response: ContactResponse


@dataclass(frozen=True)
class _Inertia:
    """Mass over the squared step (N, N), and where the nodes would go without forces (N, 3)."""

    stiffness: sparse.csr_matrix
    predicted_m: Array


Observer = Callable[[World, Pose | None, _Point, _Inertia | None, float, int], _Point]
"""Told world, pose, solution, inertia, duration and environment of a substep before it is
finished; returns the solution to go on with."""

NO_RESPONSE = ContactResponse(
    distance_m=np.zeros(0),
    pressure_pa=np.zeros(0),
    force_n=np.zeros((0, 3)),
    energy_j=0.0,
    hessian=np.zeros((0, 3, 3)),
    local_position_m=np.zeros((0, 3)),
    slip_m=np.zeros((0, 3)),
    normal=np.zeros((0, 3)),
)


class ImplicitGel:
    """The total-Lagrangian gel with a rigid indenter, for a batch of environments.

    Args:
        shape: where the gel is.
        skin: the skin's markers.
        material: law, relaxation, density.
        contact: friction and stiffness of the contact.
        solver: resolution and effort.
        indenter: the rigid shape.
        environment_count: number of independent worlds.
        exact: factor the whole tangent in every iteration (a slow reference).
        progress: told the finished share of a refinement that is not in the cache.

    Attributes:
        observer: called in every substep, None for none.
        trace: of the last substep, how far each iteration moved a marker (m) and the step's scale.
    """

    def __init__(
        self,
        shape: Body,
        skin: SkinMesh,
        material: Material,
        *,
        contact: ContactSpecification,
        solver: SolverSpecification,
        indenter: Indenter,
        environment_count: int = 1,
        device: str = "cpu",
        exact: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.shape, self.skin, self.material, self.solver = shape, skin, material, solver
        self.contact_specification, self.device = contact, device
        self.environment_count, self.exact = environment_count, exact
        self.discretization = discretize(shape, skin.rest_position_m, solver.grid_spacing_m)
        d = self.discretization
        self.skin_weight = d.skin_interpolation.matrix(d.node_count)
        self.body = ElasticBody(d, material.law, environment_count=environment_count, device=device)
        self._single = ElasticBody(
            d,
            material.law,
            environment_count=environment_count,
            dtype=np.float32,
            device=device,
        )
        self._relaxation = [Relaxation(material.prony) for _ in range(environment_count)]
        self._mass = d.mass_over_density * material.density_kg_m3
        self._step_s = 0.0
        self._exact_tangent = ExactTangent(self._single, self._mass * 0.0)
        self._local_tangent: LocalTangent | None = None
        self.refinement: Refinement | None = None
        if not exact or solver.refined:
            at_rest = LocalTangent(self._single, self._mass * 0.0)
            if not exact:
                self._local_tangent = at_rest
            if solver.refined:
                self.refinement = refine(
                    shape,
                    skin.rest_position_m,
                    d,
                    at_rest.compliance,
                    material.law,
                    progress=progress,
                )
        self._shape = shape
        lower, upper = shape.bounds_m()
        # So dense that no tip gets through between them.
        count = int(np.ceil(np.ptp(shape.bounds_m(), axis=0)[:2].max() / CORE_CLEARANCE_M)) + 1
        base = np.linspace(lower, upper, count)
        plane = np.stack(np.meshgrid(base[:, 0], base[:, 1], [0.0]), axis=-1).reshape(-1, 3)
        self._rigid_points_m = np.concatenate([shape.bonded_surface(1.0e-3)[0], plane])
        self.trace: list[tuple[float, float]] = []
        self.observer: Observer | None = None
        self.set_indenter(indenter)

    def set_indenter(self, indenter: Indenter) -> None:
        """Replace the indenter and forget the state."""
        self.contact = Contact(
            indenter,
            self.skin.rest_area_m2,
            self.body.youngs_modulus_pa,
            self.contact_specification,
            device=self.device,
        )
        self._inner_point_m = _inner_point_m(indenter)
        self.reset()

    def reset(self) -> None:
        """Return every environment to rest."""
        self.worlds = [self._fresh_world() for _ in range(self.environment_count)]
        for environment in range(self.environment_count):
            self._relaxation[environment] = Relaxation(self.material.prony)

    def _fresh_world(self) -> World:
        shape = (self.discretization.node_count, 3)
        fine = 0 if self.refinement is None else self.refinement.node_count
        return World(
            np.zeros(shape),
            np.zeros(shape),
            np.zeros((fine, 3)),
            self.skin.rest_position_m.copy(),
        )

    def step(self, poses: Sequence[Pose | None], dt_s: float) -> list[GelState]:
        """Move the indenter of every environment to its pose (None: away) and find the gel.

        Args:
            poses: one pose of the indenter in the base frame per environment.
            dt_s: duration of the step; without inertia or relaxation it does not matter.

        Raises:
            PressTooDeepError: a pose, or the way to it, brings the indenter too close to what the
                gel is bonded to.
            ValueError: as many poses as environments are needed, and a positive duration.
        """
        if len(poses) != self.environment_count:
            raise ValueError(f"{len(poses)} poses for {self.environment_count} environments")
        if not dt_s > 0.0:
            raise ValueError(f"dt_s is {dt_s}, expected a positive number of seconds")
        paths = [self._path(world, pose) for world, pose in zip(self.worlds, poses, strict=True)]
        return [self._step_world(e, path, dt_s) for e, path in enumerate(paths)]

    def check_depth(self, pose: Pose) -> None:
        """Refuse a pose that presses too deep, without moving there.

        Raises:
            PressTooDeepError: it comes too close to what the gel is bonded to.
        """
        local = (self._rigid_points_m - pose.position_m) @ pose.rotation()
        clearance = float(self.contact.indenter.signed_distance(local).min())
        if clearance < CORE_CLEARANCE_M:
            raise PressTooDeepError(
                f"the indenter at {np.round(pose.position_m * 1e3, 2).tolist()} mm comes within "
                f"{clearance * 1e3:.2f} mm of the rigid core or base, expected at least "
                f"{CORE_CLEARANCE_M * 1e3:.1f} mm; press less deep"
            )

    def _step_world(self, environment: int, path: Sequence[Pose | None], dt_s: float) -> GelState:
        world = self.worlds[environment]
        timings: dict[str, float] = {}
        iterations, converged = 0, True
        for waypoint in path:
            used, reached = self._substep(world, waypoint, dt_s / len(path), environment, timings)
            iterations += used
            converged = converged and reached
        world.pose = path[-1]
        response, patch = world.response, world.patch
        wrench, penetration, count = Wrench(), 0.0, 0
        if response is not None and patch is not None:
            wrench = wrench_on_indenter(world.skin_position_m[patch.marker], response.force_n)
            penetration = max(0.0, -float(response.distance_m.min(initial=np.inf)))
            count = int(np.count_nonzero(response.pressure_pa))
        return GelState(
            world.displacement_m.copy(),
            world.skin_position_m.copy(),
            wrench,
            penetration,
            count,
            iterations,
            converged,
            timings,
        )

    def _path(self, world: World, pose: Pose | None) -> list[Pose | None]:
        """Return the poses of the substeps: short moves, and from outside if the first one is in
        the gel; moves that touch nothing are left out."""
        if pose is None:
            return [None]
        start = world.pose
        if start is None:
            away = pose.rotation()[:, 2]
            reach = float(np.ptp(self.skin.rest_position_m, axis=0).max())
            start = Pose(pose.position_m + reach * away, pose.quaternion_xyzw)
        turn = 2.0 * np.arccos(min(1.0, abs(float(start.quaternion_xyzw @ pose.quaternion_xyzw))))
        radius = 0.5 * float(np.linalg.norm(np.ptp(self.contact.indenter.bounds_m(), axis=0)))
        length = float(np.linalg.norm(pose.position_m - start.position_m)) + turn * min(
            radius, 0.02
        )
        count = max(1, int(np.ceil(length / LARGEST_SUBSTEP_M)))
        path = [interpolate(start, pose, k / count) for k in range(1, count)] + [pose]
        for waypoint in path:
            self.check_depth(waypoint)
        while len(path) > 1 and world.response is None and not self._touches_rest(path[0]):
            path.pop(0)
        return list(path)

    def _touches_rest(self, pose: Pose) -> bool:
        """Return whether the indenter meets the gel at rest: its skin, or all of it within."""
        if self._shape.contains(pose.apply(self._inner_point_m)):
            return True
        local = (self.skin.rest_position_m - pose.position_m) @ pose.rotation()
        lower, upper = self.contact.indenter.bounds_m()
        near = np.all((local > lower - ONSET_M) & (local < upper + ONSET_M), axis=1)
        if not near.any():
            return False
        return bool(self.contact.indenter.signed_distance(local[near]).min() < ONSET_M)

    def _remembers(self) -> bool:
        return self.solver.dynamic or bool(self.material.prony.shares)

    def _substep(
        self,
        world: World,
        pose: Pose | None,
        dt_s: float,
        environment: int,
        timings: dict[str, float],
    ) -> tuple[int, bool]:
        """Advance one substep; return the iterations used and whether the tolerance was met."""
        touching = pose is not None and self._touches_rest(pose)
        if not touching and not self._remembers():
            self._come_to_rest(world)
            return 0, True
        inertia = self._prepare_memory(world, dt_s, environment)
        if pose is None:
            self._let_go(world)
        else:
            self._prepare_contact(world, pose, timings)
        start = (world.displacement_m, world.fine_force_n)
        point, iterations, converged = self._minimise(world, pose, inertia, environment, timings)
        if self.observer is not None:
            point = self.observer(world, pose, point, inertia, dt_s, environment)
        clock = time.perf_counter()
        self._finish(world, pose, point, start, dt_s, environment)
        _add(timings, "skin", clock)
        return iterations, converged

    def _come_to_rest(self, world: World) -> None:
        """Without contact, inertia and relaxation the equilibrium is rest, exactly."""
        world.displacement_m = np.zeros_like(world.displacement_m)
        world.velocity_m_s = np.zeros_like(world.velocity_m_s)
        world.skin_position_m = self.skin.rest_position_m.copy()
        self._let_go(world)

    def _let_go(self, world: World) -> None:
        """Forget the contact; only contact moves the refinement."""
        world.fine_force_n = np.zeros_like(world.fine_force_n)
        world.history = world.last_change = world.patch = world.response = world.region = None

    def _prepare_memory(self, world: World, dt_s: float, environment: int) -> _Inertia | None:
        fast, history = self._relaxation[environment].step_terms(
            dt_s, self.discretization.particle_count
        )
        if self.material.prony.shares:
            for body in (self.body, self._single):
                body.set_history(fast, history, environment)
        if not self.solver.dynamic:
            return None
        stiffness = (self._mass / dt_s**2).tocsr()
        if dt_s != self._step_s:
            self._step_s = dt_s
            self._exact_tangent = ExactTangent(self._single, stiffness)
            if self._local_tangent is not None:
                self._local_tangent = LocalTangent(self._single, stiffness)
            for other in self.worlds:
                other.region = None
        return _Inertia(stiffness, world.displacement_m + dt_s * world.velocity_m_s)

    def _prepare_contact(self, world: World, pose: Pose, timings: dict[str, float]) -> None:
        """Find the markers that may touch, and renew patch and region where they do not do."""
        clock = time.perf_counter()
        if world.history is None:
            world.history = fresh_history(world.skin_position_m, pose)
        every = np.arange(self.skin.vertex_count, dtype=np.int32)
        distance = self.contact.respond(
            every, world.skin_position_m, pose, world.history, _no_lag(self.skin.vertex_count)
        ).distance_m
        free = ~self.skin.on_base
        kept = free & (distance < PATCH_KEPT_M)
        if world.patch is None or not np.all(np.isin(np.flatnonzero(kept), world.patch.marker)):
            chosen = np.flatnonzero(free & (distance < PATCH_MARGIN_M)).astype(np.int32)
            world.patch = make_patch(
                chosen, self.skin.rest_position_m, self.skin_weight, self.refinement
            )
        _add(timings, "contact", clock)

    def _renew_region(self, patch: Patch, near: NDArray[np.bool_], local: LocalTangent) -> Region:
        centre = patch.rest_position_m[near]
        gap = np.min(
            np.linalg.norm(local.cell_centre_m[:, None] - centre[None, ::3], axis=2), axis=1
        )
        cell = np.flatnonzero(gap < REGION_RADIUS_M).astype(np.int32)
        node = np.unique(patch.weight[near].indices).astype(np.int32)
        return local.region(cell, node)

    def _evaluate(
        self,
        world: World,
        pose: Pose | None,
        unknowns: tuple[Array, Array],
        lag: Lag,
        inertia: _Inertia | None,
        environment: int,
        timings: dict[str, float],
    ) -> _Point:
        displacement, fine_force = unknowns
        clock = time.perf_counter()
        batch = np.zeros((self.environment_count, *displacement.shape))
        batch[environment] = displacement
        energies, gradients = self.body.force(batch)
        energy, gradient = float(energies[environment]), gradients[environment]
        if inertia is not None:
            push = inertia.stiffness @ (displacement - inertia.predicted_m)
            gradient = gradient + push
            energy += 0.5 * float(np.vdot(displacement - inertia.predicted_m, push))
        _add(timings, "force", clock)
        clock = time.perf_counter()
        patch = world.patch
        if pose is None or patch is None or world.history is None:
            empty = np.zeros((0, 3))
            return _Point(displacement, fine_force, empty, energy, gradient, NO_RESPONSE)
        local_force = fine_force[patch.fine_node]
        added = patch.added_displacement(local_force)
        response = self.contact.respond(
            patch.marker,
            patch.position(displacement, added),
            pose,
            world.history,
            lag,
        )
        energy += response.energy_j + 0.5 * float(np.vdot(local_force, added))
        _add(timings, "contact", clock)
        return _Point(displacement, fine_force, added, energy, gradient, response)

    def _minimise(
        self,
        world: World,
        pose: Pose | None,
        inertia: _Inertia | None,
        environment: int,
        timings: dict[str, float],
    ) -> tuple[_Point, int, bool]:
        def evaluate(unknowns: tuple[Array, Array], lag: Lag) -> _Point:
            return self._evaluate(world, pose, unknowns, lag, inertia, environment, timings)

        patch = world.patch
        lag = _no_lag(0)
        if patch is not None and world.history is not None:
            lag = _no_lag(len(patch.marker))
            lag.pressure_pa[:] = self._expected_pressure(world, pose)[patch.marker]
        point = evaluate(self._extrapolate(world, pose), lag)
        if not np.isfinite(point.energy_j):
            point = evaluate((world.displacement_m, world.fine_force_n), lag)
        solver = _Direction(self, world, environment)
        carried = self._carried_markers(world, pose)
        solver.trusts_guess = world.last_change is not None and carried is None
        self.trace.clear()
        if carried is not None:
            clock = time.perf_counter()
            step = solver.carry(point, *carried)
            _add(timings, "solve", clock)
            unknowns = (
                point.displacement_m + step.displacement_m,
                _plus(point.fine_force_n, patch, step.fine_force_n),
            )
            moved = evaluate(unknowns, lag)
            if moved.energy_j < point.energy_j:
                point = moved
        passes = 1
        for iteration in range(1, self.solver.iterations + 1):
            if iteration == 1:
                lag = replace(lag, normal=point.response.normal)
                point = self._with_lag(world, pose, point, lag)
            elif self.trace[-1][0] < CALM_STEP_M and passes < self.solver.friction_passes:
                passes += 1
                lag = Lag(point.response.pressure_pa, point.response.normal)
                point = self._with_lag(world, pose, point, lag)
            clock = time.perf_counter()
            step, slope = solver.step(point)
            if slope >= 0.0 and not solver.is_plain:
                solver.be_plain(point)
                step, slope = solver.step(point)
            _add(timings, "solve", clock)
            scale = min(1.0, LARGEST_STEP_M / max(step.largest_m, LARGEST_STEP_M))
            if step.largest_m < self.solver.tolerance_m:
                self.trace.append((step.largest_m, scale))
                return self._moved(world, pose, point, step, lag), iteration, True
            while True:
                unknowns = (
                    point.displacement_m + scale * step.displacement_m,
                    _plus(point.fine_force_n, patch, scale * step.fine_force_n),
                )
                trial = evaluate(unknowns, lag)
                allowed = point.energy_j + 1e-4 * scale * slope + 1e-10 * abs(point.energy_j)
                if trial.energy_j <= allowed or scale < SMALLEST_SCALE:
                    break
                scale *= 0.5
            self.trace.append((step.largest_m, scale))
            if scale < SMALLEST_SCALE:
                if solver.is_plain:
                    return point, iteration, False
                solver.be_plain(point)
                continue
            point = trial
        return point, self.solver.iterations, False

    def _with_lag(self, world: World, pose: Pose | None, point: _Point, lag: Lag) -> _Point:
        """Return the point with friction limited by a newer pressure."""
        patch = world.patch
        if pose is None or patch is None or world.history is None:
            return point
        response = self.contact.respond(
            patch.marker,
            patch.position(point.displacement_m, point.added_m),
            pose,
            world.history,
            lag,
        )
        energy = point.energy_j - point.response.energy_j + response.energy_j
        return replace(point, energy_j=energy, response=response)

    def _moved(
        self, world: World, pose: Pose | None, point: _Point, step: _Step, lag: Lag
    ) -> _Point:
        """Return the point after a last, small step; energy and gradient are not renewed."""
        patch = world.patch
        point = replace(
            point,
            displacement_m=point.displacement_m + step.displacement_m,
            fine_force_n=_plus(point.fine_force_n, patch, step.fine_force_n),
        )
        if patch is not None:
            added = patch.added_displacement(point.fine_force_n[patch.fine_node])
            point = replace(point, added_m=added)
        point = self._with_lag(world, pose, point, lag)
        # What is reported and remembered obeys Coulomb's law with the pressure that it ends with.
        last = Lag(point.response.pressure_pa, point.response.normal)
        return self._with_lag(world, pose, point, last)

    def _share_of_last_move(self, world: World, pose: Pose) -> float:
        """Return how much of the last step's motion this one repeats: 1 at constant velocity."""
        if world.last_change is None or world.pose is None:
            return 0.0
        move = world.last_change[2]
        length = float(move @ move)
        if length == 0.0:
            return 0.0
        along = float((pose.position_m - world.pose.position_m) @ move) / length
        return float(np.clip(along, -1.0, 2.0))

    def _expected_pressure(self, world: World, pose: Pose | None) -> Array:
        """Return the pressure (V,) if it goes on changing in proportion to the motion."""
        assert world.history is not None
        pressure = world.history.pressure_pa
        if world.last_change is None or pose is None:
            return pressure
        share = self._share_of_last_move(world, pose)
        return np.maximum(0.0, pressure + share * world.last_change[3])

    def _extrapolate(self, world: World, pose: Pose | None) -> tuple[Array, Array]:
        """Return the unknowns if the gel goes on moving in proportion to the indenter."""
        if world.last_change is None or pose is None:
            return (world.displacement_m, world.fine_force_n)
        share = self._share_of_last_move(world, pose)
        displacement, fine_force, _, _ = world.last_change
        return (
            world.displacement_m + share * displacement,
            world.fine_force_n + share * fine_force,
        )

    def _carried_markers(
        self, world: World, pose: Pose | None
    ) -> tuple[NDArray[np.int64], Array] | None:
        """Return the patch's rows that were in contact, and how the part of the indenter's motion
        that does not repeat the last step would carry them (A, 3); None where it is small."""
        patch, before = world.patch, world.pose
        if pose is None or patch is None or before is None or world.history is None:
            return None
        rows = np.flatnonzero(world.history.pressure_pa[patch.marker] > 0.0)
        if len(rows) == 0:
            return None
        position = world.skin_position_m[patch.marker[rows]]
        local = (position - before.position_m) @ before.rotation()
        move = pose.apply(local) - position
        if world.last_change is not None:
            move -= self._share_of_last_move(world, pose) * world.last_change[2]
        return (rows, move) if float(np.abs(move).max()) > CARRIED_M else None

    def _finish(
        self,
        world: World,
        pose: Pose | None,
        point: _Point,
        start: tuple[Array, Array],
        dt_s: float,
        environment: int,
    ) -> None:
        patch = world.patch
        world.velocity_m_s = (point.displacement_m - start[0]) / dt_s
        world.displacement_m, world.fine_force_n = point.displacement_m, point.fine_force_n
        world.skin_position_m = self.skin.rest_position_m + self.skin_weight @ point.displacement_m
        if self.material.prony.shares:
            stress = self.body.material_stress(point.displacement_m, environment).astype(np.float64)
            self._relaxation[environment].finish_step(dt_s, stress)
        if pose is None or patch is None or world.history is None:
            world.pose = None
            return
        if self.refinement is not None:
            loaded = np.flatnonzero(np.any(point.fine_force_n, axis=1)).astype(np.int32)
            added = self.refinement.displacement(loaded, point.fine_force_n[loaded])
            world.skin_position_m += self.refinement.skin_weight @ added
        before, world.pose = world.pose, pose
        world.response = point.response
        history = fresh_history(world.skin_position_m, pose)
        history.local_position_m[patch.marker] = point.response.local_position_m
        history.slip_m[patch.marker] = point.response.slip_m
        history.pressure_pa[patch.marker] = point.response.pressure_pa
        if before is not None:
            world.last_change = (
                point.displacement_m - start[0],
                point.fine_force_n - start[1],
                pose.position_m - before.position_m,
                history.pressure_pa - world.history.pressure_pa,
            )
        world.history = history


def _no_lag(count: int) -> Lag:
    return Lag(np.zeros(count), np.zeros((count, 3)))


def _inner_point_m(indenter: Indenter) -> Array:
    """Return a point (3,) of the indenter's inside, in its frame: the innermost of a grid."""
    lower, upper = indenter.bounds_m()
    axes = np.linspace(lower, upper, 17)
    points = np.stack(np.meshgrid(*axes.T, indexing="ij"), axis=-1).reshape(-1, 3)
    innermost: Array = points[np.argmin(indenter.signed_distance(points))]
    return innermost


def _add(timings: dict[str, float], part: str, since: float) -> None:
    timings[part] = timings.get(part, 0.0) + time.perf_counter() - since


def _plus(force_n: Array, patch: Patch | None, change_n: Array) -> Array:
    if patch is None:
        return force_n
    result = force_n.copy()
    result[patch.fine_node] += change_n
    return result


@dataclass(frozen=True)
class _Step:
    """A Newton step: of the grid, of the refinement's forces on the patch, and how far it moves
    the markers that matter."""

    displacement_m: Array
    fine_force_n: Array
    largest_m: float


class _Direction:
    """Newton directions of one substep; stiffness and factor are renewed when contact changes."""

    def __init__(self, gel: ImplicitGel, world: World, environment: int) -> None:
        self.gel, self.world, self.environment = gel, world, environment
        self.near: NearContact | None = None
        self.contact: EffectiveContact | None = None
        self.touching: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self.surplus_n: Array = np.zeros((0, 3))
        self.free: LocalFactor | BlockCholesky | None = None
        self.compliance: Array | None = None
        self.factor: LocalFactor | None = None
        self.stiffness: NDArray[np.float32] | None = None
        self.last_m = np.inf
        self.is_slow = False
        self.count = 0
        self.trusts_guess = False
        self.is_plain = False
        self.linearise_at_m = world.displacement_m

    def step(self, point: _Point) -> tuple[_Step, float]:
        """Return the step from a point and the energy's slope along it, J."""
        patch, response = self.world.patch, point.response
        residual = -point.gradient_n
        if patch is not None:
            residual = residual + patch.weight.T @ response.force_n
        if patch is None or not self._renew_contact(patch, point, residual):
            displacement = self._solve(point, residual.ravel()).reshape(-1, 3)
            largest = float(np.abs(displacement).max())
            unloading = np.zeros((0, 3)) if patch is None else -point.fine_force_n[patch.fine_node]
            step = _Step(displacement, unloading, largest)
            return step, -float(np.vdot(residual, displacement))
        contact = self.contact
        assert contact is not None
        rows = contact.rows
        weight, fine_weight = patch.weight[rows], patch.fine_weight[rows]
        # Where contact is about to begin or end, the linear law's force stands for the true one.
        expected = response.force_n + self.surplus_n
        fine_force = point.fine_force_n[patch.fine_node]
        mismatch = fine_weight @ patch.added_displacement(
            patch.fine_weight.T @ expected - fine_force
        )
        right = residual + patch.weight.T @ self.surplus_n + weight.T @ contact.force(mismatch)
        displacement = self._solve(point, right.ravel()).reshape(-1, 3)
        force = expected.copy()
        force[rows] += contact.force(weight @ displacement + mismatch)
        fine_change = patch.fine_weight.T @ force - fine_force
        added_change = patch.added_displacement(fine_change)
        largest = float(np.abs(weight @ displacement + fine_weight @ added_change).max())
        out_of_balance = patch.fine_weight.T @ response.force_n - fine_force
        slope = -float(np.vdot(residual, displacement) + np.vdot(out_of_balance, added_change))
        self.is_slow = largest > SLOW_CONVERGENCE * self.last_m
        self.count += 1
        self.trusts_guess = self.trusts_guess and not self.is_slow
        if self.is_slow and self.count % RELINEARISE_EVERY == 0:
            self.linearise_at_m = point.displacement_m
            self.stiffness = self.free = self.factor = self.compliance = None
        self.last_m = largest
        return _Step(displacement, fine_change, largest), slope

    def be_plain(self, point: _Point) -> None:
        """From now on take the contact as it is, linearise here, and leave out nothing: a direction
        that does not descend calls for it."""
        self.is_plain = True
        self.linearise_at_m = point.displacement_m
        self.stiffness = self.free = self.factor = self.compliance = self.contact = None

    def carry(self, point: _Point, rows: NDArray[np.int64], move_m: Array) -> _Step:
        """Return the step if the given rows of the patch stuck to the indenter and moved with it.

        Newton's method would let go of every marker that a shifted indenter leaves behind by a
        hair; carried along first, the contact stays whole and then slips.
        """
        patch = self.world.patch
        assert patch is not None
        self.near = NearContact(patch, rows)
        stiffness = np.zeros((len(patch.marker), 3, 3))
        stiffness[rows] = self.gel.contact.marker_stiffness(patch.marker[rows])
        contact = self.near.effective(stiffness)
        self.contact = contact
        weight = patch.weight[rows]
        right = -(weight.T @ contact.force(move_m))
        displacement = self._solve(point, right.ravel()).reshape(-1, 3)
        force = np.zeros((len(patch.marker), 3))
        force[rows] = contact.force(weight @ displacement - move_m)
        self.contact = self.factor = None
        largest = float(np.abs(weight @ displacement).max())
        return _Step(displacement, patch.fine_weight.T @ force, largest)

    def _renew_contact(self, patch: Patch, point: _Point, residual_n: Array) -> bool:
        """Predict which markers touch after the step and renew what depends on it; return whether
        any does."""
        response = point.response
        rows = np.flatnonzero(response.distance_m < ONSET_M + NEAR_CONTACT_M)
        if len(rows) == 0:
            self.contact = None
            return False
        if self.near is None or not np.all(np.isin(rows, self.near.rows)):
            self.near = NearContact(patch, rows)
            self.compliance = None
            self.touching = np.zeros(len(rows), dtype=bool)
        rows = self.near.rows
        pressed = response.pressure_pa[rows] > 0.0
        if self.is_plain or (self.trusts_guess and pressed.any()):
            touching = pressed
        elif self.count == 0 or self.is_slow or not np.array_equal(pressed, self.touching):
            touching = self._touching(patch, point, residual_n)
        else:
            touching = self.touching
        if not touching.any():
            self.contact = None
            return False
        normal = response.normal[rows]
        stiffness = self.gel.contact.normal_stiffness(patch.marker[rows])
        # The linear law of full contact, less what the smooth onset takes off.
        linear = stiffness * (ONSET_M - 0.5 * SMOOTHING_M - response.distance_m[rows])
        begins, ends = touching & ~pressed, pressed & ~touching
        self.surplus_n = np.zeros_like(response.force_n)
        self.surplus_n[rows[begins]] = linear[begins, None] * normal[begins]
        self.surplus_n[rows[ends]] = -response.force_n[rows[ends]]
        changed = not np.array_equal(touching, self.touching)
        if self.contact is None or changed or self.is_slow or self.is_plain:
            hessian = response.hessian.copy()
            hessian[rows[ends]] = 0.0
            hessian[rows[begins]] = stiffness[begins, None, None] * (
                normal[begins, :, None] * normal[begins, None, :]
            )
            self.contact = self.near.effective(hessian)
            self.touching = touching
            self.factor = None
        return True

    def _touching(self, patch: Patch, point: _Point, residual_n: Array) -> NDArray[np.bool_]:
        """Return which of the near markers touch after a linear step."""
        assert self.near is not None
        response, rows = point.response, self.near.rows
        free = self._free_factor(point)
        normal = response.normal[rows]
        load = _directed(patch.weight[rows], normal)
        pushed = np.einsum("ai,ai->a", response.force_n[rows], normal)
        if self.compliance is None or len(self.compliance) != len(rows):
            added = self.near.normal_compliance(response.normal)
            self.compliance = compliance_between(free, load) + added
        compliance = self.compliance
        drift = load @ _near_solution(free, residual_n.ravel())
        # The refinement will also follow the force that is there already.
        lag_n = patch.fine_weight.T @ response.force_n - point.fine_force_n[patch.fine_node]
        late = patch.fine_weight[rows] @ patch.added_displacement(lag_n)
        drift += np.einsum("ai,ai->a", late, normal)
        stiffness = self.gel.contact.normal_stiffness(patch.marker[rows])
        penetration = ONSET_M - 0.5 * SMOOTHING_M - response.distance_m[rows]
        unpushed = penetration - drift + compliance @ pushed
        return contact_set(compliance, stiffness, unpushed, response.pressure_pa[rows] > 0.0)

    def _free_factor(self, point: _Point) -> LocalFactor | BlockCholesky:
        """Return the factored stiffness without contact."""
        if self.free is None:
            gel = self.gel
            if gel._local_tangent is None:
                self.free = gel._exact_tangent.factor(point.displacement_m, None, self.environment)
            else:
                region, stiffness = self._region_stiffness(point, gel._local_tangent)
                self.free = gel._local_tangent.factor(region, stiffness, None)
        return self.free

    def _region_stiffness(
        self, point: _Point, local: LocalTangent
    ) -> tuple[Region, NDArray[np.float32]]:
        world, near = self.world, self.near
        assert world.patch is not None
        assert near is not None
        if world.region is None or np.any(world.region.number[near.node] < 0):
            close = point.response.distance_m < REGION_MARGIN_M
            close[near.rows] = True
            world.region = self.gel._renew_region(world.patch, close, local)
            self.stiffness = None
        if self.stiffness is None:
            # At the last equilibrium it is positive definite; at a guess it need not be.
            self.stiffness = local.assemble(world.region, self.linearise_at_m, self.environment)
        return world.region, self.stiffness

    def _solve(self, point: _Point, right: Array) -> Array:
        gel = self.gel
        local = gel._local_tangent
        if local is None:
            factor = gel._exact_tangent.factor(point.displacement_m, self.contact, self.environment)
            return np.asarray(factor.solve(right.astype(np.float32)), dtype=np.float64)
        if self.contact is None:
            return local.solve_at_rest(right)
        if self.factor is None:
            region, stiffness = self._region_stiffness(point, local)
            self.factor = local.factor(region, stiffness, self.contact)
        near = float(np.linalg.norm(right[self.factor.region.dof]))
        far = np.sqrt(max(0.0, float(right @ right) - near * near))
        if far < NEGLIGIBLE_FAR_SHARE * near and not self.is_plain:
            return self.factor.solve_near(right)
        return self.factor.solve(right)


def _directed(weight: sparse.csr_matrix, direction: Array) -> sparse.csr_matrix:
    """Return (A, 3 N) rows that take the displacement of points along directions (A, 3)."""
    count = len(direction)
    entries = np.diff(weight.indptr)
    data = (weight.data[:, None] * np.repeat(direction, entries, axis=0)).ravel()
    column = (3 * weight.indices[:, None] + np.arange(3)).ravel()
    return sparse.csr_matrix((data, column, 3 * weight.indptr), shape=(count, 3 * weight.shape[1]))


def _near_solution(factor: LocalFactor | BlockCholesky, right: Array) -> Array:
    if isinstance(factor, BlockCholesky):
        return np.asarray(factor.solve(right.astype(np.float32)), dtype=np.float64)
    return factor.solve_near(right)
