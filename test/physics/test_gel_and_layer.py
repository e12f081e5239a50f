# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A gel and a soft layer in contact, against closed forms, balances, and another solver."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from closed_forms import bonded_layer_factor
from scipy.spatial.transform import Rotation

from dotsim_ros import load_sensor
from dotsim_ros.gel.body import Body, Dome
from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.make import law_of
from dotsim_ros.gel.material import Material, NeoHookean
from dotsim_ros.geometry.indenter import box
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import ContactSpecification, SolverSpecification
from studies.tumour.layer_press import LayerPressSettings, solve_layer_press
from studies.tumour.pair.equilibrium import GelAndLayer, PairError, PairSettings, PairState
from studies.tumour.pair.layer import Insert, LayerSpecification, SoftLayer
from studies.tumour.pair.touch import touch

RADIUS_M = 15.75e-3
CORE_M = 6.0e-3
GEL = NeoHookean(3.0e5, 0.48)
FACING = np.array([1.0, 0.0, 0.0, 0.0])
SKIN = LayerSpecification(thickness_m=4.0e-3, youngs_modulus_pa=80.0e3)


def pair_of(
    body: Body, skin: SkinMesh, spacing_m: float, law: NeoHookean, settings: PairSettings
) -> GelAndLayer:
    grid = discretize(body, skin.rest_position_m, spacing_m)
    return GelAndLayer(ElasticBody(grid, law), skin, settings)


def facing(layer: LayerSpecification, radius_m: float, depth_m: float) -> Pose:
    return Pose(np.array([0.0, 0.0, radius_m + layer.thickness_m - depth_m]), FACING)


@pytest.fixture(scope="module")
def skin() -> SkinMesh:
    return dome_skin(RADIUS_M, 1.2e-3)


@pytest.fixture(scope="module")
def pair(skin: SkinMesh) -> GelAndLayer:
    return pair_of(Dome(RADIUS_M, CORE_M), skin, 3.6e-3, GEL, PairSettings(tolerance_m=1e-6))


@pytest.fixture(scope="module")
def tilted_press(pair: GelAndLayer) -> tuple[SoftLayer, PairState]:
    layer = SoftLayer(SKIN, Insert(1.2e-3, 5.0e-3, (1.0e-3, 0.5e-3)))
    turned = Rotation.from_euler("x", np.pi) * Rotation.from_euler("xy", [0.04, -0.05])
    state = pair.put(layer)
    for depth in (0.7e-3, 1.4e-3):
        place = -(RADIUS_M + SKIN.thickness_m - depth) * turned.as_matrix()[:, 2]
        state = pair.press(state, Pose(place, turned.as_quat()))
    return layer, state


def test_the_layer_has_the_volume_that_the_insert_leaves() -> None:
    insert = Insert(1.2e-3, 5.0e-3, (1.0e-3, -0.5e-3))
    volume = SoftLayer(SKIN, insert).body.discretization.particle_volume_m3.sum()
    # Over the disc (1 - r^2 / R^2)^2 has a third of its height in the mean.
    bulge = insert.height_m * np.pi * insert.radius_m**2 / 3.0
    assert volume == pytest.approx(SKIN.side_m**2 * SKIN.thickness_m - bulge, rel=2e-4)


def test_gradients_of_the_fitted_grid_are_those_of_space() -> None:
    """A displacement that is linear in space has its gradient at every particle."""
    layer = SoftLayer(SKIN, Insert(-1.2e-3, 6.0e-3))
    d = layer.body.discretization
    node = d.node_position_m
    # Linear in the pad's coordinates along the sides: what the splines carry exactly.
    moved = np.stack([0.01 * node[:, 0], 0.02 * node[:, 1], 0.03 * node[:, 0]], axis=1)
    inside = (d.particle_position_m[:, 2] > SKIN.spacing_m) & np.all(
        np.abs(d.particle_position_m[:, :2]) < 0.5 * SKIN.side_m - SKIN.spacing_m, axis=1
    )
    gradient = np.einsum(
        "pai,paj->pij",
        moved[d.particle_interpolation.node_index[inside]],
        d.particle_weight_gradient[inside],
    )
    expected = np.array([[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.03, 0.0, 0.0]])
    assert gradient == pytest.approx(np.broadcast_to(expected, gradient.shape), abs=1e-12)


