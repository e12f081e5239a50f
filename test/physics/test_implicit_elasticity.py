# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel's elastic body: patch test, rigid motion, curves of each law, consistent stiffness."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from closed_forms import Coefficients, simple_shear_stress_pa, strain_energy, uniaxial
from gel_cases import BALL, BLOCK, DOME, LAWS, FloatArray, FloatingBall, FloatingBlock

from dotsim_ros.gel.body import Body, Dome
from dotsim_ros.gel.discretization import STENCIL, Discretization, discretize
from dotsim_ros.gel.elasticity import ElasticBody, region_base
from dotsim_ros.geometry.skin_mesh import dome_skin

SPACING_M = 1.6e-3
LINEAR_MAP = np.array([[0.05, -0.08, 0.02], [0.11, -0.06, 0.04], [0.03, 0.07, 0.09]])


@cache
def grid_of(body: Body) -> Discretization:
    return discretize(body, body.bounds_m().mean(axis=0)[None], SPACING_M)


def elastic(body: Body, law: str) -> ElasticBody:
    return ElasticBody(grid_of(body), LAWS[law])


def linear_field(body: ElasticBody, deformation: FloatArray) -> FloatArray:
    """Return nodal displacements (1, N, 3) of the homogeneous deformation F."""
    position = body.discretization.node_position_m
    return (position @ (deformation - np.eye(3)).T)[None]


def mean_stress_pa(body: ElasticBody, displacement_m: FloatArray) -> FloatArray:
    """Return the mean first Piola-Kirchhoff stress (3, 3): the virial of the nodal forces."""
    _, force = body.force(displacement_m)
    volume = body.discretization.particle_volume_m3.sum()
    result: FloatArray = force[0].T @ body.discretization.node_position_m / volume
    return result


def closed_form(law: str) -> Coefficients:
    c10, c01, c20, c30, bulk = LAWS[law].coefficients_pa()
    return Coefficients(c10, c01, c20, c30, bulk)


def interior(grid: Discretization) -> np.ndarray:
    """Return which nodes (N,) have nothing but full cells under their spline."""
    cell = np.floor(grid.particle_position_m / grid.spacing_m).astype(int)
    kinds, inverse = np.unique(cell, axis=0, return_inverse=True)
    filled = np.bincount(inverse.reshape(-1), grid.particle_volume_m3) / grid.spacing_m**3
    full = {tuple(c) for c, share in zip(kinds.tolist(), filled, strict=True) if share > 1 - 1e-9}
    return np.array(
        [all(tuple(c) in full for c in (cell + STENCIL).tolist()) for cell in grid.node_cell]
    )


@pytest.mark.parametrize("law", LAWS)
def test_patch(law: str) -> None:
    body = elastic(BALL, law)
    field = linear_field(body, np.eye(3) + LINEAR_MAP)
    stress = body.material_stress(field[0], 0)
    assert np.abs(stress - stress[0]).max() < 1e-9 * np.abs(stress[0]).max()
    _, force = body.force(field)
    inside = interior(body.discretization)
    assert inside.sum() > 30
    largest = np.abs(force[0]).max()
    assert np.abs(force[0][inside]).max() < 1e-11 * largest
    assert np.abs(force[0].sum(axis=0)).max() < 1e-11 * largest


def test_patch_is_recovered_from_its_boundary() -> None:
    body = elastic(BALL, "neo_hookean")
    expected = linear_field(body, np.eye(3) + LINEAR_MAP)
    inside = interior(body.discretization)
    free = np.flatnonzero(np.repeat(inside, 3))
    noise = np.random.default_rng(3).uniform(-0.1e-3, 0.1e-3, expected.shape)
    found = expected + np.where(inside[None, :, None], noise, 0.0)
    for _ in range(6):
        _, force = body.force(found)
        stiffness = body.stiffness(found[0], 0)[free][:, free].toarray()
        found.reshape(-1)[free] -= np.linalg.solve(stiffness, force.reshape(-1)[free])
    assert np.abs(found - expected).max() < 1e-12


def test_linear_field_at_the_base_on_a_cut_dome() -> None:
    law = LAWS["mooney_rivlin"]
    skin = dome_skin(DOME.outer_radius_m, 2.0e-3)
    grid = discretize(Dome(DOME.outer_radius_m, 0.0), skin.rest_position_m, SPACING_M)
    body = ElasticBody(grid, law)
    slope = np.array([0.1, -0.05, 0.08])
    field = grid.node_position_m[None, :, 2:] * slope
    stress = body.material_stress(field[0], 0)
    assert np.abs(stress - stress[0]).max() < 1e-9 * np.abs(stress[0]).max()
    carried = grid.skin_interpolation.matrix(grid.node_count) @ field[0]
    assert carried == pytest.approx(skin.rest_position_m[:, 2:] * slope, abs=1e-10)


