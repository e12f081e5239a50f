# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The explicit method: balances, waves, contact, gradients, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp
from numpy.typing import ArrayLike, NDArray

from dotsim_ros.gel.body import Dome
from dotsim_ros.gel.explicit.gel import (
    DivergenceError,
    ExplicitGel,
    ExplicitRegion,
    ExplicitSettings,
    ExplicitState,
    stable_density_scale,
    wave_speed_m_s,
)
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.geometry.indenter import Indenter, box, load_mesh, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin, flat_pad_skin, skin_of_triangles

FloatArray = NDArray[np.float64]
PAPER_MATERIAL = NeoHookean(27_575.0, 0.303)
DENSITY = 1070.0
FRAME = 1.0 / 24.0
RADIUS = 0.01575
DOME = Dome(RADIUS, 0.006)
SKIN = dome_skin(RADIUS, 0.0012)
COARSE = ExplicitSettings(spacing_m=2.4e-3, substeps_per_frame=40, softness=30.0)


@dataclass(frozen=True)
class Block:
    """A block that floats above the base: nothing holds it."""

    lower_m: tuple[float, float, float]
    upper_m: tuple[float, float, float]

    def bounds_m(self) -> FloatArray:
        return np.array([self.lower_m, self.upper_m])

    def contains(self, points_m: FloatArray) -> NDArray[np.bool_]:
        return np.asarray(np.all((points_m >= self.lower_m) & (points_m <= self.upper_m), axis=-1))


CUBE = Block((-0.006, -0.006, 0.012), (0.006, 0.006, 0.024))


def top_skin(block: Block) -> SkinMesh:
    width, depth = np.array(block.upper_m[:2]) - block.lower_m[:2]
    return flat_pad_skin((width, depth), block.upper_m[2], 0.001)


def make_gel(body: ExplicitRegion, skin: SkinMesh, **changes: Any) -> ExplicitGel:
    arguments: dict[str, Any] = {
        "material": PAPER_MATERIAL,
        "density_kg_m3": DENSITY,
        "friction_coefficient": 0.4,
        "indenter": sphere(0.004),
        "settings": COARSE,
        "scalar": wp.float64,
    }
    return ExplicitGel(body, skin, **(arguments | changes))


def set_velocity(gel: ExplicitGel, velocity_m_s: ArrayLike, gradient_per_s: FloatArray) -> None:
    """Give every particle the velocity v + G x: velocity_m_s (3,), gradient_per_s (3, 3)."""
    gel._state.velocity.assign(velocity_m_s + particle_position_m(gel) @ gradient_per_s.T)
    shape = (gel.environment_count, gel.particle_count, 3, 3)
    gel._state.affine.assign(np.broadcast_to(gradient_per_s, shape))


def particle_position_m(gel: ExplicitGel) -> FloatArray:
    """Return the particles' positions (E, P, 3)."""
    return np.array(gel._state.position.numpy(), dtype=np.float64)


def momentum_ns(gel: ExplicitGel) -> FloatArray:
    """Return the particles' linear momentum (E, 3), with the scaled mass."""
    velocity = gel._state.velocity.numpy().astype(np.float64)
    return np.asarray(gel._particle_mass() * velocity.sum(axis=1))


def energy_j(gel: ExplicitGel) -> tuple[FloatArray, FloatArray]:
    """Return kinetic (of the particles' affine motion, scaled mass) and strain energy (E,)."""
    mass = gel._particle_mass()
    velocity = gel._state.velocity.numpy().astype(np.float64)
    affine = gel._state.affine.numpy().astype(np.float64)
    inertia = mass * gel.settings.spacing_m**2 / 4.0
    kinetic = 0.5 * mass * np.sum(velocity**2, axis=(1, 2)) + 0.5 * inertia * np.sum(
        affine**2, axis=(1, 2, 3)
    )
    f = gel._state.deformation.numpy().astype(np.float64)
    ratio = np.linalg.det(f)
    mu, bulk = gel._moduli().numpy().astype(np.float64).T[:, :, None]
    shape = ratio ** (-2.0 / 3.0) * np.sum(f**2, axis=(2, 3)) - 3.0
    density = 0.5 * mu * shape + 0.5 * bulk * (ratio - 1.0) ** 2
    return kinetic, gel._particle_volume() * density.sum(axis=1)


def free_settings(**changes: Any) -> ExplicitSettings:
    arguments: dict[str, Any] = {
        "spacing_m": 2.4e-3,
        "substeps_per_frame": 20,
        "density_scale": 1.0,
    }
    return ExplicitSettings(**(arguments | changes))


def above(depth_m: float, x_m: float = 0.0) -> Pose:
    return Pose(np.array([x_m, 0.0, RADIUS - depth_m]))