def test_forces_on_both_bodies_are_opposite_and_on_one_line(
    pair: GelAndLayer, tilted_press: tuple[SoftLayer, PairState]
) -> None:
    layer, state = tilted_press
    assert state.pose is not None
    rotation = state.pose.rotation()
    marker = (state.skin_position_m - state.pose.position_m) @ rotation
    near = np.flatnonzero(marker[:, 2] < SKIN.thickness_m + 0.5e-3)
    contact = touch(
        layer, state.layer_m, marker[near], pair.skin.rest_area_m2[near], 8.0e9, marker[near, :2]
    )
    on_marker = contact.force_n[:, None] * contact.normal
    on_layer = -contact.layer_force_n()
    assert on_layer.sum(axis=0) == pytest.approx(-on_marker.sum(axis=0), rel=1e-9)
    nearest = layer.surface(contact.parameters_m, state.layer_m).position_m
    moment = np.cross(nearest, -on_marker).sum(axis=0) + np.cross(marker[near], on_marker).sum(0)
    scale = np.linalg.norm(on_marker.sum(axis=0)) * RADIUS_M
    assert np.abs(moment).max() < 1e-9 * scale
    # The gel pushes the layer away from the sensor, along the layer's normal but for the tilt.
    assert state.wrench.force_n[2] == pytest.approx(np.linalg.norm(on_marker.sum(0)), rel=0.02)


def test_the_equilibrium_is_one_of_the_energy(
    pair: GelAndLayer, tilted_press: tuple[SoftLayer, PairState]
) -> None:
    """Nothing is gained to first order by moving any node of either body."""
    layer, state = tilted_press
    assert state.pose is not None
    rotation = state.pose.rotation()
    d = pair.gel.discretization
    weights = d.skin_interpolation.matrix(d.node_count)
    stiffness = 120.0 * SKIN.youngs_modulus_pa / 1.2e-3

    def energy(gel_m: FloatArray, layer_m: FloatArray) -> float:
        assert state.pose is not None
        moved = pair.skin.rest_position_m + weights @ gel_m - state.pose.position_m
        marker = moved @ rotation
        near = np.flatnonzero(marker[:, 2] < SKIN.thickness_m + 0.5e-3)
        area = pair.skin.rest_area_m2[near]
        made = touch(layer, layer_m, marker[near], area, stiffness, marker[near, :2])
        return made.energy_j + pair.gel.force_in(0, gel_m)[0] + layer.body.force_in(0, layer_m)[0]

    random = np.random.default_rng(0)
    step = 2.0e-6
    for _ in range(3):
        gel_way = random.normal(size=state.gel_m.shape)
        layer_way = random.normal(size=state.layer_m.shape)
        ahead, behind = (
            energy(state.gel_m + sign * step * gel_way, state.layer_m + sign * step * layer_way)
            for sign in (1.0, -1.0)
        )
        here = energy(state.gel_m, state.layer_m)
        slope, curve = 0.5 * (ahead - behind), 0.5 * (ahead + behind) - here
        # Along the way the minimum lies within a hundredth of a step from here.
        assert curve > 0.0
        assert abs(slope) < 0.02 * curve


def test_two_elastic_bodies_press_as_hertz_says() -> None:
    """The force is that of the effective modulus, 1 / E* = (1 - nu1^2) / E1 + (1 - nu2^2) / E2."""
    radius, spacing, depth, nu = 8.0e-3, 1.2e-3, 0.25e-3, 0.3
    spec = LayerSpecification(7.2e-3, 1.0e5, nu, side_m=12.0e-3, spacing_m=spacing, cells=6)
    skin = dome_skin(radius, 0.5e-3)
    force: dict[float, float] = {}
    for youngs in (1.0e8, 1.0e5):
        settings = PairSettings(contact_stiffness=1200.0, tolerance_m=2e-6)
        pair = pair_of(Dome(radius, 0.0), skin, spacing, NeoHookean(youngs, nu), settings)
        state = pair.press(pair.put(SoftLayer(spec, Insert())), facing(spec, radius, depth))
        effective = 1.0 / ((1.0 - nu**2) * (1.0 / youngs + 1.0 / spec.youngs_modulus_pa))
        hertz = 4.0 / 3.0 * effective * np.sqrt(radius) * depth**1.5
        force[youngs] = float(state.wrench.force_n[2]) / hertz
    # Both bodies are some 5 contact radii thick, and a grid of 1.2 mm under a contact of 1.4 mm is
    # too stiff by 8 %.
    share = np.sqrt(radius * depth) / spec.thickness_m
    assert force[1.0e8] == pytest.approx(bonded_layer_factor(nu, share), rel=0.13)
    assert force[1.0e5] == pytest.approx(force[1.0e8], rel=0.05)