@pytest.mark.parametrize("law", LAWS)
def test_rigid_motion_costs_nothing(law: str) -> None:
    body, angle_rad = elastic(BALL, law), 2.5
    axis = np.array([1.0, -2.0, 0.5]) / np.linalg.norm([1.0, -2.0, 0.5])
    cross = np.cross(np.eye(3), axis)
    turn = np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross
    field = linear_field(body, turn) + np.array([1e-3, -2e-3, 3e-3])
    energy, force = body.force(field)
    shear = 2.0 * LAWS[law].coefficients_pa()[:2].sum()
    volume = body.discretization.particle_volume_m3.sum()
    assert abs(energy[0]) < 1e-12 * shear * volume
    assert np.abs(force).max() < 1e-10 * shear * SPACING_M**2
    assert np.abs(body.material_stress(field[0], 0)).max() < 1e-10 * shear


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("shape", [BLOCK, BALL], ids=["block", "ball"])
@pytest.mark.parametrize("stretch", [0.6, 1.8])
def test_uniaxial_curve(law: str, shape: FloatingBlock | FloatingBall, stretch: float) -> None:
    body, form = elastic(shape, law), closed_form(law)
    expected = uniaxial(form, stretch)
    side = expected.lateral_stretch
    field = linear_field(body, np.diag([side, side, stretch]))
    stress = mean_stress_pa(body, field)
    scale = abs(expected.nominal_stress_pa)
    assert stress[2, 2] == pytest.approx(expected.nominal_stress_pa, rel=1e-8)
    assert np.abs(stress - np.diag([0.0, 0.0, stress[2, 2]])).max() < 1e-7 * scale
    energy, _ = body.force(field)
    volume = body.discretization.particle_volume_m3.sum()
    assert energy[0] / volume == pytest.approx(strain_energy(form, (side, side, stretch)), rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("amount", [0.01, 1.0])
def test_simple_shear_curve(law: str, amount: float) -> None:
    body, form = elastic(BALL, law), closed_form(law)
    deformation = np.eye(3)
    deformation[0, 2] = amount
    stress = mean_stress_pa(body, linear_field(body, deformation))
    assert stress[0, 2] == pytest.approx(simple_shear_stress_pa(form, amount), rel=1e-8)
    # J = 1, so that the Cauchy stress is P F^T; Rivlin's universal relation.
    cauchy = stress @ deformation.T
    assert cauchy == pytest.approx(cauchy.T, abs=1e-9 * stress[0, 2])
    assert cauchy[0, 0] - cauchy[2, 2] == pytest.approx(amount * cauchy[0, 2], rel=1e-8)


@pytest.mark.parametrize("law", LAWS)
def test_force_is_the_slope_of_the_energy_and_stiffness_that_of_the_force(law: str) -> None:
    skin = dome_skin(DOME.outer_radius_m, 3.0e-3)
    grid = discretize(DOME, skin.rest_position_m, 4.8e-3)
    body = ElasticBody(grid, LAWS[law])
    random = np.random.default_rng(1)
    history = random.normal(scale=3e3, size=(grid.particle_count, 3, 3))
    body.set_history(0.7, history + history.transpose(0, 2, 1), 0)
    field = 0.2e-3 * random.normal(size=(1, grid.node_count, 3))
    direction = random.normal(size=field.shape)
    step = 1e-8
    ahead, behind = body.force(field + step * direction), body.force(field - step * direction)
    _, force = body.force(field)
    assert np.vdot(force, direction) == pytest.approx(
        (ahead[0][0] - behind[0][0]) / (2 * step), rel=1e-6
    )
    expected = (ahead[1] - behind[1]).ravel() / (2 * step)
    stiffness = body.stiffness(field[0], 0)
    product = stiffness @ direction.ravel()
    assert np.abs(product - expected).max() < 1e-6 * np.abs(expected).max()
    assert abs(stiffness - stiffness.T).max() < 1e-10 * abs(stiffness).max()


def test_region_stiffness_is_a_block_of_the_whole() -> None:
    grid = discretize(BLOCK, BLOCK.bounds_m().mean(axis=0)[None], 4.8e-3)
    body = ElasticBody(grid, LAWS["yeoh"])
    field = linear_field(body, np.eye(3) + 0.5 * LINEAR_MAP)[0]
    every = np.arange(grid.node_count, dtype=np.int32)
    base = region_base(body.cells.node, every, 3 * grid.node_count)
    region = body.region_stiffness(field, body.all_cells, base, 3 * grid.node_count, 0)
    linear = np.kron(body.linear.toarray(), np.eye(3))
    whole = body.stiffness(field, 0).toarray() - linear
    assert region == pytest.approx(whole, abs=1e-9 * np.abs(whole).max())


def test_environments_are_independent() -> None:
    grid = grid_of(BLOCK)
    laws = [LAWS["neo_hookean"], LAWS["yeoh"]]
    batch = ElasticBody(grid, laws[0], environment_count=2)
    batch.set_coefficients(np.stack([law.coefficients_pa() for law in laws]))
    random = np.random.default_rng(2)
    field = 0.1e-3 * random.normal(size=(2, grid.node_count, 3))
    energy, force = batch.force(field)
    for e, law in enumerate(laws):
        # The ghost penalty is that of the law that the batch was made with.
        single = ElasticBody(grid, law, ghost_penalty=0.0)
        ghost = batch.linear @ field[e]
        alone, alone_force = single.force(field[e : e + 1])
        assert energy[e] == pytest.approx(alone[0] + 0.5 * np.vdot(field[e], ghost), rel=1e-12)
        assert force[e] == pytest.approx(alone_force[0] + ghost, rel=1e-9, abs=1e-12)


def test_inverted_gel_has_infinite_energy() -> None:
    body = elastic(BLOCK, "neo_hookean")
    energy, _ = body.force(linear_field(body, np.diag([1.0, 1.0, -0.5])))
    assert energy[0] == np.inf