def test_free_block_keeps_its_momentum() -> None:
    gel = make_gel(CUBE, top_skin(CUBE), settings=free_settings(), frame_s=20e-5)
    stretch = np.array([[20.0, 5.0, 0.0], [-8.0, -15.0, 3.0], [0.0, 2.0, 10.0]])
    set_velocity(gel, np.array([0.1, -0.2, 0.05]), stretch)
    before = momentum_ns(gel)
    for _ in range(5):
        gel.step(None, 20e-5)
    assert momentum_ns(gel) == pytest.approx(before, rel=1e-10)


def test_free_block_falls_as_a_stone_and_scaled_mass_keeps_its_weight() -> None:
    settings = free_settings(gravity_m_s2=(0.0, 0.0, -9.81))
    gel = make_gel(CUBE, top_skin(CUBE), settings=settings, frame_s=20e-5)
    start = particle_position_m(gel)
    for _ in range(5):
        state = gel.step(None, 20e-5)
    duration, substep = 1e-3, 1e-5
    fallen = 0.5 * 9.81 * duration * (duration + substep)  # velocities are advanced first
    assert start[..., 2] - particle_position_m(gel)[..., 2] == pytest.approx(fallen, rel=1e-9)
    skin = gel.skin.rest_position_m[:, 2] - state.skin_position_m[0, :, 2]
    assert skin == pytest.approx(fallen, rel=1e-9)
    heavy = replace(settings, density_scale=9.0)
    gel = make_gel(CUBE, top_skin(CUBE), settings=heavy, frame_s=1e-3)
    gel.step(None, 1e-3)
    weight = -momentum_ns(gel)[0, 2] / 1e-3
    assert weight == pytest.approx(9.81 * DENSITY * 0.012**3, rel=1e-9)


def test_rotation_raises_no_stress() -> None:
    gel = make_gel(CUBE, top_skin(CUBE), settings=free_settings(), frame_s=20e-5)
    rate = 40.0
    spin = np.array([[0.0, -rate, 0.0], [rate, 0.0, 0.0], [0.0, 0.0, 0.0]])
    set_velocity(gel, np.zeros(3), spin)
    for _ in range(25):
        gel.step(None, 20e-5)
    kinetic, strain = energy_j(gel)
    assert strain[0] < 0.01 * kinetic[0]
    f = gel._state.deformation.numpy()[0]
    angle = np.arctan2(f[:, 1, 0], f[:, 0, 0])
    assert np.median(angle) == pytest.approx(rate * 25 * 20e-5, rel=0.02)
    stretch = np.swapaxes(f, 1, 2) @ f - np.eye(3)
    # The centrifugal stretch is of the order of rho (w L)^2 / E = 1 %.
    assert np.sqrt(np.mean(stretch**2)) < 0.01


def test_energy_is_exchanged_and_never_gained() -> None:
    gel = make_gel(CUBE, top_skin(CUBE), settings=free_settings(), frame_s=20e-5)
    stretch = np.diag([30.0, -15.0, -15.0])
    set_velocity(gel, -stretch @ [0.0, 0.0, 0.018], stretch)
    initial = energy_j(gel)[0][0]
    kinetic, strain = [], []
    for _ in range(30):
        gel.step(None, 20e-5)
        k, s = energy_j(gel)
        kinetic.append(k[0])
        strain.append(s[0])
    total = np.add(kinetic, strain)
    assert max(strain) > 0.8 * initial
    assert total.max() < 1.01 * initial
    assert total[-1] > 0.7 * initial


def test_bar_rings_at_the_speed_of_sound() -> None:
    bar = Block((-0.018, -0.003, 0.012), (0.018, 0.003, 0.018))
    material = NeoHookean(27_575.0, 0.0)
    speed = wave_speed_m_s(27_575.0, 0.0, DENSITY)
    assert speed == pytest.approx(np.sqrt(27_575.0 / DENSITY))
    settings = free_settings(spacing_m=1.2e-3, substeps_per_frame=1)
    gel = make_gel(bar, top_skin(bar), material=material, settings=settings, frame_s=8e-5)
    set_velocity(gel, np.zeros(3), np.diag([1.0, 0.0, 0.0]))
    # A free bar with velocity proportional to x stands still, all of it, after L / (2 c)
    # (d'Alembert with free ends).
    kinetic = []
    for _ in range(60):
        gel.step(None, 8e-5)
        kinetic.append(energy_j(gel)[0][0])
    still = 8e-5 * (1 + int(np.argmin(kinetic)))
    assert still == pytest.approx(0.036 / (2.0 * speed), rel=0.04)


