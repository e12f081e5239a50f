# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A gel that has come off its core: its bond slips as the closed form says, and it gets softer."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dotsim_ros.gel.adjoint.recorder import Recorder
from dotsim_ros.gel.body import Dome
from dotsim_ros.gel.bond import LooseBond, lost_stiffness
from dotsim_ros.gel.discretization import Discretization, discretize
from dotsim_ros.gel.elasticity import BOND_STIFFNESS, ElasticBody
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.make import body_of, bond_of, make_gel_batch, material_of
from dotsim_ros.gel.material import NeoHookean, shear_modulus_pa
from dotsim_ros.gel.values import specification_with, values_of
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.specification import GelSpecification, SensorSpecification, SolverSpecification
from dotsim_ros.specification.sections import WHOLE_CORE_RAD
from dotsim_ros.twin.simulator import GelSimulator

CORE_M, OUTER_M, GRID_M, COARSE_M = 6.0e-3, 15.75e-3, 2.4e-3, 3.6e-3
YOUNGS_PA, POISSON = 3.0e5, 0.45
LAW = NeoHookean(YOUNGS_PA, POISSON)
DOME = Dome(OUTER_M, CORE_M)
SKIN = dome_skin(OUTER_M, 2.0e-3)
SENSOR = replace(
    SensorSpecification(), solver=SolverSpecification(grid_spacing_m=COARSE_M, refined=False)
)
CAP_RAD = 0.9
"""Of a patch around the apex that the base's mirrored nodes do not reach."""
STAMP_S = np.array([0.0, 0.1, 0.2])


@pytest.fixture(scope="module")
def grid() -> Discretization:
    return discretize(DOME, SKIN.rest_position_m, GRID_M)


@pytest.fixture(scope="module")
def simulator() -> GelSimulator:
    return GelSimulator(SENSOR, SKIN)


def energy_j(stiffness, displacement_m: np.ndarray) -> float:
    u = displacement_m.ravel()
    return 0.5 * float(u @ (stiffness @ u))


def pressed_n(
    simulator: GelSimulator, slip_share: float, patch=WHOLE_CORE_RAD, lean_rad: float = 0.0
) -> np.ndarray:
    """Return the forces (3, 3) of a ball that is pressed in along the radius, leaning to x."""
    away = np.array([math.sin(lean_rad), 0.0, math.cos(lean_rad)])
    turn = np.array([0.0, math.sin(0.5 * lean_rad), 0.0, math.cos(0.5 * lean_rad)])
    poses = [Pose((OUTER_M - depth) * away, turn) for depth in (0.5e-3, 1.5e-3, 2.5e-3)]
    values = replace(values_of(SENSOR), bond_slip_share=slip_share, loose_patch_rad=patch)
    found = simulator.press(values, sphere(4e-3), poses, STAMP_S)
    assert found.converged
    return found.force_n


@pytest.mark.parametrize("slip_share", [0.0, 0.02, 1.0])
def test_a_turn_on_the_core_costs_what_two_springs_in_a_row_do(
    grid: Discretization, slip_share: float
) -> None:
    patch = LooseBond(1.0, radius_rad=CAP_RAD)
    bond = replace(patch, slip_share=slip_share)
    x, y, _ = grid.node_position_m.T
    turned = 1e-3 * np.stack([-y, x, 0.0 * x], axis=1)
    # All that the patch's bond costs along the core goes where it slides freely.
    whole = -energy_j(lost_stiffness(DOME, grid, patch, LAW), turned)
    left = whole + energy_j(lost_stiffness(DOME, grid, bond, LAW), turned)
    sound = BOND_STIFFNESS * YOUNGS_PA / GRID_M
    layer = shear_modulus_pa(YOUNGS_PA, POISSON) / (OUTER_M - CORE_M)
    series = 0.0
    if slip_share < 1.0:
        series = 1.0 / (1.0 / sound + slip_share / ((1.0 - slip_share) * layer))
    cosine = math.cos(CAP_RAD)
    area_m4 = 2.0 * math.pi * CORE_M**4 * (2.0 / 3.0 - cosine + cosine**3 / 3.0)
    expected = 0.5e-6 * series * area_m4
    assert left == pytest.approx(expected, rel=0.02, abs=1e-9 * whole)


def test_what_moves_straight_off_the_core_is_held_as_before(grid: Discretization) -> None:
    lost = lost_stiffness(DOME, grid, LooseBond(1.0, radius_rad=CAP_RAD), LAW)
    along = -energy_j(lost, np.cross([0.0, 0.0, 1.0], grid.node_position_m))
    assert -energy_j(lost, grid.node_position_m) < 1e-9 * along


def test_what_is_lost_is_no_more_than_there_was() -> None:
    grid = discretize(DOME, SKIN.rest_position_m, COARSE_M)
    lost = lost_stiffness(DOME, grid, LooseBond(1.0), LAW).toarray()
    np.testing.assert_allclose(lost, lost.T, atol=1e-9 * np.abs(lost).max())
    sound = np.kron(grid.bond.toarray() * (BOND_STIFFNESS * YOUNGS_PA / COARSE_M), np.eye(3))
    least = 1e-6 * np.linalg.eigvalsh(sound)[-1]
    assert np.linalg.eigvalsh(lost)[-1] < least
    assert np.linalg.eigvalsh(sound + lost)[0] > -least


