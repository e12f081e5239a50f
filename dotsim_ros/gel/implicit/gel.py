# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel at equilibrium with the indenter, step by step: quasi-static or backward Euler.

Each step minimises elastic energy + contact energy (+ inertia) over the nodal displacements, by
Newton's method with a line search (Nocedal and Wright, "Numerical Optimization", 2006, chapter 3).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from dotsim_ros.gel.body import Body
from dotsim_ros.gel.bond import LooseBond, lost_stiffness
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit.contact import (
    ONSET_M,
    Contact,
    ContactHistory,
    ContactResponse,
    Lag,
    fresh_history,
    wrench_on_indenter,
)
from dotsim_ros.gel.implicit.contact_points import ContactPoints, borne
from dotsim_ros.gel.implicit.contact_problem import Guess
from dotsim_ros.gel.implicit.newton import (
    CONTRACTION,
    EquilibriumProblem,
    EquilibriumSearch,
    Factor,
    Point,
    Trace,
    no_lag,
)
from dotsim_ros.gel.implicit.patch import NearMarkers, Patch, make_patch
from dotsim_ros.gel.implicit.refinement import Refinement, refine
from dotsim_ros.gel.implicit.relaxation import Relaxation
from dotsim_ros.gel.implicit.rest_compliance import kept_compliance
from dotsim_ros.gel.implicit.tangent import (
    ExactTangent,
    GridRegion,
    LocalTangent,
    inverse_at_rest,
)
from dotsim_ros.gel.implicit.wrench_stiffness import wrench_stiffness
from dotsim_ros.gel.material import Material, PronySeries, small_strain_moduli_pa
from dotsim_ros.geometry.indenter import Indenter, warn_of_misfit, way_m
from dotsim_ros.geometry.pose import Pose, Wrench, interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import Float32Array, FloatArray, IndexArray
from dotsim_ros.io.cores import single_threaded
from dotsim_ros.io.exclusive_use import ExclusiveUse, exclusive
from dotsim_ros.specification import ContactSpecification, SolverSpecification

FORGOTTEN_N = 1.0e-9
"""A marker's force below this is set to zero: it moves the skin by less than 1e-11 m. The force on
a released marker would otherwise decay for hundreds of steps, count as contact all the while, and
end as subnormal numbers, with which a product takes ten times as long."""
LARGEST_SUBSTEP_M = 0.6e-3
"""The indenter moves no farther in a substep, so that no marker passes through it..."""
TOUCH_SHARE = 0.05
"""...and in a step that begins without contact by no more than this share of the grid's spacing:
friction then follows the contact as it grows, and no marker is thrown off an edge or a tip."""
NEAR_M = 5.0e-3
"""An indenter that is farther from the ball around the gel is on a way that touches nothing."""
PATCH_MARGIN_M = 2.2e-3
"""Markers closer to the indenter than this are in a new patch..."""
PATCH_KEPT_M = 1.0e-3
"""...which is kept while it holds all that are closer than this."""
BORNE_WITHIN_M = 20.0e-6
"""A marker that another one bears for is still borne where it leaves the indenter by less. Without
this it alternates between the two, and the force does not settle."""
REGION_RADIUS_M = 2.4e-3
"""Cells closer than this to a marker in contact are assembled again..."""
REGION_MARGIN_M = 0.8e-3
"""...or to one this close to the indenter..."""
REGION_GRADIENT = 0.2
"""...and cells that are strained or turned, by the norm of their displacement's gradient. Where
cells keep the stiffness that they have at rest, Newton's method diverges once theirs is twice that:
at 0.4, it does so in presses of 3 mm."""
LARGEST_CONTRACTION = 0.7
"""In a nearly incompressible gel it does so earlier: a gradient g rotates the volumetric stiffness,
which is K in place of mu, so that a step leaves g^2 K / mu of the error before it. The limit is
lower where that would be more than this share; at 1, the force under a punch at rest went up and
down by 0.7 % without end."""
REGION_KEPT = 1.25
"""A region is kept while no cell outside is strained by more than so many times the limit."""
SLOW_SHARE = 0.5
"""Once a search converges slowly, the limit is multiplied by this."""
FAR_TOLERANCES = 2.0
"""Forces out of balance far from the contact wait where they move the skin by less than about so
many tolerances."""
SEEN_EVERY = 8
"""Of the skin's markers, one in so many shows how far an iteration moves the skin: they lie closer
together than the grid can bend."""
FAR_SLIDE_M = 0.1e-3
"""A marker that slides farther in a substep follows the indenter's surface, not a straight line."""
NEIGHBOURS = 4
NEIGHBOUR_M = 0.1e-3
"""Distance at which a neighbour's weight is half of that of one right here."""
AT_LIMIT = 0.98
"""A marker slips where its friction is this share of what its pressure allows, or more."""
SNAP = 1.5
"""Gel that moves by more than this multiple of the indenter's motion has snapped through."""
CORE_CLEARANCE_M = 1.5e-3
"""The indenter must stay this far from whatever the gel is bonded to."""
CLEARANCE_REACH_M = 4.0e-3
"""What is farther away than this is not measured."""