def test_force_on_the_indenter_is_the_momentum_exchanged() -> None:
    settings = free_settings(substeps_per_frame=1)
    gel = make_gel(CUBE, top_skin(CUBE), settings=settings, frame_s=1e-5)
    impulse = np.zeros(3)
    for substep in range(60):
        height = 0.024 - 0.3 * 1e-5 * substep
        state = gel.step(Pose(np.array([0.001, 0.0, height])), 1e-5)
        impulse += state.force_n[0] * 1e-5
    assert impulse[2] > 0.0
    assert momentum_ns(gel)[0] == pytest.approx(-impulse, rel=1e-8, abs=1e-15)


def press(gel: ExplicitGel, depth_m: float, frame_count: int = 8) -> ExplicitState:
    for depth in np.linspace(0.0, depth_m, frame_count):
        state = gel.step(above(depth), FRAME)
    for _ in range(3):
        state = gel.step(above(depth_m), FRAME)
    return state


def test_press_moves_the_skin_to_the_indenter() -> None:
    state = press(make_gel(DOME, SKIN), 0.0015)
    assert 0.0 < state.max_penetration_m[0] < 2.5e-4
    apex = int(np.argmax(SKIN.rest_position_m[:, 2]))
    assert state.skin_position_m[0, apex, 2] == pytest.approx(RADIUS - 0.0015, abs=2.5e-4)
    force = state.force_n[0]
    assert force[2] > 0.05
    assert np.abs(force[:2]).max() < 0.01 * force[2]
    assert np.array_equal(
        state.skin_position_m[0, SKIN.on_base], SKIN.rest_position_m[SKIN.on_base]
    )


def test_mesh_presses_like_the_primitive(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.0025)
    ball.apply_translation([0.0, 0.0, 0.0025])
    ball.export(tmp_path / "ball.stl")
    mesh = press(make_gel(DOME, SKIN, indenter=load_mesh(tmp_path / "ball.stl")), 0.001, 5)
    primitive = press(make_gel(DOME, SKIN, indenter=sphere(0.0025)), 0.001, 5)
    assert mesh.skin_position_m == pytest.approx(primitive.skin_position_m, abs=1e-5)
    assert mesh.force_n[0][2] == pytest.approx(primitive.force_n[0][2], rel=0.01)


def test_finer_grid_penetrates_less() -> None:
    fine = ExplicitSettings(spacing_m=1.6e-3, substeps_per_frame=60, softness=20.0)
    coarse = press(make_gel(DOME, SKIN, scalar=wp.float32), 0.001, 3)
    finer = press(make_gel(DOME, SKIN, settings=fine, scalar=wp.float32), 0.001, 3)
    assert finer.max_penetration_m[0] < 0.7 * coarse.max_penetration_m[0]


def test_sliding_friction_reaches_coulombs_limit() -> None:
    gel = make_gel(DOME, SKIN, friction_coefficient=0.15)
    press(gel, 0.001, 5)
    for x in np.linspace(0.0005, 0.003, 6):
        state = gel.step(above(0.001, x), FRAME)
    # On the flank the normal leans: take the force along the contact's own normal.
    centre = np.array([x, 0.0, RADIUS - 0.001 + 0.004])
    normal = centre / np.linalg.norm(centre)
    along = state.force_n[0] @ normal
    across = state.force_n[0] - along * normal
    assert across[0] < 0.0
    assert np.linalg.norm(across) / along == pytest.approx(0.15, rel=0.2)


def test_environments_are_independent() -> None:
    gel = make_gel(DOME, SKIN, environment_count=2)
    alone = make_gel(DOME, SKIN)
    for depth in (0.0, 0.0004, 0.0008):
        both = gel.step([above(0.5 * depth), above(depth)], FRAME)
        one = alone.step(above(depth), FRAME)
    assert both.skin_position_m[1] == pytest.approx(one.skin_position_m[0], abs=1e-12)
    assert both.force_n[1] == pytest.approx(one.force_n[0], rel=1e-6, abs=1e-12)
    assert both.force_n[0][2] < 0.7 * both.force_n[1][2]


def gradient_case(values: dict[str, float]) -> ExplicitGel:
    settings = ExplicitSettings(
        spacing_m=3.0e-3, substeps_per_frame=30, softness=values["softness"], density_scale=40.0
    )
    return make_gel(
        DOME,
        SKIN,
        material=NeoHookean(np.exp(values["log_youngs_modulus"]), values["poisson_ratio"]),
        friction_coefficient=values["friction_coefficient"],
        settings=settings,
    )


