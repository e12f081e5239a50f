# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's explicit Material Point Method (its section III-A, equations 1 to 4), in Warp.

A frame is a number of substeps; each moves momentum to the grid, applies the contact model, moves
it back, and advances the indenter. It is the reference that the implicit gel is compared with.

Readings of what the paper leaves open
- Softness: "particles within 1/softness are considered in contact", 15 at 1.2 mm and 30 at 2.4 mm.
  Taken in cells, so the contact range is spacing / softness, both rows of its table mean the same
  0.08 mm; in metres they would mean 67 and 33 mm, more than the sensor. Softness here is therefore
  a number without unit. The particles meant are those of the surface, here the skin's markers.
- Contact model: on the grid (equation 2). Each skin marker in contact wants a change of velocity:
  along the normal at least the indenter's (and any penetration back), along the surface
  Coulomb's law. A node takes the mean of what the skin in its support wants.
- Time: 100 substeps of a 24 Hz frame are longer than a stable step in silicone (spacing over the
  speed of pressure waves). The gel's mass is scaled up until the step is stable, which for slow
  presses is the same as compressing time by the square root of that factor.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.body import Dome
from dotsim_ros.gel.distance_field import indenter_field
from dotsim_ros.gel.explicit.kernels import (
    FRICTION,
    LOG_YOUNGS_MODULUS,
    PARAMETER_COUNT,
    POISSON_RATIO,
    SMALLEST_VOLUME_RATIO,
    SOFTNESS,
    explicit_kernels,
)
from dotsim_ros.gel.explicit.state import (
    clear,
    copy_particles,
    new_motion,
    new_nodes,
    new_particles,
)
from dotsim_ros.gel.material import NeoHookean, bulk_modulus_pa, shear_modulus_pa
from dotsim_ros.geometry.indenter import Indenter, sphere, warn_of_misfit
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.warp_runtime import wp

GRID_MARGIN_CELLS = 5
# Share of a penetration that skin in contact wants back in one substep.
CONTACT_RECOVERY = 1.0
PAPER_FRAME_S = 1.0 / 24.0


class DivergenceError(RuntimeError):
    """The explicit simulation became unstable; reset it, and take more substeps or more mass."""


