# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""DiffTactile's gel: dynamic finite elements of linear tetrahedra under a penalty contact.

Si, Zhang, Ben, Romero, Xian, Liu, Gan: "DIFFTACTILE: A Physics-based Differentiable Tactile
Simulator for Contact-rich Robotic Manipulation", ICLR 2024: the gel and the contact as the authors'
published code writes them.

- the gel: linear tetrahedra in layers between the core and the skin, bonded at the core; the stable
  neo-Hookean solid with Lame's constants of E and nu; equal masses at the nodes; symplectic Euler;
- the contact: normal force -(kn + kd max(v_n, 0)) d with the signed distance d < 0 and the speed of
  approach v_n; friction min(kt |v_t|, mu |f_n|) against the sliding velocity v_t.

Here the forces act at the skin's vertices, for each area, and the indenter is a signed distance.

Two things make it affordable, and change nothing in a slow press. First, E = 1 and density = 1 in
the solver: the motion then depends on nu, mu, damping and kn / E alone, and the force is
proportional to E, which a line fit finds. Second, the time between two measured frames is `PERIODS`
times the slowest period of the gel, not the measured one, in which explicit steps of a real gel
would be millions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import sparse

from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.gel.distance_field import indenter_field
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, interpolate
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.warp_runtime import wp
from studies.rivals import fem_kernels
from studies.rivals.tetrahedra import (
    TetrahedralMesh,
    attach_skin,
    dome_shell,
    edge_matrices,
)
from studies.rivals.training import (
    MeasuredSurface,
    check_training,
    measured_surface,
    surface_rms_m,
)

# Measured: against four times as long the skin differs by 3 um and the force by 0.5 %.
PERIODS = 0.5
# Share of the stable step of the gel at rest; compressed elements are stiffer.
STEP_SHARE = 0.5
POWER_ITERATIONS = 60
RETREAT_M = 2.5e-4
DEVICE = "cpu"
ROUNDS = 2


@dataclass(frozen=True)
class Shell:
    """The gel's shape and how finely it is cut; the published dome has 1,910 nodes in four layers.

    Attributes:
        core_radius_m: radius of the bonded core.
        spacing_m: longest edge on the skin.
        layer_count: layers of elements.
    """

    core_radius_m: float = 0.006
    spacing_m: float = 2.5e-3
    layer_count: int = 4

    def mesh(self, skin: SkinMesh) -> TetrahedralMesh:
        """Return the tetrahedra below a dome's skin."""
        outer = float(np.linalg.norm(skin.rest_position_m, axis=1).max())
        return dome_shell(outer, self.core_radius_m, self.spacing_m, self.layer_count)


class DiffTactileDivergenceError(ValueError):
    """The explicit steps have left every bound."""


@dataclass(frozen=True)
class GelConstants:
    """What the motion depends on, in units of Young's modulus.

    Attributes:
        poisson_ratio: of the gel.
        stiffness_per_m: kn / E.
        rate: kd / kn, in units of one over the speed of a shear wave.
        drag: kt / E, in units of one over the speed of a shear wave.
        friction: Coulomb's mu.
        damping: decay of velocities, in units of the slowest angular frequency.
    """

    poisson_ratio: float
    stiffness_per_m: float
    rate: float
    drag: float
    friction: float
    damping: float


START = GelConstants(0.46, 1.0e4, 1.0, 3.0, 0.4, 0.7)
GRID: dict[str, tuple[float, ...]] = {
    "poisson_ratio": (0.38, 0.43, 0.46, 0.48, 0.49),
    "stiffness_per_m": (2.0e3, 3.0e3, 5.0e3, 1.0e4, 3.0e4),
    "friction": (0.0, 0.2, 0.4, 0.8),
    "drag": (1.0, 3.0, 10.0),
    "damping": (0.3, 0.7, 1.5),
    "rate": (0.0, 1.0, 10.0),
}
"""What the search tries of each constant, one constant after the other."""


def lame_constants(poisson_ratio: float) -> tuple[float, float]:
    """Return the shear modulus and Lame's first constant in units of Young's modulus."""
    shear = 0.5 / (1.0 + poisson_ratio)
    return shear, 2.0 * shear * poisson_ratio / (1.0 - 2.0 * poisson_ratio)


