# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Inertia and relaxation of the implicit gel: balances, and closed forms in time."""

from __future__ import annotations

import numpy as np
import pytest
from closed_forms import Coefficients, simple_shear_stress_pa
from gel_cases import (
    BLOCK,
    FRICTIONLESS,
    LAWS,
    YOUNGS_PA,
    FloatArray,
    at,
    one,
    pad_gel,
    pressed,
)

from dotsim_ros.gel.body import Pad
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.implicit.relaxation import Relaxation
from dotsim_ros.gel.material import Material, NeoHookean, PronySeries
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.skin_mesh import flat_pad_skin
from dotsim_ros.specification import ContactSpecification, SolverSpecification

DENSITY_KG_M3 = 1070.0
PRONY = PronySeries((0.2, 0.3), (0.05, 1.0))
BLOCK_TOP_M = BLOCK.upper_m[2]


def free_block(friction_coefficient: float = 0.0) -> ImplicitGel:
    """Return a block that nothing holds; without inertia it has no equilibrium of its own."""
    return ImplicitGel(
        BLOCK,
        flat_pad_skin((9.6e-3, 9.6e-3), BLOCK_TOP_M, 0.8e-3),
        Material(LAWS["neo_hookean"], density_kg_m3=DENSITY_KG_M3),
        contact=ContactSpecification(friction_coefficient=friction_coefficient),
        solver=SolverSpecification(
            friction_passes=100,
            grid_spacing_m=2.4e-3,
            refined=False,
            tolerance_m=3e-8,
            iterations=40,
            dynamic=True,
        ),
        indenter=sphere(8.0e-3),
        exact=True,
    )


def mass(gel: ImplicitGel) -> FloatArray:
    matrix: FloatArray = gel.discretization.mass_over_density.toarray() * DENSITY_KG_M3
    return matrix


def momentum_ns(gel: ImplicitGel) -> FloatArray:
    total: FloatArray = mass(gel).sum(axis=0) @ gel.worlds[0].velocity_m_s
    return total


def energies_j(gel: ImplicitGel) -> tuple[float, float]:
    """Return kinetic and elastic energy."""
    world = gel.worlds[0]
    kinetic = 0.5 * np.vdot(world.velocity_m_s, mass(gel) @ world.velocity_m_s)
    return float(kinetic), float(gel.body.force(world.displacement_m[None])[0][0])


@pytest.mark.parametrize("friction_coefficient", [0.0, 0.5])
def test_impulse_changes_the_momentum(friction_coefficient: float) -> None:
    gel = free_block(friction_coefficient)
    assert mass(gel).sum() == pytest.approx(DENSITY_KG_M3 * 9.6e-3**3, rel=1e-12)
    before = momentum_ns(gel)
    assert np.all(before == 0.0)
    dt = 0.5e-3
    given = 0.0
    for k in range(1, 9):
        # Down and sideways, a little next to the middle.
        state = one(gel, at(0.6e-3 + 0.02e-3 * k, -0.4e-3, BLOCK_TOP_M - 0.05e-3 * k), dt)
        assert state.converged
        given = given + -state.wrench.force_n * dt
        assert momentum_ns(gel) == pytest.approx(given, abs=1e-3 * np.linalg.norm(given))
    assert given[2] < -1e-7
    # The block goes on as it was left.
    one(gel, None, dt)
    one(gel, None, dt)
    assert momentum_ns(gel) == pytest.approx(given, abs=1e-3 * np.linalg.norm(given))


def test_free_motion_keeps_its_momentum_and_needs_no_energy() -> None:
    gel = free_block()
    velocity = np.array([0.1, -0.2, 0.05])
    gel.worlds[0].velocity_m_s[:] = velocity
    for _ in range(3):
        one(gel, None, 2e-3)
    assert gel.worlds[0].displacement_m == pytest.approx(
        np.broadcast_to(velocity * 6e-3, gel.worlds[0].displacement_m.shape), abs=1e-9
    )
    assert energies_j(gel)[1] == pytest.approx(0.0, abs=1e-12)