@pytest.mark.parametrize(
    "build",
    [sphere, lambda radius: box([0.005, radius, 0.004], 0.0005)],
    ids=["sphere", "box"],
)
def test_tape_agrees_with_finite_differences(build: Callable[[float], Indenter]) -> None:
    values = {
        "log_youngs_modulus": np.log(27_575.0),
        "poisson_ratio": 0.303,
        "softness": 15.0,
        "friction_coefficient": 0.4,
        "indenter_size": 0.004,
    }
    poses = [above(0.0003 * k, 0.0002 * k) for k in range(3)]
    random = np.random.default_rng(0)
    by_skin = random.normal(size=(1, SKIN.vertex_count, 3))
    by_force = random.normal(size=(1, 3))

    def loss(**changes: float) -> float:
        gel = gradient_case(values | changes)
        gel.set_indenter(build((values | changes)["indenter_size"]))
        for pose in poses:
            state = gel.step(pose, FRAME)
        return float(np.sum(by_skin * state.skin_position_m) + np.sum(by_force * state.force_n))

    gel = gradient_case(values)
    gel.set_indenter(build(values["indenter_size"]))
    gel.step(poses[0], FRAME)
    _, gradient = gel.step_with_gradient(poses[1:], FRAME, lambda _: (by_skin, by_force))
    names = values if build is sphere else ["indenter_size"]
    for name in names:
        value = values[name]
        step = 1e-5 * abs(value)
        difference = (loss(**{name: value + step}) - loss(**{name: value - step})) / (2 * step)
        if name == "indenter_size":
            taped = gradient.indenter_parameters[0 if build is sphere else 1]
        else:
            taped = getattr(gradient, name)[0]
        assert taped == pytest.approx(difference, rel=1e-3), name


def test_step_with_gradient_is_a_step() -> None:
    plain, taped = make_gel(DOME, SKIN), make_gel(DOME, SKIN)
    for depth in (0.0, 0.0005):
        expected = plain.step(above(depth), FRAME)
    zero = (np.zeros((1, SKIN.vertex_count, 3)), np.zeros((1, 3)))
    state, gradient = taped.step_with_gradient([above(0.0), above(0.0005)], FRAME, lambda _: zero)
    assert state.skin_position_m == pytest.approx(expected.skin_position_m, abs=1e-12)
    assert gradient.poisson_ratio[0] == 0.0
    after = plain.step(above(0.0007), FRAME)
    assert taped.step(above(0.0007), FRAME).skin_position_m == pytest.approx(
        after.skin_position_m, abs=1e-12
    )


def test_paper_substeps_need_more_mass_in_silicone() -> None:
    speed = wave_speed_m_s(3.0e5, 0.48, DENSITY)
    assert 1.2e-3 / speed < FRAME / 100
    scale = stable_density_scale(speed, spacing_m=1.2e-3, substep_s=FRAME / 100, courant_number=0.5)
    assert speed / np.sqrt(scale) * FRAME / 100 == pytest.approx(0.5 * 1.2e-3)
    with pytest.raises(ValueError, match="density_scale above"):
        make_gel(DOME, SKIN, settings=ExplicitSettings(density_scale=1.0))
    with pytest.raises(ValueError, match="stability limit"):
        make_gel(DOME, SKIN).step(None, 20 * FRAME)


def test_a_step_that_is_not_valid_leaves_the_state_untouched() -> None:
    gel = make_gel(DOME, SKIN)
    gel.step(above(0.0), FRAME)
    before = particle_position_m(gel)
    for duration in (0.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="dt_s"):
            gel.step(above(0.001), duration)
    with pytest.raises(ValueError, match="expected 1 poses, got 2"):
        gel.step([above(0.0), above(0.0)], FRAME)
    assert np.array_equal(particle_position_m(gel), before)


def test_blow_up_is_reported_and_forgotten_by_reset() -> None:
    gel = make_gel(DOME, SKIN, scalar=wp.float32)
    fresh = press(gel, 0.001, 3)
    set_velocity(gel, np.array([0.0, 0.0, 50.0]), np.full((3, 3), 1e4))
    with pytest.raises(DivergenceError, match="reset"):
        gel.step(above(0.0), FRAME)
    gel.reset()
    again = press(gel, 0.001, 3)
    assert np.array_equal(again.skin_position_m, fresh.skin_position_m)
    assert np.array_equal(again.force_n, fresh.force_n)


@pytest.mark.parametrize(
    "changes",
    [
        {"spacing_m": 0.0},
        {"substeps_per_frame": 0},
        {"density_scale": 0.0},
        {"courant_number": float("nan")},
    ],
)
def test_invalid_settings_are_refused(changes: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(changes))):
        ExplicitSettings(**changes)  # type: ignore[arg-type]


def test_skin_beyond_the_gel_stays_where_it_is() -> None:
    away = skin_of_triangles(
        [[0.0, 0.0, 0.032], [0.001, 0.0, 0.032], [0.0, 0.001, 0.032]], [[0, 1, 2]]
    )
    gel = make_gel(CUBE, away, settings=free_settings(), frame_s=20e-5)
    set_velocity(gel, np.array([0.1, 0.0, 0.0]), np.zeros((3, 3)))
    state = gel.step(None, 20e-5)
    assert np.array_equal(state.skin_position_m[0], away.rest_position_m)