def test_a_hard_layer_is_a_rigid_face(skin: SkinMesh) -> None:
    pair = pair_of(Dome(RADIUS_M, CORE_M), skin, 3.6e-3, GEL, PairSettings(contact_stiffness=0.4))
    hard = LayerSpecification(4.0e-3, 1.0e8, side_m=18.0e-3)
    state = pair.put(SoftLayer(hard, Insert()))
    alone = ImplicitGel(
        Dome(RADIUS_M, CORE_M),
        skin,
        Material(GEL),
        contact=ContactSpecification(friction_coefficient=0.0),
        solver=SolverSpecification(grid_spacing_m=3.6e-3, refined=False),
        indenter=box((0.024, 0.024, 0.004)),
        environment_count=1,
    )
    for depth in (0.5e-3, 1.0e-3):
        state = pair.press(state, facing(hard, RADIUS_M, depth))
        rigid = alone.step([Pose(np.array([0.0, 0.0, RADIUS_M - depth]))], 0.1)[0]
    assert state.wrench.force_n[2] == pytest.approx(rigid.wrench.force_n[2], rel=0.03)
    apart = np.linalg.norm(state.skin_position_m - rigid.skin_position_m, axis=1)
    assert apart.max() < 0.05e-3


def test_finer_grids_change_little(skin: SkinMesh, pair: GelAndLayer) -> None:
    insert = Insert(1.2e-3, 5.0e-3)
    coarse = replace(SKIN, side_m=18.0e-3)
    fine = replace(coarse, spacing_m=1.5e-3, cells=4)
    finer = pair_of(Dome(RADIUS_M, CORE_M), skin, 2.4e-3, GEL, PairSettings())
    force = []
    for gel, layer in ((pair, coarse), (finer, fine)):
        state = gel.put(SoftLayer(layer, insert))
        state = gel.press(state, facing(layer, RADIUS_M, 1.6e-3))
        force.append(float(state.wrench.force_n[2]))
    assert force[0] == pytest.approx(force[1], rel=0.03)


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_calculix_finds_the_same_skin(skin: SkinMesh, pair: GelAndLayer) -> None:
    sensor = load_sensor("densetact2")
    assert law_of(sensor.material) == GEL
    insert = Insert(1.2e-3, 5.0e-3, (1.0e-3, 0.0))
    turned = Rotation.from_euler("x", np.pi) * Rotation.from_euler("y", 0.05)

    def pose(depth_m: float) -> Pose:
        away = RADIUS_M + SKIN.thickness_m - depth_m
        return Pose(-away * turned.as_matrix()[:, 2], turned.as_quat())

    solved = solve_layer_press(
        sensor,
        SKIN,
        insert,
        [pose(-20e-6), pose(1.0e-3)],
        LayerPressSettings(gel_spacing_m=4.0e-3, layer_spacing_m=3.0e-3),
    )
    assert solved.failure == ""
    state = pair.press(pair.put(SoftLayer(SKIN, insert)), pose(1.0e-3))
    assert state.wrench.force_n[2] == pytest.approx(solved.force_n[0, 2], rel=0.08)
    assert state.wrench.force_n[0] == pytest.approx(solved.force_n[0, 0], rel=0.1)
    rest = skin.rest_position_m
    found, true = state.skin_position_m - rest, solved.skin_m(rest)[0] - rest
    moved = np.linalg.norm(true, axis=1)
    apart = np.linalg.norm(found - true, axis=1)
    assert np.sqrt(np.mean(apart[moved > 0.05e-3] ** 2)) < 0.15 * moved.max()
    # A press that is turned about the sensor's axis is the same press from another side.
    quarter = solved.skin_m(rest @ np.diag([1.0, -1.0, 1.0]), 0.0)[0] - rest @ np.diag([1, -1, 1])
    assert quarter == pytest.approx(true * [1.0, -1.0, 1.0], abs=1e-9)


def test_what_cannot_be_pressed_is_refused(pair: GelAndLayer) -> None:
    with pytest.raises(ValueError, match="leaves less than 20% of the layer"):
        SoftLayer(SKIN, Insert(3.5e-3))
    with pytest.raises(ValueError, match="expected a whole number"):
        LayerSpecification(4.0e-3, 1.0e5, side_m=25.0e-3)
    with pytest.raises(ValueError, match="two cells at least"):
        LayerSpecification(4.0e-3, 1.0e5, cells=1)
    with pytest.raises(ValueError, match=r"radius is 0\.0 m, expected a positive one"):
        Insert(1.0e-3, 0.0)
    small = replace(SKIN, side_m=12.0e-3)
    start = pair.put(SoftLayer(small, Insert()))
    reached = pair.press(start, facing(small, RADIUS_M, 0.5e-3))
    with pytest.raises(PairError, match=r"expected 0\.001 m at most; press in smaller steps"):
        pair.press(reached, facing(small, RADIUS_M, 2.5e-3))
    with pytest.raises(PairError, match="reaches over the rim of the layer"):
        pair.press(reached, facing(small, RADIUS_M, 1.3e-3))