def ring(dt_s: float, duration_s: float) -> FloatArray:
    """Return the total energy (steps,) of a pad that swings sideways."""
    gel = pad_gel(solver={"dynamic": True, "tolerance_m": 1e-9, "iterations": 40})
    height = gel.discretization.node_position_m[:, 2]
    gel.worlds[0].displacement_m[:, 0] = 0.2e-3 * np.sin(0.5 * np.pi * height / 12e-3)
    # Long steps leave the slow modes alone.
    for _ in range(10):
        one(gel, None, 0.2e-3)
    total = [sum(energies_j(gel))]
    for _ in range(round(duration_s / dt_s)):
        assert one(gel, None, dt_s).converged
        total.append(sum(energies_j(gel)))
    return np.array(total)


def test_free_oscillation_only_loses_energy_and_less_with_smaller_steps() -> None:
    # Shear waves take 12 mm / 5.7 m/s = 2 ms from base to skin.
    lost = []
    for dt in (0.1e-3, 0.05e-3, 0.025e-3):
        total = ring(dt, 1.0e-3)
        assert np.all(np.diff(total) < 1e-6 * total[0])
        lost.append(1.0 - total[-1] / total[0])
    assert 0.0 < lost[2] < lost[1] < lost[0] < 0.3
    # Backward Euler is of first order.
    assert lost[1] / lost[2] == pytest.approx(2.0, abs=0.2)


def test_oscillation_has_the_period_of_a_shear_wave() -> None:
    size = (32.0e-3, 32.0e-3, 6.4e-3)
    gel = ImplicitGel(
        Pad(size),
        flat_pad_skin(size[:2], size[2], 1.6e-3),
        Material(LAWS["neo_hookean"], density_kg_m3=DENSITY_KG_M3),
        contact=FRICTIONLESS,
        solver=SolverSpecification(
            friction_passes=100,
            grid_spacing_m=3.2e-3,
            refined=False,
            tolerance_m=1e-9,
            dynamic=True,
        ),
        indenter=sphere(8.0e-3),
    )
    height = gel.discretization.node_position_m[:, 2]
    gel.worlds[0].displacement_m[:, 0] = 0.02 * size[2] * np.sin(0.5 * np.pi * height / size[2])
    dt, top = 0.05e-3, []
    for _ in range(40):
        state = one(gel, None, dt)
        top.append(np.mean(state.skin_position_m[:, 0] - gel.skin.rest_position_m[:, 0]))
    crossing = int(np.argmax(np.array(top) < 0.0))
    assert crossing > 0
    quarter = dt * (crossing + top[crossing - 1] / (top[crossing - 1] - top[crossing]))
    speed = np.sqrt(YOUNGS_PA / 2.0 / 1.45 / DENSITY_KG_M3)
    # The pad is five times as wide as high; what its sides bend slows it a little.
    assert quarter == pytest.approx(size[2] / speed, rel=0.08)


def test_slow_dynamic_press_is_quasi_static_and_a_fast_one_meets_inertia() -> None:
    still = one(pad_gel(), pressed(0.5e-3)).wrench.force_n
    gel = pad_gel(solver={"dynamic": True})
    slow = one(gel, pressed(0.5e-3), 100.0).wrench.force_n
    assert slow == pytest.approx(still, abs=1e-4 * still[2])
    gel.reset()
    assert one(gel, pressed(0.5e-3), 0.2e-3).wrench.force_n[2] > 1.2 * still[2]


@pytest.mark.parametrize("setting", [{"solver": {"dynamic": True}}, {"prony": PRONY}])
def test_indenter_beside_the_gel_leaves_it_at_rest(setting: dict[str, object]) -> None:
    gel = pad_gel(**setting)
    for pose in (at(0.0, 0.0, 20e-3), at(0.0, 0.0, 13e-3), None):
        state = one(gel, pose)
        assert state.converged
        assert np.abs(state.displacement_m).max() < 1e-12
        assert np.all(state.wrench.force_n == 0.0)
        assert state.max_penetration_m == 0.0
        assert state.contact_count == 0