class ExplicitRegion(Protocol):
    """What the explicit method needs of a shape: any `Body` is one."""

    def bounds_m(self) -> FloatArray:
        """Return the (2, 3) lower and upper corner of a box around the material."""

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return for points (..., 3) whether they lie in the material."""


@dataclass(frozen=True)
class ExplicitSettings:
    """How the explicit method discretises; the defaults are the paper's main row.

    Attributes:
        spacing_m: distance between grid nodes.
        substeps_per_frame: substeps in each call of `step`.
        softness: contact range is spacing / softness (no unit).
        particles_per_axis: particles along each axis of a cell, on a regular lattice.
        density_scale: factor on the gel's mass; None: the smallest that is stable, at least 1.
            Equivalent to compressing time by its square root.
        courant_number: largest substep in units of spacing over wave speed.
        gravity_m_s2: acceleration of the gel, base frame (divided by density_scale, so that the
            weight is the real one).
        damping_per_s: rate at which the grid's velocity decays. The paper names none; with
            scaled mass a stiff gel rings for many frames, and 50 quietens it.
    """

    spacing_m: float = 1.2e-3
    substeps_per_frame: int = 100
    softness: float = 15.0
    particles_per_axis: int = 2
    density_scale: float | None = None
    courant_number: float = 0.5
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    damping_per_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("spacing_m", "softness", "courant_number"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be a positive number, got {value}")
        for name in ("substeps_per_frame", "particles_per_axis"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.density_scale is not None and not self.density_scale > 0.0:
            raise ValueError(f"density_scale must be positive, got {self.density_scale}")
        if not self.damping_per_s >= 0.0:
            raise ValueError(f"damping_per_s must not be negative, got {self.damping_per_s}")


@dataclass(frozen=True)
class ExplicitState:
    """What a step returns, for E environments and V skin vertices, in the base frame.

    Attributes:
        skin_position_m: (E, V, 3).
        force_n: (E, 3) of the gel on the indenter, mean over the last quarter of the substeps.
        torque_nm: (E, 3) likewise, about the base frame's origin.
        max_penetration_m: (E,) deepest skin vertex below the indenter's surface, at least 0.
    """

    skin_position_m: FloatArray
    force_n: FloatArray
    torque_nm: FloatArray
    max_penetration_m: FloatArray


@dataclass(frozen=True)
class ParameterGradient:
    """Derivatives of a loss.

    Attributes:
        log_youngs_modulus, poisson_ratio, softness, friction_coefficient: (E,) each.
        indenter_parameters: (n,) by `Indenter.parameters` of a primitive, summed over the
            environments; (1,) zero for a mesh.
    """

    log_youngs_modulus: FloatArray
    poisson_ratio: FloatArray
    softness: FloatArray
    friction_coefficient: FloatArray
    indenter_parameters: FloatArray


LossGradient = Callable[[ExplicitState], tuple[FloatArray, FloatArray]]


def wave_speed_m_s(youngs_modulus_pa: float, poisson_ratio: float, density_kg_m3: float) -> float:
    """Return the speed of pressure waves, sqrt((K + 4/3 mu) / rho)."""
    stiffness = bulk_modulus_pa(youngs_modulus_pa, poisson_ratio) + 4.0 / 3.0 * shear_modulus_pa(
        youngs_modulus_pa, poisson_ratio
    )
    return float(np.sqrt(stiffness / density_kg_m3))


def stable_density_scale(
    wave_speed: float, *, spacing_m: float, substep_s: float, courant_number: float
) -> float:
    """Return the least factor on the mass for which a substep is stable, at least 1."""
    return max(1.0, (wave_speed * substep_s / (courant_number * spacing_m)) ** 2)


def sample_body(body: ExplicitRegion, particle_spacing_m: float) -> FloatArray:
    """Return the points (P, 3) of a regular lattice that lie in the body."""
    lower, upper = body.bounds_m()
    first = np.floor(lower / particle_spacing_m).astype(int)
    last = np.ceil(upper / particle_spacing_m).astype(int)
    axes = [(np.arange(first[axis], last[axis]) + 0.5) * particle_spacing_m for axis in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(points[body.contains(points)])


class ExplicitGel:
    """A gel simulated by the paper's explicit method.

    Args:
        body: the gel's shape; its base plane z = 0 and, for a dome, its core are fixed.
        skin: the surface that moves with the gel and touches the indenter.
        material: Young's modulus and Poisson's ratio.
        density_kg_m3: of the gel.
        friction_coefficient: between skin and indenter.
        indenter: what presses.
        settings: grid, substeps, contact.
        frame_s: duration of a frame, from which a density scale is derived where none is set.
        environment_count: E independent worlds side by side.
        device: Warp device.
        scalar: `wp.float32`, or `wp.float64` for exact gradients.

    Raises:
        ValueError: a number is out of range, or the density scale given is not stable.
    """

    def __init__(
        self,
        body: ExplicitRegion,
        skin: SkinMesh,
        *,
        material: NeoHookean,
        density_kg_m3: float,
        friction_coefficient: float,
        indenter: Indenter,
        settings: ExplicitSettings | None = None,
        frame_s: float = PAPER_FRAME_S,
        environment_count: int = 1,
        device: str = "cpu",
        scalar: Any = wp.float32,
    ) -> None:
        if not friction_coefficient >= 0.0:
            raise ValueError(f"friction_coefficient must be at least 0, got {friction_coefficient}")
        if not density_kg_m3 > 0.0:
            raise ValueError(f"density_kg_m3 must be positive, got {density_kg_m3}")
        if not frame_s > 0.0:
            raise ValueError(f"frame_s must be positive, got {frame_s}")
        if environment_count < 1:
            raise ValueError(f"environment_count must be at least 1, got {environment_count}")
        self.settings = settings or ExplicitSettings()
        self.skin = skin
        self.environment_count = environment_count
        self._device = device
        self._scalar = scalar
        self._kernels = explicit_kernels(scalar)
        self._density_kg_m3 = density_kg_m3
        self._rest = sample_body(body, self.settings.spacing_m / self.settings.particles_per_axis)
        if len(self._rest) == 0:
            raise ValueError("the body holds no particle; choose a smaller spacing_m")
        self._make_grid(body)
        self._skin_area: Any = wp.array(skin.rest_area_m2, dtype=scalar, device=device)
        self._held: Any = wp.array(skin.on_base.astype(np.int32), dtype=wp.int32, device=device)
        speed = wave_speed_m_s(material.youngs_modulus_pa, material.poisson_ratio, density_kg_m3)
        substep_s = frame_s / self.settings.substeps_per_frame
        self.density_scale = self.settings.density_scale or stable_density_scale(
            speed,
            spacing_m=self.settings.spacing_m,
            substep_s=substep_s,
            courant_number=self.settings.courant_number,
        )
        self._parameters: Any = wp.zeros(
            (environment_count, PARAMETER_COUNT), dtype=scalar, device=device, requires_grad=True
        )
        self.set_parameters(
            material=material,
            softness=self.settings.softness,
            friction_coefficient=friction_coefficient,
        )
        self._check_stable(substep_s)
        self.set_indenter(indenter)
        self._smallest_ratio: Any = wp.zeros(environment_count, dtype=scalar, device=device)
        self._state = self._new_state(requires_grad=False)
        self._spare = self._new_state(requires_grad=False)
        self._nodes = self._new_nodes(requires_grad=False)
        self.reset()

    @property
    def particle_count(self) -> int:
        return len(self._rest)

    @property
    def node_count(self) -> int:
        return int(np.prod(self._node_count))

    def set_indenter(self, indenter: Indenter) -> None:
        """Replace the indenter; its next pose is taken as its first."""
        warn_of_misfit(indenter, self.skin.rest_position_m)
        self.indenter = indenter
        self._field = indenter_field(indenter, scalar=self._scalar, device=self._device)
        self._last_pose: tuple[Pose, ...] | None = None

    def set_parameters(
        self, *, material: NeoHookean, softness: float, friction_coefficient: float
    ) -> None:
        """Set what calibration fits, in every environment; the density scale stays as it is."""
        row = np.zeros(PARAMETER_COUNT)
        row[LOG_YOUNGS_MODULUS] = np.log(material.youngs_modulus_pa)
        row[POISSON_RATIO] = material.poisson_ratio
        row[SOFTNESS] = softness
        row[FRICTION] = friction_coefficient
        self._wave_speed_m_s = wave_speed_m_s(
            material.youngs_modulus_pa, material.poisson_ratio, self._density_kg_m3
        )
        self._parameters.assign(np.tile(row, (self.environment_count, 1)))

    def reset(self) -> None:
        """Return to rest, without an indenter."""
        shape = (self.environment_count, self.particle_count)
        self._state.position.assign(np.broadcast_to(self._rest, (*shape, 3)))
        self._state.velocity.zero_()
        self._state.affine.zero_()
        self._state.deformation.assign(np.broadcast_to(np.eye(3), (*shape, 3, 3)))
        skin = self.skin.rest_position_m
        self._state.skin.assign(np.broadcast_to(skin, (self.environment_count, *skin.shape)))
        self._last_pose = None

    def place(self, pose: Pose | Sequence[Pose]) -> None:
        """Put the indenter where it touches nothing: the next step moves it from there.

        Raises:
            ValueError: as many poses as environments, or one for all, are needed.
        """
        self._last_pose = self._poses(pose)

    def step(self, pose: Pose | Sequence[Pose] | None, dt_s: float) -> ExplicitState:
        """Simulate one frame, in which the indenter moves evenly from its last pose to this one.

        Args:
            pose: of the indenter in the base frame: one for all environments, one for each, or
                None where there is no indenter.
            dt_s: duration of the frame.

        Raises:
            ValueError: invalid duration or number of poses, or a substep beyond the stability
                limit; the state is untouched.
            DivergenceError: the simulation has become unstable; call `reset`.
        """
        poses = None if pose is None else self._poses(pose)
        substep_s = self._substep(dt_s)
        motion = None if poses is None else self._motion(poses, substep_s, requires_grad=False)
        moduli = self._moduli()
        self._smallest_ratio.fill_(1.0)
        for substep in range(self.settings.substeps_per_frame):
            clear(self._nodes)
            self._advance(self._state, self._nodes, self._spare, motion, moduli, substep, substep_s)
            self._state, self._spare = self._spare, self._state
        self._last_pose = poses
        return self._report(self._state, motion)

    def step_with_gradient(
        self, poses: Sequence[Pose], dt_s: float, loss_gradient: LossGradient
    ) -> tuple[ExplicitState, ParameterGradient]:
        """Simulate frames on a tape and return the derivatives of a loss of the last one.

        The states of all substeps and their adjoints are kept. The density scale and the
        state at the start count as constants. In single precision the derivatives are within
        1e-4 of those in double; finite differences need the latter.

        Args:
            poses: of the indenter at the end of each frame, for all environments.
            dt_s: duration of each frame.
            loss_gradient: maps the last state to the loss's derivatives by skin_position_m
                (E, V, 3) and by force_n (E, 3).

        Raises:
            ValueError, DivergenceError: as `step`.
        """
        if len(poses) == 0:
            raise ValueError("poses must hold at least one pose, got none")
        substep_s = self._substep(dt_s)
        count = self.settings.substeps_per_frame
        state = self._new_state(requires_grad=True)
        copy_particles(self._state, state)
        self._parameters.grad.zero_()
        self._field.parameters.grad.zero_()
        self._smallest_ratio.fill_(1.0)
        tape = wp.Tape()
        with tape:
            moduli = self._moduli()
            for pose in poses:
                placed = self._poses(pose)
                motion = self._motion(placed, substep_s, requires_grad=True)
                for substep in range(count):
                    following = self._new_state(requires_grad=True)
                    nodes = self._new_nodes(requires_grad=True)
                    self._advance(state, nodes, following, motion, moduli, substep, substep_s)
                    state = following
                self._last_pose = placed
        copy_particles(state, self._state)
        result = self._report(state, motion)
        by_skin, by_force = loss_gradient(result)
        averaged = self._averaged()
        seed = np.zeros((count, self.environment_count, 3))
        seed[averaged] = np.asarray(by_force) / (count - averaged.start)
        state.skin.grad.assign(np.asarray(by_skin))
        motion.force.grad.assign(seed)
        tape.backward()
        gradient = self._parameters.grad.numpy().astype(np.float64)
        return result, ParameterGradient(
            log_youngs_modulus=gradient[:, LOG_YOUNGS_MODULUS],
            poisson_ratio=gradient[:, POISSON_RATIO],
            softness=gradient[:, SOFTNESS],
            friction_coefficient=gradient[:, FRICTION],
            indenter_parameters=self._field.parameters.grad.numpy().astype(np.float64),
        )

    def _make_grid(self, body: ExplicitRegion) -> None:
        spacing = self.settings.spacing_m
        lower, upper = body.bounds_m()
        # A plane of nodes lies on the base.
        first = np.floor(lower / spacing).astype(int) - GRID_MARGIN_CELLS
        last = np.ceil(upper / spacing).astype(int) + GRID_MARGIN_CELLS
        self._node_count = last - first + 1
        self._grid = self._kernels.Grid()
        self._grid.count = wp.vec3i(*self._node_count.tolist())
        self._grid_origin_m = first * spacing
        self._grid.origin = wp.types.vector(3, self._scalar)(*self._grid_origin_m)
        self._grid.spacing = spacing
        axes = [spacing * np.arange(first[axis], last[axis] + 1) for axis in range(3)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        fixed = nodes[:, 2] <= 0.0
        if isinstance(body, Dome):
            fixed |= np.linalg.norm(nodes, axis=1) <= body.core_radius_m
        self._fixed: Any = wp.array(fixed.astype(np.int32), dtype=wp.int32, device=self._device)

    def _particle_volume(self) -> float:
        return (self.settings.spacing_m / self.settings.particles_per_axis) ** 3

    def _particle_mass(self) -> float:
        return self._density_kg_m3 * self.density_scale * self._particle_volume()

    def _new_state(self, *, requires_grad: bool) -> Any:
        return new_particles(
            self._kernels,
            (self.environment_count, self.particle_count),
            self.skin.vertex_count,
            device=self._device,
            requires_grad=requires_grad,
        )

    def _new_nodes(self, *, requires_grad: bool) -> Any:
        return new_nodes(
            self._kernels,
            (self.environment_count, self.node_count),
            device=self._device,
            requires_grad=requires_grad,
        )

    def _poses(self, pose: Pose | Sequence[Pose]) -> tuple[Pose, ...]:
        poses = (pose,) * self.environment_count if isinstance(pose, Pose) else tuple(pose)
        if len(poses) != self.environment_count:
            raise ValueError(f"expected {self.environment_count} poses, got {len(poses)}")
        return poses

    def _substep(self, dt_s: float) -> float:
        if not (np.isfinite(dt_s) and dt_s > 0.0):
            raise ValueError(f"dt_s must be a positive duration, got {dt_s}")
        substep_s = dt_s / self.settings.substeps_per_frame
        self._check_stable(substep_s)
        return substep_s

    def _check_stable(self, substep_s: float) -> None:
        limit = self.settings.spacing_m * np.sqrt(self.density_scale) / self._wave_speed_m_s
        # Derived scales sit at courant_number; a calibration may stiffen the gel up to the limit.
        if substep_s > limit:
            scale = self.density_scale * (substep_s / limit) ** 2
            raise ValueError(
                f"a substep of {substep_s:.3g} s is beyond the stability limit of {limit:.3g} s; "
                f"take more substeps, shorter frames, or a density_scale above {scale:.3g}"
            )

    def _moduli(self) -> Any:
        moduli: Any = wp.zeros(
            self.environment_count,
            dtype=wp.types.vector(2, self._scalar),
            device=self._device,
            requires_grad=True,
        )
        wp.launch(
            self._kernels.elastic_moduli,
            self.environment_count,
            inputs=[self._parameters],
            outputs=[moduli],
            device=self._device,
        )
        return moduli

    def _motion(self, poses: tuple[Pose, ...], substep_s: float, *, requires_grad: bool) -> Any:
        return new_motion(
            self._kernels,
            self._last_pose or poses,
            poses,
            self.settings.substeps_per_frame,
            substep_s,
            device=self._device,
            requires_grad=requires_grad,
        )

    def _advance(
        self,
        particles: Any,
        nodes: Any,
        following: Any,
        motion: Any,
        moduli: Any,
        substep: int,
        substep_s: float,
    ) -> None:
        """One substep: equations 1 to 3; `motion` is None where there is no indenter."""
        settings, kernels, grid = self.settings, self._kernels, self._grid
        each_particle = (self.environment_count, self.particle_count)
        each_marker = (self.environment_count, self.skin.vertex_count)
        each_node = (self.environment_count, self.node_count)

        def launch(kernel: Any, dim: tuple[int, int], inputs: list[Any]) -> None:
            wp.launch(kernel, dim, inputs=inputs, device=self._device)

        mass, volume = self._particle_mass(), self._particle_volume()
        launch(
            kernels.particle_to_grid,
            each_particle,
            [grid, mass, volume, substep_s, moduli, particles, nodes],
        )
        acceleration = wp.types.vector(3, self._scalar)(
            *(np.array(settings.gravity_m_s2) / self.density_scale)
        )
        decay = float(np.exp(-settings.damping_per_s * substep_s))
        launch(
            kernels.free_velocity,
            each_node,
            [substep_s, acceleration, decay, self._fixed, nodes],
        )
        velocity = nodes.free
        if motion is not None:
            velocity = nodes.velocity
            launch(
                kernels.touch,
                each_marker,
                [
                    grid,
                    self._field,
                    motion,
                    substep,
                    substep_s,
                    CONTACT_RECOVERY,
                    self._parameters,
                    self._skin_area,
                    particles,
                    nodes,
                ],
            )
            launch(
                kernels.correct_velocity,
                each_node,
                [grid, substep, substep_s, self._fixed, nodes, motion],
            )
        launch(
            kernels.grid_to_particle,
            each_particle,
            [grid, substep_s, velocity, particles, following, self._smallest_ratio],
        )
        launch(
            kernels.carry_skin,
            each_marker,
            [grid, substep_s, self._held, nodes.mass, velocity, particles, following],
        )

    def _averaged(self) -> slice:
        """The substeps of a frame over which a wrench is averaged."""
        count = self.settings.substeps_per_frame
        return slice(count - max(1, count // 4), count)

    def _report(self, state: Any, motion: Any) -> ExplicitState:
        self._check_finite(state)
        environments = self.environment_count
        force, torque = np.zeros((2, environments, 3))
        deepest = np.zeros(environments)
        if motion is not None:
            averaged = self._averaged()
            force = motion.force.numpy()[averaged].astype(np.float64).mean(axis=0)
            torque = motion.torque.numpy()[averaged].astype(np.float64).mean(axis=0)
            penetration: Any = wp.zeros(environments, dtype=self._scalar, device=self._device)
            wp.launch(
                self._kernels.penetration,
                (environments, self.skin.vertex_count),
                inputs=[
                    self._field,
                    motion.pose,
                    self.settings.substeps_per_frame - 1,
                    state.skin,
                ],
                outputs=[penetration],
                device=self._device,
            )
            deepest = penetration.numpy().astype(np.float64)
        skin = state.skin.numpy().astype(np.float64)
        return ExplicitState(skin, force, torque, deepest)

    def _check_finite(self, state: Any) -> None:
        ratio = self._smallest_ratio.numpy()
        spacing = self.settings.spacing_m
        first = self._grid_origin_m + 2.0 * spacing
        last = first + (self._node_count - 5) * spacing
        position = state.position.numpy()
        # Written so that a number that is not finite counts as outside.
        inside = np.all((position > first) & (position < last), axis=(1, 2))
        for environment in range(self.environment_count):
            if ratio[environment] <= SMALLEST_VOLUME_RATIO or not inside[environment]:
                what = (
                    "a particle left the grid"
                    if not inside[environment]
                    else (f"a particle shrank below {SMALLEST_VOLUME_RATIO} of its volume")
                )
                raise DivergenceError(
                    f"the explicit gel diverged in environment {environment}: {what}; call "
                    "reset(), then press more slowly or less deeply, or take more substeps"
                )


def explicit_seconds_per_frame(
    *, spacing_m: float, substeps_per_frame: int, frame_count: int = 1, device: str = "cpu"
) -> float:
    """Return the wall time of a frame of the explicit method.

    A 4 mm sphere presses the stand-in dome (15.75 mm, core 6 mm, skin at 0.5 mm, the paper's
    E = 27,575 Pa and nu = 0.303) at 5 mm/s; kernels are compiled before the clock starts.

    Args:
        spacing_m, substeps_per_frame: 1.2e-3 and 100 are the paper's; it also lists 2.4e-3.
        frame_count: frames of 1/24 s to average over.
        device: Warp device.
    """
    softness = 15.0 * spacing_m / 1.2e-3
    gel = ExplicitGel(
        Dome(0.01575, 0.006),
        dome_skin(0.01575, 0.0005),
        material=NeoHookean(27_575.0, 0.303),
        density_kg_m3=1070.0,
        friction_coefficient=0.4,
        indenter=sphere(0.004),
        settings=ExplicitSettings(
            spacing_m=spacing_m, substeps_per_frame=substeps_per_frame, softness=softness
        ),
        device=device,
    )
    height = 0.01575
    gel.step(Pose(np.array([0.0, 0.0, height])), PAPER_FRAME_S)
    start = time.perf_counter()
    for frame in range(frame_count):
        depth = 0.005 * PAPER_FRAME_S * (frame + 1)
        gel.step(Pose(np.array([0.0, 0.0, height - depth])), PAPER_FRAME_S)
    return (time.perf_counter() - start) / frame_count