def neo_hookean_constants(poisson_ratio: float) -> tuple[float, float]:
    """Return shear and dilation constants of the stable neo-Hookean solid that is the linear one at
    small strain (Smith et al., section 3.4), in units of Young's modulus."""
    shear, first = lame_constants(poisson_ratio)
    return 4.0 / 3.0 * shear, first + 5.0 / 6.0 * shear


def stiffness_at_rest(mesh: TetrahedralMesh, poisson_ratio: float) -> sparse.csr_matrix:
    """Return the (3N, 3N) stiffness of the linear solid of unit modulus."""
    shear, first = lame_constants(poisson_ratio)
    inverse = np.linalg.inv(edge_matrices(mesh.position_m, mesh.tetrahedra))
    volume = 1.0 / (6.0 * np.linalg.det(inverse))
    gradient = np.concatenate([inverse, -inverse.sum(axis=1, keepdims=True)], axis=1)
    inner = np.einsum("tai,tbi->tab", gradient, gradient)
    block = shear * (
        np.einsum("tab,ij->taibj", inner, np.eye(3))
        + np.einsum("taj,tbi->taibj", gradient, gradient)
    ) + first * np.einsum("tai,tbj->taibj", gradient, gradient)
    block *= volume[:, None, None, None, None]
    number = 3 * mesh.tetrahedra[:, :, None] + np.arange(3)
    row = np.broadcast_to(number[:, :, :, None, None], block.shape).ravel()
    column = np.broadcast_to(number[:, None, None], block.shape).ravel()
    size = 3 * len(mesh.position_m)
    return sparse.coo_matrix((block.ravel(), (row, column)), shape=(size, size)).tocsr()


def _rows(matrix: sparse.csr_matrix) -> tuple[Any, Any, Any]:
    return matrix.indptr, matrix.indices, matrix.data