def rigid_points_m(body: Body) -> FloatArray:
    """Return points (R, 3) on what a gel is bonded to, which no indenter may come near."""
    lower, upper = body.bounds_m()
    # So dense that no tip gets through between them.
    count = int(np.ceil(np.ptp(body.bounds_m(), axis=0)[:2].max() / CORE_CLEARANCE_M)) + 1
    base = np.linspace(lower, upper, count)
    plane = np.stack(np.meshgrid(base[:, 0], base[:, 1], [0.0]), axis=-1).reshape(-1, 3)
    return np.concatenate([body.bonded_surface(1.0e-3)[0], plane])


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
        slip_share: share of the pressure that markers bear whose friction is at its limit; 0
            without contact.
    """

    displacement_m: FloatArray
    skin_position_m: FloatArray
    wrench: Wrench
    max_penetration_m: float
    contact_count: int
    iterations: int
    converged: bool
    timings_s: dict[str, float] = field(default_factory=dict)
    slip_share: float = 0.0


@dataclass(frozen=True)
class Change:
    """What the last substep changed: displacements (N, 3) of the nodes, forces (V, 3) on the
    markers, the indenter's position (3,), pressures (V,), positions (V, 3) in the indenter's frame,
    and how far it moved any marker."""

    displacement_m: FloatArray
    marker_force_n: FloatArray
    move_m: FloatArray
    pressure_pa: FloatArray
    local_m: FloatArray
    skin_m: float


@dataclass(frozen=True)
class LinearContact:
    """The linear gel of a substep as its contact saw it: the markers (A,) that might touch, sorted,
    and the root (A, 3, k) of the compliance between them."""

    marker: IndexArray
    root: NDArray[np.floating]


@dataclass
class World:
    """One environment's memory between steps, and which marker (V,) bears what presses on each in
    the present one."""

    displacement_m: FloatArray
    velocity_m_s: FloatArray
    marker_force_n: FloatArray
    skin_position_m: FloatArray
    pose: Pose | None = None
    history: ContactHistory | None = None
    last_change: Change | None = None
    patch: Patch | None = None
    close: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    region: GridRegion | None = None
    contraction: float = CONTRACTION
    response: ContactResponse | None = None
    bearer: IndexArray | None = None
    linear: LinearContact | None = None
    inertia_step_s: float = 0.0


@dataclass(frozen=True)
class Inertia:
    """Mass over the squared step (N, N), and where the nodes would go without forces (N, 3)."""

    stiffness: sparse.csr_matrix
    predicted_m: FloatArray


@dataclass(frozen=True)
class Tangents:
    """The linear solves of all substeps of one duration; an exact gel has no local one."""

    exact: ExactTangent
    local: LocalTangent | None


Observer = Callable[[World, Pose | None, Point, Inertia | None, float, int], Point]
"""Called with world, pose, solution, inertia, duration and environment of a substep before it is
finished; returns the solution to continue from."""


class ImplicitGel:
    """The total-Lagrangian gel with a rigid indenter, for a batch of environments.

    Args:
        shape: where the gel is.
        skin: the skin's markers.
        material: law, relaxation, density.
        contact: friction and stiffness of the contact.
        solver: resolution and effort.
        indenter: the rigid shape.
        bond: where the gel has come off its core; None for one that is bonded everywhere.
        environment_count: number of independent worlds.
        exact: factor the whole tangent in every iteration (a slow reference).
        progress: called with the finished share of a refinement that is not in the cache.

    Attributes:
        observer: called in every substep, None for none.
        trace: how the last step's search went.
    """

    @single_threaded()
    def __init__(
        self,
        shape: Body,
        skin: SkinMesh,
        material: Material,
        *,
        contact: ContactSpecification,
        solver: SolverSpecification,
        indenter: Indenter,
        bond: LooseBond | None = None,
        environment_count: int = 1,
        device: str = "cpu",
        exact: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.exclusive_use = ExclusiveUse("gel")
        self.shape, self.skin, self.material, self.solver = shape, skin, material, solver
        self.contact_specification, self.device = contact, device
        self.environment_count, self.exact = environment_count, exact
        self.discretization = discretize(shape, skin.rest_position_m, solver.grid_spacing_m)
        d = self.discretization
        self.points = ContactPoints(skin, solver.grid_spacing_m)
        self.skin_weight = d.skin_interpolation.matrix(d.node_count)
        lost_bond = None if bond is None else lost_stiffness(shape, d, bond, material.law)
        self.body = ElasticBody(
            d,
            material.law,
            environment_count=environment_count,
            device=device,
            lost_bond=lost_bond,
        )
        self._single = ElasticBody(
            d,
            material.law,
            environment_count=environment_count,
            dtype=np.float32,
            device=device,
            lost_bond=lost_bond,
        )
        self._relaxation = [Relaxation(material.prony) for _ in range(environment_count)]
        youngs_pa, bulk_pa = small_strain_moduli_pa(material.law)
        shear_pa = 3.0 * bulk_pa * youngs_pa / (9.0 * bulk_pa - youngs_pa)
        self._region_gradient = min(
            REGION_GRADIENT, math.sqrt(LARGEST_CONTRACTION * shear_pa / bulk_pa)
        )
        self._seen_weight = self.skin_weight[::SEEN_EVERY]
        self._far_n_m = FAR_TOLERANCES * youngs_pa * d.spacing_m
        self._mass = d.mass_over_density * material.density_kg_m3
        local: LocalTangent | None = None
        self.refinement: Refinement | None = None
        if not exact or solver.refined:
            # Trial gels of a calibration, many and each used for little, are not refined here.
            compliance = (
                kept_compliance(shape, skin.rest_position_m, d, material.law)
                if solver.refined and bond is None
                else inverse_at_rest(self._single)
            )
            if not exact:
                local = LocalTangent(self._single, compliance)
            if solver.refined:
                self.refinement = refine(
                    shape,
                    skin.rest_position_m,
                    d,
                    # What a finer grid adds near the contact is that of a bonded gel.
                    lambda: compliance if bond is None else self._bonded_at_rest(),
                    material.law,
                    progress=progress,
                )
        # By the duration of the substep that inertia is for; 0 without inertia.
        self._tangents = {0.0: Tangents(ExactTangent(self._single, self._mass * 0.0), local)}
        self._shape = shape
        self._rigid = cKDTree(rigid_points_m(shape))
        self._skin_at_rest = cKDTree(skin.rest_position_m)
        self.trace = Trace()
        self.observer: Observer | None = None
        self.set_indenter(indenter)

    @exclusive(begins=True)
    def set_indenter(self, indenter: Indenter) -> None:
        """Replace the indenter and forget the state."""
        warn_of_misfit(indenter, self.skin.rest_position_m)
        inner_point_m = _inner_point_m(indenter)
        self.contact = Contact(
            indenter,
            self.skin.rest_area_m2,
            self.body.youngs_modulus_pa,
            self.contact_specification,
            device=self.device,
        )
        self._inner_point_m = inner_point_m
        self._cleared: tuple[Pose, float] | None = None
        self.reset()

    @cached_property
    def compliance_at_rest(self) -> Float32Array:
        """(3 N, 3 N) inverse of the stiffness at rest without inertia, m/N."""
        tangents = self._tangents.get(0.0)
        if tangents is None or tangents.local is None:
            return inverse_at_rest(self._single)
        return tangents.local.compliance

    def _bonded_at_rest(self) -> Float32Array:
        bonded = ElasticBody(
            self.discretization, self.material.law, dtype=np.float32, device=self.device
        )
        return inverse_at_rest(bonded)

    @exclusive(begins=True)
    def set_relaxation(self, relaxation: PronySeries) -> None:
        """Replace the gel's relaxation and return to rest."""
        self.material = replace(self.material, prony=relaxation)
        nothing = np.zeros((self.discretization.particle_count, 3, 3))
        for environment in range(self.environment_count):
            for body in (self.body, self._single):
                body.set_history(1.0, nothing, environment)
        self.reset()

    @exclusive(begins=True)
    def reset(self) -> None:
        """Return every environment to rest."""
        self.worlds = [self._fresh_world() for _ in range(self.environment_count)]
        for environment in range(self.environment_count):
            self._relaxation[environment] = Relaxation(self.material.prony)

    def _fresh_world(self) -> World:
        shape = (self.discretization.node_count, 3)
        rest = self.skin.rest_position_m
        return World(np.zeros(shape), np.zeros(shape), np.zeros_like(rest), rest.copy())

    @exclusive()
    @single_threaded()
    def step(self, poses: Sequence[Pose | None], dt_s: float) -> list[GelState]:
        """Move the indenter of every environment to its pose (None: away) and find the gel.

        Args:
            poses: one pose of the indenter in the base frame per environment.
            dt_s: duration of the step; without inertia or relaxation it does not matter.

        Raises:
            PressTooDeepError: a pose, or the way to it, brings the indenter too close to what the
                gel is bonded to; no environment has moved.
            ValueError: as many poses as environments are needed, and a positive duration.
        """
        if len(poses) != self.environment_count:
            raise ValueError(f"{len(poses)} poses for {self.environment_count} environments")
        if not dt_s > 0.0:
            raise ValueError(f"dt_s is {dt_s}, expected a positive number of seconds")
        paths = [self._path(world, pose) for world, pose in zip(self.worlds, poses, strict=True)]
        return [self._step_world(e, path, dt_s) for e, path in enumerate(paths)]

    @exclusive()
    def place(self, environment: int, pose: Pose) -> None:
        """Put the indenter of an environment to a pose at which it touches nothing, without a way
        there; no time passes, and the next step leads on from this pose."""
        world = self.worlds[environment]
        if self.remembers:
            self._let_go(world)
        else:
            self._come_to_rest(world)
        world.pose = pose

    def check_depth(self, pose: Pose) -> None:
        """Refuse a pose that presses too deep, without moving there.

        Raises:
            PressTooDeepError: it comes too close to what the gel is bonded to.
        """
        # Many poses come in a frame, and hardly differ.
        if self._cleared is not None:
            before, spare_m = self._cleared
            moved_m = float(np.linalg.norm(pose.position_m - before.position_m))
            if moved_m < spare_m and np.array_equal(pose.quaternion_xyzw, before.quaternion_xyzw):
                return
        clearance = self._nearest_m(self._rigid, pose, CLEARANCE_REACH_M)
        self._cleared = (pose, min(clearance, CLEARANCE_REACH_M) - CORE_CLEARANCE_M)
        if clearance < CORE_CLEARANCE_M:
            raise PressTooDeepError(
                f"the indenter at {np.round(pose.position_m * 1e3, 2).tolist()} mm comes within "
                f"{clearance * 1e3:.2f} mm of the rigid core or base, expected at least "
                f"{CORE_CLEARANCE_M * 1e3:.1f} mm; press less deep"
            )

    def _step_world(self, environment: int, path: Sequence[Pose | None], dt_s: float) -> GelState:
        world = self.worlds[environment]
        trace = self.trace = Trace()
        iterations, converged = 0, True
        for waypoint in path:
            used, reached = self._substep(world, waypoint, dt_s / len(path), environment, trace)
            iterations += used
            converged = converged and reached
        world.pose = path[-1]
        response, patch = world.response, world.patch
        wrench, penetration, count, slip_share = Wrench(), 0.0, 0, 0.0
        if response is not None and patch is not None:
            # Of what the gel bears: the contact law's forces at these markers are off by as much as
            # the markers are from balance, and a micrometre of the skin is a tenth of the pressure.
            marker = patch.marker
            wrench = wrench_on_indenter(world.skin_position_m[marker], world.marker_force_n[marker])
            penetration = max(0.0, -float(response.distance_m.min(initial=np.inf)))
            count = int(np.count_nonzero(response.pressure_pa))
            slip_share = _slip_share(response, self.contact.law)
        return GelState(
            world.displacement_m.copy(),
            world.skin_position_m.copy(),
            wrench,
            penetration,
            count,
            iterations,
            converged,
            trace.timings_s,
            slip_share,
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
        count = max(1, int(np.ceil(self._way_m(world, start, pose) / LARGEST_SUBSTEP_M)))
        first, last = self._shares_near(start, pose)
        near = range(max(1, int(first * count)), min(count, int(last * count) + 2))
        path = [interpolate(start, pose, k / count) for k in near] + [pose]
        for waypoint in path:
            self.check_depth(waypoint)
        return self._from_touch(start, path) if world.response is None else list(path)

    def _from_touch(self, start: Pose, path: list[Pose]) -> list[Pose | None]:
        """Return the part of a straight path that touches the gel at rest, in moves that are
        shorter; the last pose alone where none does."""
        end = path[-1]
        while len(path) > 1 and not self._touches_rest(path[0]):
            start = path.pop(0)
        if not self._touches_rest(path[0]):
            return [end]
        way = way_m(start, end, self.contact.indenter)
        move_m = TOUCH_SHARE * self.discretization.spacing_m
        # Counted from the end: a start that is a little farther away changes none of them.
        shares = [1.0 - k * move_m / way for k in range(int(way / move_m), 0, -1)]
        short: list[Pose | None] = []
        for pose in (interpolate(start, end, share) for share in shares):
            if short or self._touches_rest(pose):
                short.append(pose)
        return [*short, end]

    def _shares_near(self, start: Pose, end: Pose) -> tuple[float, float]:
        """Return between which shares of the straight way the indenter can meet the gel at all; an
        empty interval where it never can."""
        lower, upper = self._shape.bounds_m()
        middle, corner = 0.5 * (lower + upper), 0.5 * (upper - lower)
        # What can move with it, seen from the indenter's origin.
        arm_m = float(np.linalg.norm(np.abs(self.contact.indenter.bounds_m()).max(axis=0)))
        reach_m = float(np.linalg.norm(corner)) + arm_m + NEAR_M
        way, offset = end.position_m - start.position_m, start.position_m - middle
        length_m = float(np.linalg.norm(way))
        if length_m < NEAR_M:
            return 0.0, 1.0
        # Where the line enters and leaves the ball around the gel.
        closest_m = -float(offset @ way) / length_m
        beside_m = float(np.linalg.norm(offset + closest_m / length_m * way))
        if beside_m >= reach_m:
            return 1.0, 0.0
        half_m = math.sqrt(reach_m**2 - beside_m**2)
        first, last = (closest_m - half_m) / length_m, (closest_m + half_m) / length_m
        return min(1.0, max(0.0, first)), max(0.0, min(1.0, last))

    def _way_m(self, world: World, start: Pose, end: Pose) -> float:
        """Return how far the indenter moves at most where it is close to the skin."""
        length = way_m(start, end, self.contact.indenter)
        if world.patch is None or length > PATCH_MARGIN_M:
            return length
        # The rest of it is farther from the skin than it moves.
        position = world.skin_position_m[world.patch.marker]
        local = (position - start.position_m) @ start.rotation()
        return float(np.linalg.norm(end.apply(local) - position, axis=1).max())

    def _touches_rest(self, pose: Pose) -> bool:
        """Return whether the indenter meets the gel at rest: its skin, or all of it within."""
        if self._shape.contains(pose.apply(self._inner_point_m)):
            return True
        return self._nearest_m(self._skin_at_rest, pose, ONSET_M) < ONSET_M

    def _nearest_m(self, points: cKDTree, pose: Pose, reach_m: float) -> float:
        """Return the least distance of points from the indenter, inf where all are farther than
        `reach_m` from the ball around it."""
        lower, upper = self.contact.indenter.bounds_m()
        radius_m = 0.5 * float(np.linalg.norm(upper - lower))
        near = points.query_ball_point(pose.apply(0.5 * (lower + upper)), radius_m + reach_m)
        if not near:
            return np.inf
        local = (points.data[near] - pose.position_m) @ pose.rotation()
        return float(self.contact.indenter.signed_distance(local).min())

    @exclusive()
    @single_threaded()
    def wrench_stiffness(self, environment: int) -> FloatArray:
        """Return minus the derivative (6, 6) of the wrench on the indenter by its twist, both about
        the base frame's origin, while the gel answers linearly: zero without contact."""
        world = self.worlds[environment]
        if world.linear is None or world.patch is None or world.response is None:
            return np.zeros((6, 6))
        marker, root = world.linear.marker, world.linear.root
        known = np.isin(marker, world.patch.marker)
        rows = np.searchsorted(world.patch.marker, marker[known])
        return wrench_stiffness(
            world.skin_position_m[marker[known]], root[known], world.response.stiffness[rows]
        )

    @property
    def remembers(self) -> bool:
        """Whether the gel goes on moving under an indenter that is held."""
        return self.solver.dynamic or bool(self.material.prony.shares)

    def _substep(
        self,
        world: World,
        pose: Pose | None,
        dt_s: float,
        environment: int,
        trace: Trace,
    ) -> tuple[int, bool]:
        """Advance one substep; return the iterations used and whether the tolerance was met."""
        touching = pose is not None and self._touches_rest(pose)
        if not touching and not self.remembers:
            self._come_to_rest(world)
            return 0, True
        inertia = self._prepare_memory(world, dt_s, environment)
        if pose is None:
            self._let_go(world)
        else:
            self._prepare_contact(world, pose, trace)
        start_m = world.displacement_m
        problem = self._problem(world, pose, inertia, environment)
        search = EquilibriumSearch(problem, self.solver, trace, contraction=world.contraction)
        point, iterations, converged = search.run(*self._start(world, pose))
        # A search that finds nothing to descend to needs no root; the last one is still good.
        if search.near is not None and search.root is not None:
            world.linear = LinearContact(search.near.marker, search.root)
        # One quick convergence is no promise.
        world.contraction = max(search.contraction, 0.8 * world.contraction)
        if self.observer is not None:
            point = self.observer(world, pose, point, inertia, dt_s, environment)
        clock = time.perf_counter()
        self._finish(world, pose, point, start_m, dt_s, environment)
        trace.add("skin", clock)
        return iterations, converged

    def _come_to_rest(self, world: World) -> None:
        """Without contact, inertia and relaxation the equilibrium is rest, exactly."""
        world.displacement_m = np.zeros_like(world.displacement_m)
        world.velocity_m_s = np.zeros_like(world.velocity_m_s)
        world.skin_position_m = self.skin.rest_position_m.copy()
        self._let_go(world)

    def _let_go(self, world: World) -> None:
        """Forget the contact."""
        world.marker_force_n = np.zeros_like(world.marker_force_n)
        world.history = world.last_change = world.patch = world.response = world.region = None
        world.linear = None
        world.contraction = CONTRACTION

    def _prepare_memory(self, world: World, dt_s: float, environment: int) -> Inertia | None:
        inertia = None
        if self.solver.dynamic:
            stiffness = (self._mass / dt_s**2).tocsr()
            if dt_s != world.inertia_step_s:
                world.inertia_step_s, world.region = dt_s, None
                self._make_tangents(dt_s, stiffness, environment)
            inertia = Inertia(stiffness, world.displacement_m + dt_s * world.velocity_m_s)
        self._set_relaxation(self._relaxation[environment], dt_s, environment)
        return inertia

    def _set_relaxation(self, relaxation: Relaxation, dt_s: float, environment: int) -> None:
        if self.material.prony.shares:
            terms = relaxation.step_terms(dt_s, self.discretization.particle_count)
            for body in (self.body, self._single):
                body.set_history(*terms, environment)

    def _make_tangents(self, dt_s: float, stiffness: sparse.csr_matrix, environment: int) -> None:
        """Make the linear solves of substeps with inertia (N, N), unless there are those of this
        duration. They are of a gel without a past, so that they serve every environment and do not
        depend on when they were made."""
        if dt_s in self._tangents:
            return
        used = {world.inertia_step_s for world in self.worlds}
        self._tangents = {k: v for k, v in self._tangents.items() if k in used}
        local = None
        if not self.exact:
            self._set_relaxation(Relaxation(self.material.prony), dt_s, environment)
            inverse = inverse_at_rest(self._single, stiffness, environment)
            local = LocalTangent(self._single, inverse)
        self._tangents[dt_s] = Tangents(ExactTangent(self._single, stiffness), local)

    def _prepare_contact(self, world: World, pose: Pose, trace: Trace) -> None:
        """Find the markers that may touch, and renew patch and region where they do not do."""
        clock = time.perf_counter()
        if world.history is None:
            world.history = fresh_history(world.skin_position_m, pose)
        distance = self._distance_m(world, pose)
        free = ~self.skin.on_base
        world.close = np.flatnonzero(free & (distance < REGION_MARGIN_M))
        kept = free & (distance < PATCH_KEPT_M)
        if world.patch is None or not np.all(np.isin(np.flatnonzero(kept), world.patch.marker)):
            chosen = np.flatnonzero(free & (distance < PATCH_MARGIN_M)).astype(np.int32)
            world.patch = make_patch(
                chosen, self.skin.rest_position_m, self.skin_weight, self.refinement
            )
        marker = world.patch.marker
        is_pressed = (distance[marker] < 0.0) | (world.history.pressure_pa[marker] > 0.0)
        if world.bearer is not None:
            is_borne = world.bearer[marker] != marker
            is_pressed |= is_borne & (distance[marker] < BORNE_WITHIN_M)
        world.bearer = self.points.bearers(
            marker,
            world.skin_position_m[marker],
            is_pressed,
            lambda position_m: self._answer(world, pose, marker, position_m).normal,
        )
        self.contact.set_area(self.points.area_m2(world.bearer))
        trace.add("contact", clock)

    def _answer(
        self, world: World, pose: Pose, marker: IndexArray, position_m: FloatArray
    ) -> ContactResponse:
        """Return what the indenter answers markers (C,) at positions (C, 3) without friction."""
        assert world.history is not None
        return self.contact.respond(marker, position_m, pose, world.history, no_lag(len(marker)))

    def _distance_m(self, world: World, pose: Pose) -> FloatArray:
        """Return each marker's distance from the indenter (V,), infinite where that is larger than
        any that matters."""
        assert world.history is not None
        lower, upper = self.contact.indenter.bounds_m()
        middle = pose.apply(0.5 * (lower + upper))
        reach_m = 0.5 * float(np.linalg.norm(upper - lower)) + PATCH_MARGIN_M
        offset = world.skin_position_m - middle
        near = np.flatnonzero(np.einsum("vi,vi->v", offset, offset) < reach_m**2).astype(np.int32)
        distance = np.full(self.skin.vertex_count, np.inf)
        distance[near] = self._answer(world, pose, near, world.skin_position_m[near]).distance_m
        return distance

    def elastic(
        self, displacement_m: FloatArray, inertia: Inertia | None, environment: int
    ) -> tuple[float, FloatArray]:
        """Return the energy of elasticity and inertia, J, and its gradient (N, 3) at displacements
        (N, 3)."""
        energy, found = self.body.force_in(environment, displacement_m)
        gradient: FloatArray = np.asarray(found, dtype=np.float64)
        if inertia is not None:
            push = inertia.stiffness @ (displacement_m - inertia.predicted_m)
            gradient = gradient + push
            energy += 0.5 * float(np.vdot(displacement_m - inertia.predicted_m, push))
        return energy, gradient

    def _problem(
        self, world: World, pose: Pose | None, inertia: Inertia | None, environment: int
    ) -> EquilibriumProblem:
        """Return what the search of a substep needs to know."""
        tangents = self._tangents[world.inertia_step_s]
        local = tangents.local

        def elastic(displacement_m: FloatArray) -> tuple[float, FloatArray]:
            return self.elastic(displacement_m, inertia, environment)

        def respond(marker: IndexArray, position_m: FloatArray, lag: Lag) -> ContactResponse:
            assert pose is not None
            assert world.history is not None
            return self.contact.respond(marker, position_m, pose, world.history, lag)

        def respond_now(marker: IndexArray, position_m: FloatArray) -> ContactResponse:
            assert pose is not None
            assert world.history is not None
            return self.contact.respond_now(marker, position_m, pose, world.history)

        start_m = world.displacement_m

        wide: GridRegion | None = None

        def linearise(near: NearMarkers, at_m: FloatArray | None) -> Factor:
            # At the last equilibrium the stiffness is positive definite; at a guess it need not be.
            nonlocal wide
            displacement = start_m if at_m is None else at_m
            if local is None:
                return tangents.exact.factor(displacement, environment)
            gradient = local.cell_gradient(displacement)
            if at_m is None:
                limits = (self._region_gradient, REGION_KEPT * self._region_gradient)
                region = self._region(
                    world, world.region, near, local, gradient, limits, environment
                )
                world.region = region
            else:
                # For this substep alone: it makes each of them slower.
                limits = (SLOW_SHARE * self._region_gradient,) * 2
                region = wide = self._region(
                    world, wide, near, local, gradient, limits, environment
                )
            return local.factor(region, local.assemble(region, displacement, environment))

        def at_rest(force_n: FloatArray) -> FloatArray:
            if local is None:
                return tangents.exact.factor(start_m, environment).solve(force_n)
            return local.solve_at_rest(force_n)

        bears = np.zeros(0, dtype=bool)
        if world.patch is not None and world.bearer is not None:
            bears = world.bearer[world.patch.marker] == world.patch.marker
        return EquilibriumProblem(
            world.patch,
            bears,
            elastic,
            respond,
            respond_now,
            linearise,
            at_rest,
            self.contact.least_compliance_m_n,
            self._seen_weight,
            self._far_n_m * self.solver.tolerance_m,
        )

    def _region(
        self,
        world: World,
        kept: GridRegion | None,
        near: NearMarkers,
        local: LocalTangent,
        gradient: FloatArray,
        limits: tuple[float, float],
        environment: int,
    ) -> GridRegion:
        """Return the region around the near markers and the cells whose gradients (C,) are above
        the first limit: the one kept, while it holds the markers and what is above the second."""
        if (
            kept is not None
            and not np.any(kept.number[near.node] < 0)
            and np.delete(gradient, kept.cell).max(initial=0.0) <= limits[1]
        ):
            return kept
        centre = self.skin.rest_position_m[np.union1d(near.marker, world.close)]
        gap = np.min(
            np.linalg.norm(local.cell_centre_m[:, None] - centre[None, ::3], axis=2), axis=1
        )
        cell = np.flatnonzero((gap < REGION_RADIUS_M) | (gradient > limits[0])).astype(np.int32)
        return local.region(cell, near.node, environment, kept or world.region)

    def _start(self, world: World, pose: Pose | None) -> tuple[FloatArray, Lag, Guess]:
        """Return displacements (N, 3), the limit of friction on the patch's markers and a guess of
        these, if all keeps changing in proportion to the indenter's motion."""
        share = self._share_of_last_move(world, pose)
        change = world.last_change
        displacement = world.displacement_m
        if change is not None:
            displacement = displacement + share * change.displacement_m
        patch, history = world.patch, world.history
        if patch is None or history is None or pose is None:
            return displacement, no_lag(0), Guess(np.zeros((0, 3)), np.zeros((0, 3)))
        lag = no_lag(len(patch.marker))
        force, pressure = world.marker_force_n, history.pressure_pa
        local = history.local_position_m[patch.marker]
        if change is not None:
            force = force + share * change.marker_force_n
            _forget_traces(force)
            pressure = np.maximum(0.0, pressure + share * change.pressure_pa)
        lag.pressure_pa[:] = pressure[patch.marker]
        position = pose.apply(local)
        if change is not None:
            position = self._slid_on(world, pose, local, share * change.local_m[patch.marker])
        assert world.bearer is not None
        force = borne(force, world.bearer)
        return displacement, lag, Guess(position, force[patch.marker])

    def _slid_on(
        self, world: World, pose: Pose, local_m: FloatArray, change_m: FloatArray
    ) -> FloatArray:
        """Return where the patch's markers come to lie (C, 3) that move from (C, 3) by (C, 3) in
        the indenter's frame. One that slides far passes through a pressure that stays with the
        indenter: it takes over the distance of those that were there before."""
        assert world.patch is not None
        assert world.history is not None
        history, marker = world.history, world.patch.marker
        guess: FloatArray = pose.apply(local_m + change_m)
        far = np.einsum("ci,ci->c", change_m, change_m) > FAR_SLIDE_M**2
        known = np.flatnonzero(np.isfinite(history.distance_m))
        if not far.any() or len(known) < NEIGHBOURS:
            return guess
        there = self._answer(world, pose, marker[far], guess[far])
        gap, near = cKDTree(history.local_position_m[known]).query(
            (local_m + change_m)[far], k=NEIGHBOURS
        )
        weight = 1.0 / (gap**2 + NEIGHBOUR_M**2)
        distance = np.sum(weight * history.distance_m[known][near], axis=1) / weight.sum(axis=1)
        guess[far] += (distance - there.distance_m)[:, None] * there.normal
        return guess

    def _share_of_last_move(self, world: World, pose: Pose | None) -> float:
        """Return how much of the last step's motion this one repeats: 1 at constant velocity."""
        if pose is None or world.last_change is None or world.pose is None:
            return 0.0
        move = world.last_change.move_m
        length = float(move @ move)
        # A gel that snapped, from sticking to slipping, does not snap on.
        if world.last_change.skin_m**2 >= length * SNAP**2:
            return 0.0
        along = float((pose.position_m - world.pose.position_m) @ move) / length
        return float(np.clip(along, -1.0, 2.0))

    def skin_at(
        self, displacement_m: FloatArray, patch: Patch | None, force_n: FloatArray
    ) -> FloatArray:
        """Return the skin (V, 3) at displacements (N, 3) under forces (C, 3) on a patch."""
        skin: FloatArray = self.skin.rest_position_m + self.skin_weight @ displacement_m
        if self.refinement is not None and patch is not None:
            fine_force = patch.fine_weight.T @ force_n
            loaded = np.any(fine_force, axis=1)
            added = self.refinement.displacement(patch.fine_node[loaded], fine_force[loaded])
            skin += self.refinement.skin_weight @ added
        return skin

    def _finish(
        self,
        world: World,
        pose: Pose | None,
        point: Point,
        start_m: FloatArray,
        dt_s: float,
        environment: int,
    ) -> None:
        patch = world.patch
        world.velocity_m_s = (point.displacement_m - start_m) / dt_s
        world.displacement_m = point.displacement_m
        skin_before_m = world.skin_position_m
        world.skin_position_m = self.skin_at(point.displacement_m, patch, point.force_n)
        if self.material.prony.shares:
            stress = self.body.material_stress(point.displacement_m, environment).astype(np.float64)
            self._relaxation[environment].finish_step(dt_s, stress)
        if pose is None or patch is None or world.history is None:
            world.pose = None
            return
        before, world.pose = world.pose, pose
        world.response = point.response
        history = fresh_history(world.skin_position_m, pose)
        history.local_position_m[patch.marker] = point.response.local_position_m
        history.slip_m[patch.marker] = point.response.slip_m
        history.pressure_pa[patch.marker] = point.response.pressure_pa
        history.distance_m[patch.marker] = point.response.distance_m
        marker_force = np.zeros_like(world.marker_force_n)
        marker_force[patch.marker] = point.force_n
        _forget_traces(marker_force)
        if before is not None:
            world.last_change = Change(
                point.displacement_m - start_m,
                marker_force - world.marker_force_n,
                pose.position_m - before.position_m,
                history.pressure_pa - world.history.pressure_pa,
                history.local_position_m - world.history.local_position_m,
                float(np.abs(world.skin_position_m - skin_before_m).max()),
            )
        world.marker_force_n = marker_force
        world.history = history


def _slip_share(response: ContactResponse, law: Any) -> float:
    """Return the share of the pressure that is borne by markers that slip."""
    pressure = response.pressure_pa
    limit_m = law.friction * pressure / law.tangential_stiffness
    slips = np.linalg.norm(response.slip_m, axis=1) >= AT_LIMIT * limit_m
    return float(pressure[slips].sum() / max(pressure.sum(), np.finfo(float).tiny))


def _forget_traces(force_n: FloatArray) -> None:
    """Set forces (V, 3) below `FORGOTTEN_N` to zero, in place."""
    # Takes a sixth of the time of a maximum along three columns.
    force_n[np.einsum("vi,vi->v", force_n, force_n) < FORGOTTEN_N**2] = 0.0


def _inner_point_m(indenter: Indenter) -> FloatArray:
    """Return a point (3,) of the indenter's inside, in its frame: the innermost of a grid."""
    lower, upper = indenter.bounds_m()
    axes = np.linspace(lower, upper, 17)
    points = np.stack(np.meshgrid(*axes.T, indexing="ij"), axis=-1).reshape(-1, 3)
    innermost: FloatArray = points[np.argmin(indenter.signed_distance(points))]
    return innermost