def test_shear_step_relaxes_as_the_prony_series() -> None:
    law = LAWS["mooney_rivlin"]
    grid = discretize(BLOCK, BLOCK.bounds_m().mean(axis=0)[None], 2.4e-3)
    body, relaxation = ElasticBody(grid, law), Relaxation(PRONY)
    amount = 0.4
    field = np.zeros((1, grid.node_count, 3))
    field[0, :, 0] = amount * grid.node_position_m[:, 2]
    c10, c01, c20, c30, bulk = law.coefficients_pa()
    elastic = simple_shear_stress_pa(Coefficients(c10, c01, c20, c30, bulk), amount)
    shares, times = np.array(PRONY.shares), np.array(PRONY.times_s)
    elapsed, ramp = 0.0, 1e-5
    # Uneven steps: a hold is integrated exactly whatever they are.
    for dt in (ramp, 0.01, 0.02, 0.1, 0.5, 3.0, 40.0):
        body.set_history(*relaxation.step_terms(dt, grid.particle_count), 0)
        force = body.force(field)[1][0]
        relaxation.finish_step(dt, body.material_stress(field[0], 0))
        stress = (force.T @ grid.node_position_m)[0, 2] / grid.particle_volume_m3.sum()
        held, elapsed = elapsed, elapsed + dt
        left = 1.0 - np.sum(shares * -np.expm1(-(elapsed - ramp) / times))
        assert stress / elastic == pytest.approx(left, abs=1e-4), f"after {held + dt} s"
    assert stress / elastic == pytest.approx(1.0 - shares.sum(), abs=1e-4)


def test_ramp_converges_to_the_hereditary_integral() -> None:
    """A stress ramp S = t: the response is the integral of G, for one big step and for many."""
    shares, times = np.array(PRONY.shares), np.array(PRONY.times_s)
    duration = 0.7
    expected = duration - np.sum(shares * (duration - times * -np.expm1(-duration / times)))
    for count in (1, 3, 50):
        relaxation, dt = Relaxation(PRONY), duration / count
        for k in range(1, count + 1):
            stress = np.eye(3)[None] * k * dt
            fast, history = relaxation.step_terms(dt, 1)
            total = fast * stress + history
            relaxation.finish_step(dt, stress)
        assert total[0, 0, 0] == pytest.approx(expected, rel=1e-10)


def held_press(prony: PronySeries, law: NeoHookean, stiffness: float) -> ImplicitGel:
    contact = ContactSpecification(friction_coefficient=0.0, stiffness=stiffness)
    return pad_gel(law=law, prony=prony, contact=contact, solver={"iterations": 40})


def test_held_press_relaxes_to_the_slow_modulus() -> None:
    share = sum(PRONY.shares)
    fast = NeoHookean(YOUNGS_PA, 0.45)
    c10, _, _, _, bulk = fast.coefficients_pa()
    shear = 2.0 * c10 * (1.0 - share)
    youngs = 9.0 * bulk * shear / (3.0 * bulk + shear)
    slow = NeoHookean(youngs, 0.5 - youngs / (6.0 * bulk))
    gel = held_press(PRONY, fast, 60.0)
    depth = pressed(0.8e-3)
    first = one(gel, depth, 1e-5)
    elastic = one(held_press(PronySeries(), fast, 60.0), depth)
    assert first.converged
    assert first.wrench.force_n[2] == pytest.approx(elastic.wrench.force_n[2], rel=1e-3)
    forces = [first.wrench.force_n[2]]
    for dt in (0.02, 0.05, 0.2, 1.0, 10.0, 50.0):
        state = one(gel, depth, dt)
        assert state.converged
        forces.append(state.wrench.force_n[2])
    assert np.all(np.diff(forces) < 0.0)
    # The same contact stiffness in pascals per metre, and the same ghost penalty: neither relaxes.
    slow_gel = held_press(PronySeries(), slow, 60.0 * YOUNGS_PA / youngs)
    slow_gel.body.linear = gel.body.linear
    relaxed = one(slow_gel, depth)
    assert relaxed.converged
    assert forces[-1] == pytest.approx(relaxed.wrench.force_n[2], rel=1e-3)


def test_released_gel_recovers() -> None:
    gel = held_press(PRONY, NeoHookean(YOUNGS_PA, 0.45), 60.0)
    for dt in (0.01, 1.0, 1.0):
        one(gel, pressed(0.8e-3), dt)
    left = []
    for dt in (1e-3, 0.2, 1.0, 1.0, 1.0, 20.0, 20.0):
        state = one(gel, None, dt)
        assert np.all(state.wrench.force_n == 0.0)
        left.append(np.abs(state.skin_position_m - gel.skin.rest_position_m).max())
    assert left[0] > 50e-6
    assert np.all(np.diff(left) < 0.0)
    # The slow branch alone is left by then.
    rate = np.log(left[2] / left[4]) / 2.0
    assert 0.5 < rate < 1.0 / PRONY.times_s[1] + 0.05
    assert left[-1] < 2e-7