class DynamicGel:
    """The gel of one skin, ready for any constants, press and indenter.

    Args:
        mesh: its tetrahedra.
        skin: the skin on it, on which the contact acts.
    """

    def __init__(self, mesh: TetrahedralMesh, skin: SkinMesh) -> None:
        self.mesh, self.skin = mesh, skin
        self.skin_weight = attach_skin(mesh, skin)
        edges = edge_matrices(mesh.position_m, mesh.tetrahedra)
        volume = np.linalg.det(edges) / 6.0
        self.mass = float(volume.sum() / len(mesh.position_m))
        self._rest = self._array(mesh.position_m, fem_kernels.VEC3)
        self._tetrahedra = self._array(mesh.tetrahedra, wp.vec4i)
        self._inverse = self._array(np.linalg.inv(edges), fem_kernels.MAT33)
        self._volume = self._array(volume, fem_kernels.SCALAR)
        self._fixed = self._array(mesh.is_fixed, wp.bool)
        corner = mesh.tetrahedra.ravel()
        order = np.argsort(corner, kind="stable")
        entry = np.stack([order // 4, order % 4], axis=1)
        first = np.searchsorted(corner[order], np.arange(len(mesh.position_m) + 1))
        self._element_first = self._array(first, wp.int32)
        self._element_entry = self._array(entry, wp.vec2i)
        gather_first, gather_entry, gather_weight = _rows(self.skin_weight.T.tocsr())
        self._skin_first = self._array(gather_first, wp.int32)
        self._skin_entry = self._array(gather_entry, wp.int32)
        self._skin_gather = self._array(gather_weight, fem_kernels.SCALAR)
        _, spread_entry, spread_weight = _rows(self.skin_weight)
        self._skin_rest = self._array(skin.rest_position_m, fem_kernels.VEC3)
        self._skin_area = self._array(skin.rest_area_m2, fem_kernels.SCALAR)
        self._skin_node = self._array(spread_entry.reshape(-1, 3), wp.vec3i)
        self._skin_spread = self._array(spread_weight.reshape(-1, 3), fem_kernels.VEC3)

    def _array(self, values: Any, dtype: Any) -> Any:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=DEVICE)

    @cached_property
    def _contact_load(self) -> sparse.csr_matrix:
        area = sparse.diags(self.skin.rest_area_m2)
        load = self.skin_weight.T @ area @ self.skin_weight
        return sparse.kron(load, sparse.identity(3)).tocsr()

    def stable_step(self, constants: GelConstants) -> float:
        """Return the longest stable step of the gel at rest with all of its skin in contact.

        Two over the highest angular frequency, by power iteration.
        """
        stiffness = stiffness_at_rest(self.mesh, constants.poisson_ratio)
        stiffness = stiffness + constants.stiffness_per_m * self._contact_load
        free = np.repeat(~self.mesh.is_fixed, 3)
        stiffness = stiffness[free][:, free]
        vector = np.random.default_rng(0).normal(size=stiffness.shape[0])
        for _ in range(POWER_ITERATIONS):
            vector = stiffness @ (vector / np.linalg.norm(vector))
        return float(2.0 / np.sqrt(np.linalg.norm(vector) / self.mass))

    def slow_frequency(self, poisson_ratio: float) -> float:
        """Return the angular frequency of a layer as thick as the gel that shears."""
        shear, _ = lame_constants(poisson_ratio)
        radius = np.linalg.norm(self.mesh.position_m, axis=1)
        thickness = float(radius.max() - radius.min())
        return float(0.5 * np.pi / thickness * np.sqrt(shear))

    def run(
        self, poses: Sequence[Pose], indenter: Indenter, constants: GelConstants
    ) -> tuple[FloatArray, FloatArray]:
        """Return the skin (F, V, 3) and the force on the indenter (F, 3), in units of the modulus.

        The indenter comes along its axis from where it is free of the gel, and moves evenly from
        pose to pose.

        Raises:
            DiffTactileDivergenceError: the explicit steps have left every bound.
        """
        c = constants
        wave = float(np.sqrt(lame_constants(c.poisson_ratio)[0]))
        slow = self.slow_frequency(c.poisson_ratio)
        steps = int(
            np.ceil(2.0 * np.pi * PERIODS / slow / (STEP_SHARE * self.stable_step(constants)))
        )
        dt = 2.0 * np.pi * PERIODS / slow / steps
        law = fem_kernels.contact_law(
            c.stiffness_per_m, c.rate * c.stiffness_per_m / wave, c.drag / wave, c.friction
        )
        path = _path([_free_pose(poses[0], indenter, self.skin), *poses], steps)
        motion = _Motion(
            field=indenter_field(indenter, scalar=fem_kernels.SCALAR, device=DEVICE),
            bounds=indenter.bounds_m(),
            pose=self._array(path, fem_kernels.TRANSFORM),
        )
        solid = neo_hookean_constants(c.poisson_ratio)
        kept = float(np.exp(-c.damping * slow * dt))
        state = self._state_at_rest()
        skins, forces = [], []
        for frame in range(len(poses)):
            for step in range(frame * steps, (frame + 1) * steps):
                self._advance(state, motion, step, dt, law, solid, kept)
            displacement = state.displacement.numpy()
            if not np.all(np.abs(displacement) < self.mesh.position_m.max()):
                raise DiffTactileDivergenceError(
                    f"frame {frame}: the gel diverged with {constants}"
                )
            skins.append(self.skin.rest_position_m + self.skin_weight @ displacement)
            forces.append(-state.skin_force.numpy().sum(axis=0))
        return np.stack(skins), np.stack(forces)

    def _state_at_rest(self) -> _GelState:
        def zeros(*shape: int) -> Any:
            return wp.zeros(shape, dtype=fem_kernels.VEC3, device=DEVICE)

        node_count = len(self.mesh.position_m)
        return _GelState(
            position=wp.clone(self._rest),
            displacement=zeros(node_count),
            velocity=zeros(node_count),
            element_force=zeros(len(self.mesh.tetrahedra), 4),
            skin_force=zeros(self.skin.vertex_count),
        )

    def _advance(
        self,
        state: _GelState,
        motion: _Motion,
        step: int,
        dt: float,
        law: Any,
        solid: tuple[float, float],
        kept: float,
    ) -> None:
        wp.launch(
            fem_kernels.element_forces,
            dim=len(self.mesh.tetrahedra),
            inputs=[state.position, self._tetrahedra, self._inverse, self._volume, *solid],
            outputs=[state.element_force],
            device=DEVICE,
        )
        wp.launch(
            fem_kernels.contact_forces,
            dim=self.skin.vertex_count,
            inputs=[
                self._skin_rest,
                self._skin_area,
                self._skin_node,
                self._skin_spread,
                state.displacement,
                state.velocity,
                motion.field,
                fem_kernels.VEC3(*motion.bounds[0]),
                fem_kernels.VEC3(*motion.bounds[1]),
                motion.pose,
                step,
                dt,
                law,
            ],
            outputs=[state.skin_force],
            device=DEVICE,
        )
        wp.launch(
            fem_kernels.move_nodes,
            dim=len(self.mesh.position_m),
            inputs=[
                self._rest,
                self._fixed,
                self.mass,
                dt,
                kept,
                state.element_force,
                self._element_first,
                self._element_entry,
                state.skin_force,
                self._skin_first,
                self._skin_entry,
                self._skin_gather,
            ],
            outputs=[state.velocity, state.displacement, state.position],
            device=DEVICE,
        )


@dataclass(frozen=True)
class _GelState:
    """What changes from step to step: Warp arrays over nodes, elements and the skin."""

    position: Any
    displacement: Any
    velocity: Any
    element_force: Any
    skin_force: Any


@dataclass(frozen=True)
class _Motion:
    """The indenter, its box (2, 3) in its own frame, and its pose before each step."""

    field: Any
    bounds: FloatArray
    pose: Any


def _free_pose(pose: Pose, indenter: Indenter, skin: SkinMesh) -> Pose:
    """Return the pose from which the indenter comes: along its axis, clear of the skin at rest."""
    away = pose.rotation()[:, 2]
    retreat = RETREAT_M
    while True:
        free = Pose(pose.position_m + retreat * away, pose.quaternion_xyzw)
        if indenter.distance_from(skin.rest_position_m, free).min() > 0.0:
            return free
        retreat += RETREAT_M


def _path(poses: Sequence[Pose], steps: int) -> FloatArray:
    """Return (steps * (len(poses) - 1) + 1, 7) positions and quaternions, even between poses."""
    between = [
        interpolate(start, end, step / steps)
        for start, end in pairwise(poses)
        for step in range(steps)
    ]
    return np.stack(
        [np.concatenate([p.position_m, p.quaternion_xyzw]) for p in [*between, poses[-1]]]
    )


@dataclass(frozen=True)
class DiffTactile:
    """The dynamic gel with its constants.

    Attributes:
        constants: of the motion.
        youngs_modulus_pa: of the gel.
        gel: ready for the skin that it was fitted on, which is the one that it predicts.
        name: how tables call it.
    """

    constants: GelConstants
    youngs_modulus_pa: float
    gel: DynamicGel = field(repr=False, compare=False)
    name: str = "difftactile"

    def predict(self, press: Press, indenter: Indenter, _skin: SkinMesh) -> Prediction:
        """Return skin and force at the poses of a press; see `studies.geometry.scores.Model`.

        Raises:
            DiffTactileDivergenceError: the explicit steps have left every bound.
        """
        position, force = self.gel.run(press.poses, indenter, self.constants)
        return Prediction(position, self.youngs_modulus_pa * force)


@dataclass(frozen=True)
class FitTarget:
    """What the runs of a press are compared with.

    Attributes:
        surfaces: measured skin of each frame.
        motion_m2: squared distance of the skin at rest to the measured one, mean over vertices,
            summed over the frames.
        measured_n2: squared measured force, summed over the frames.
    """

    surfaces: tuple[MeasuredSurface, ...]
    motion_m2: float
    measured_n2: float


@dataclass(frozen=True)
class FitScore:
    """How a run compares with a press: sums over its frames, which add up over presses.

    Attributes:
        skin_m2: squared distance to the measured skin, mean over vertices.
        unit_force: squared force of unit modulus.
        product: force of unit modulus times measured force.
    """

    skin_m2: float
    unit_force: float
    product: float


class FitTrials:
    """Runs of presses with constants, each done once.

    Fits over several splits of the same presses, given one of these, share their runs. A press is
    known by its name.

    Args:
        gel: of the skin.
        indenters: by name.
    """

    def __init__(self, gel: DynamicGel, indenters: Mapping[str, Indenter]) -> None:
        self.gel, self.indenters = gel, indenters
        self._targets: dict[str, FitTarget] = {}
        self._done: dict[tuple[str, GelConstants], FitScore | None] = {}

    def target(self, press: Press) -> FitTarget:
        """Return what the runs of a press are compared with."""
        if press.name not in self._targets:
            assert press.skin_position_m is not None
            assert press.force_n is not None
            skin = self.gel.skin
            surfaces = tuple(measured_surface(measured, skin) for measured in press.skin_position_m)
            rest = np.repeat(skin.rest_position_m[None], press.frame_count, axis=0)
            self._targets[press.name] = FitTarget(
                surfaces,
                press.frame_count * surface_rms_m(rest, surfaces) ** 2,
                float(np.sum(press.force_n**2)),
            )
        return self._targets[press.name]

    def score(self, press: Press, constants: GelConstants) -> FitScore | None:
        """Return how a run compares with a press, None where it diverged."""
        key = (press.name, constants)
        if key not in self._done:
            assert press.force_n is not None
            self._done[key] = None
            with suppress(DiffTactileDivergenceError):
                indenter = self.indenters[press.indenter]
                position, force = self.gel.run(press.poses, indenter, constants)
                surfaces = self.target(press).surfaces
                self._done[key] = FitScore(
                    press.frame_count * surface_rms_m(position, surfaces) ** 2,
                    float(np.sum(force**2)),
                    float(np.sum(force * press.force_n)),
                )
        return self._done[key]


def fit(
    train: Sequence[Press], trials: FitTrials, *, grid: Mapping[str, Sequence[float]] = GRID
) -> DiffTactile:
    """Return DiffTactile with the best constants of a grid and the modulus of least squares.

    Coordinate descent from `START`: each constant in turn is set to the value of its row that makes
    the squared relative errors of skin and force over all presses, added up, smallest; at most
    `ROUNDS` rounds. A value is given up as soon as the presses run so far show that it is behind.

    Args:
        train: presses with skin and force.
        trials: runs with the measured skin, to be used and added to.
        grid: values to try of the constants that it names.

    Raises:
        ValueError: no press, one without skin or force, or no contact.
    """
    check_training(train)
    targets = [trials.target(press) for press in train]
    if not (any(t.motion_m2 for t in targets) and any(t.measured_n2 for t in targets)):
        raise ValueError(
            "the skin does not move, or no force is measured, in the presses to fit on; a modulus "
            "cannot be estimated"
        )
    # The largest first: they show soonest that a value is behind.
    presses = sorted(train, key=lambda press: -trials.target(press).motion_m2)
    best = START
    lowest = _cost(trials, presses, best, float("inf"))
    for _ in range(ROUNDS):
        before = best
        for name, values in grid.items():
            for value in values:
                candidate = replace(best, **{name: value})
                cost = _cost(trials, presses, candidate, lowest)
                if cost < lowest:
                    best, lowest = candidate, cost
        if best == before:
            break
    return DiffTactile(best, _modulus(trials, presses, best), trials.gel)


def _cost(
    trials: FitTrials, presses: Sequence[Press], constants: GelConstants, limit: float
) -> float:
    """Return the squared relative errors of skin and force, added up.

    Infinity where a run diverged, and where the presses run so far alone cost more than the limit:
    the rest cannot take anything off, since no modulus does better for all than each one's own.
    """
    targets = [trials.target(press) for press in presses]
    motion = sum(target.motion_m2 for target in targets)
    measured = sum(target.measured_n2 for target in targets)
    skin = unit = product = known = cost = 0.0
    for press, target in zip(presses, targets, strict=True):
        score = trials.score(press, constants)
        if score is None:
            return float("inf")
        skin += score.skin_m2
        unit += score.unit_force
        product += score.product
        known += target.measured_n2
        missed = known - (product**2 / unit if unit else 0.0)
        cost = skin / motion + missed / measured
        if cost > limit:
            return float("inf")
    return cost


def _modulus(trials: FitTrials, presses: Sequence[Press], constants: GelConstants) -> float:
    scores = [trials.score(press, constants) for press in presses]
    unit = sum(score.unit_force for score in scores if score is not None)
    if unit == 0.0 or None in scores:
        raise ValueError(
            "no indenter touches the skin in the presses to fit on, or every run diverged; a "
            "modulus cannot be estimated"
        )
    return sum(score.product for score in scores if score is not None) / unit