def test_force_and_stiffness_are_the_energys_derivatives(grid: Discretization) -> None:
    lost = lost_stiffness(DOME, grid, LooseBond(0.3, 0.4, -0.2, 0.8), LAW)
    body = ElasticBody(grid, LAW, lost_bond=lost)
    random = np.random.default_rng(5)
    at, way = (scale * random.normal(size=(grid.node_count, 3)) for scale in (2e-5, 1.0))
    step = 1e-9
    (below, force_below), (above, force_above) = (
        body.force_in(0, at + sign * step * way) for sign in (-1.0, 1.0)
    )
    force = body.force_in(0, at)[1]
    assert (above - below) / (2.0 * step) == pytest.approx(float(np.vdot(force, way)), rel=1e-5)
    pushed = body.stiffness(at, 0) @ way.ravel()
    found = ((force_above - force_below) / (2.0 * step)).ravel()
    np.testing.assert_allclose(pushed, found, atol=1e-5 * np.abs(found).max())


def test_the_looser_the_softer_between_bonded_and_free(simulator: GelSimulator) -> None:
    shares = (0.0, 1e-9, 0.1, 1.0)
    bonded, nearly, *loose = (pressed_n(simulator, share) for share in shares)
    np.testing.assert_allclose(nearly, bonded, rtol=1e-4, atol=1e-5)
    deepest = [force[-1, 2] for force in (bonded, *loose)]
    assert all(after < 0.998 * before for before, after in pairwise(deepest))
    # The core still bears what presses on it.
    assert deepest[-1] > 0.9 * deepest[0]
    for force in loose:
        assert np.abs(force[-1, :2]).max() < 3e-3 * force[-1, 2]


def test_a_patch_shows_on_its_own_side(simulator: GelSimulator) -> None:
    patch = (0.8, 0.0, 0.7)
    softer = []
    for lean_rad in (0.8, -0.8):
        bonded = np.linalg.norm(pressed_n(simulator, 0.0, lean_rad=lean_rad)[-1])
        loose = np.linalg.norm(pressed_n(simulator, 1.0, patch, lean_rad)[-1])
        softer.append(1.0 - loose / bonded)
    assert softer[0] > 0.005
    assert abs(softer[1]) < 0.1 * softer[0]


def test_the_local_solve_finds_what_the_exact_one_does() -> None:
    s = replace(SENSOR, gel=replace(SENSOR.gel, bond_slip_share=0.6))
    solver = replace(s.solver, tolerance_m=1e-7, iterations=60)
    forces = []
    for exact in (False, True):
        gel = ImplicitGel(
            body_of(s.gel),
            SKIN,
            material_of(s.material),
            contact=s.contact,
            solver=solver,
            indenter=sphere(4e-3),
            bond=bond_of(s.gel),
            exact=exact,
        )
        poses = [Pose(np.array([1e-3, 0.0, OUTER_M - depth])) for depth in (0.5e-3, 2.0e-3)]
        states = [gel.step([pose], 0.1)[0] for pose in poses]
        assert all(state.converged for state in states)
        forces.append(np.stack([state.wrench.force_n for state in states]))
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    ("direction", "holds"),
    [((0.0, 0.0, 1.0), True), ((1.0, 0.0, 0.0), False), ((0.0, 1.0, 0.0), True)],
)
def test_a_patch_lies_where_it_is_said_to(direction: tuple[float, ...], holds: bool) -> None:
    bond = LooseBond(1.0, 0.5 * math.pi, 0.0, 0.3)
    assert bond.holds(np.array([direction])).tolist() == [holds]


def test_values_are_of_the_specification() -> None:
    values = replace(values_of(SENSOR), bond_slip_share=0.4, loose_patch_rad=(0.1, 0.2, 0.3))
    again = values_of(specification_with(SENSOR, values))
    assert (again.bond_slip_share, again.loose_patch_rad) == (0.4, (0.1, 0.2, 0.3))


def test_what_cannot_come_off_is_refused() -> None:
    with pytest.raises(ValueError, match="expected 0 for a gel without a core"):
        GelSpecification(shape="flat_pad", bond_slip_share=0.1)
    with pytest.raises(ValueError, match="expected 0 for a gel without a core"):
        GelSpecification(core_radius_m=0.0, bond_slip_share=0.1)
    with pytest.raises(ValueError, match="ends with a radius of 0"):
        GelSpecification(bond_slip_share=0.1, loose_patch_rad=(0.0, 0.0, 0.0))
    loose = replace(SENSOR, gel=replace(SENSOR.gel, bond_slip_share=0.5))
    with pytest.raises(ValueError, match="expected 0 with solver"):
        replace(loose, solver=SolverSpecification(method="explicit"))
    gel = make_gel_batch(loose, indenter=sphere(4e-3), environment_count=1, skin=SKIN)
    with pytest.raises(ValueError, match="expected one that is bonded everywhere"):
        Recorder(gel)
