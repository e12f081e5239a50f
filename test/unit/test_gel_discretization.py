# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Particles, grid and weights of the gel at rest, and the step from a coarse grid to a fine one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.gel.body import QUARTER_TURNS_AND_MIRRORS, Body, Dome, Pad
from dotsim_ros.gel.discretization import Discretization, discretize, spline_weights
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit.refinement import Refinement, knot_insertion, refine
from dotsim_ros.gel.implicit.rest_compliance import kept_compliance
from dotsim_ros.gel.implicit.tangent import inverse_at_rest
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin, flat_pad_skin
from dotsim_ros.io.arrays import Float32Array

FloatArray = NDArray[np.float64]
DOME, PAD = Dome(15.75e-3, 6.0e-3), Pad((12.0e-3, 12.0e-3, 7.2e-3))
LAW = NeoHookean(1.0e5, 0.4)
SPACING_M = 2.4e-3


def skin_of(body: Body) -> SkinMesh:
    if isinstance(body, Pad):
        return flat_pad_skin(body.size_m[:2], body.size_m[2], 1.0e-3)
    return dome_skin(DOME.outer_radius_m, 2.0e-3)


def assert_close(
    found: np.ndarray, expected: np.ndarray, *, rel: float = 0.0, abs: float = 0.0
) -> None:
    """Compare as arrays: pytest.approx does so element by element, at 10 us for each."""
    np.testing.assert_allclose(found, expected, rtol=rel, atol=abs)


def grid_of(body: Body, spacing_m: float = SPACING_M) -> Discretization:
    return discretize(body, skin_of(body).rest_position_m, spacing_m)


@pytest.fixture(scope="module", params=[DOME, PAD], ids=["dome", "pad"])
def grid(request: pytest.FixtureRequest) -> Discretization:
    return grid_of(request.param)


def test_weights_are_a_partition_of_unity() -> None:
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (200, 3))
    weight, gradient = spline_weights(points, SPACING_M)
    assert weight.sum(axis=1) == pytest.approx(1.0, abs=1e-13)
    assert np.all(weight >= 0.0)
    assert np.abs(gradient.sum(axis=1)).max() < 1e-9
    step = 1e-8
    for axis in range(3):
        ahead, _ = spline_weights(points + step * np.eye(3)[axis], SPACING_M)
        inside = np.floor(points / SPACING_M) == np.floor(
            (points + step * np.eye(3)[axis]) / SPACING_M
        )
        keep = inside.all(axis=1)
        slope = (ahead - weight)[keep] / step
        assert slope == pytest.approx(gradient[keep][..., axis], abs=1e-2)


def test_volumes_sum_to_the_shape() -> None:
    hollow = 2.0 / 3.0 * np.pi * (15.75e-3**3 - 6.0e-3**3)
    assert grid_of(DOME).particle_volume_m3.sum() == pytest.approx(hollow, rel=2e-3)
    assert grid_of(PAD).particle_volume_m3.sum() == pytest.approx(12e-3**2 * 7.2e-3, rel=1e-12)


def test_volumes_of_a_pad_that_fits_no_grid() -> None:
    body = Pad((11.0e-3, 13.0e-3, 6.6e-3))
    skin = flat_pad_skin(body.size_m[:2], body.size_m[2], 1.0e-3)
    found = discretize(body, skin.rest_position_m, SPACING_M).particle_volume_m3.sum()
    # Cut cells are sampled every 0.2 mm: half of that may be missed or added at each face.
    bound = 0.2e-3 / 11e-3 + 0.2e-3 / 13e-3 + 0.1e-3 / 6.6e-3
    assert found == pytest.approx(11e-3 * 13e-3 * 6.6e-3, rel=bound)


def test_gradients_sum_to_zero_off_the_base(grid: Discretization) -> None:
    away = grid.particle_position_m[:, 2] > SPACING_M
    total = grid.particle_weight_gradient.sum(axis=1)
    assert np.abs(total[away]).max() < 1e-9
    weight = grid.particle_interpolation.weight.sum(axis=1)
    assert weight[away] == pytest.approx(1.0, abs=1e-12)


def test_displacement_vanishes_on_the_base() -> None:
    grid, skin = grid_of(DOME), skin_of(DOME)
    field = np.random.default_rng(1).normal(size=grid.node_count)
    moved = grid.skin_interpolation.matrix(grid.node_count) @ field
    assert skin.on_base.any()
    assert np.abs(moved[skin.on_base]).max() < 1e-6 * np.abs(field).max()
    assert np.abs(moved[~skin.on_base]).max() > 0.1


def test_mass_is_that_of_the_volume() -> None:
    body = Pad((14.4e-3, 14.4e-3, 12.0e-3))
    grid = grid_of(body)
    upper = grid.node_position_m[:, 2] > 2.0 * SPACING_M
    rows = np.asarray(grid.mass_over_density.sum(axis=1)).ravel()
    # A node's share is the integral of its spline: a whole cell where none is cut or mirrored.
    inner = upper & np.all(np.abs(grid.node_position_m[:, :2]) < 4e-3, axis=1)
    inner &= grid.node_position_m[:, 2] < 9e-3
    assert inner.any()
    assert rows[inner] == pytest.approx(SPACING_M**3, rel=1e-12)
    assert abs(grid.mass_over_density - grid.mass_over_density.T).max() < 1e-20


def test_ghost_penalty_ignores_quadratic_fields(grid: Discretization) -> None:
    x, y, z = grid.node_position_m.T / SPACING_M
    for field in (np.ones_like(x), x - 2 * z, x * y, x**2 - z**2):
        assert np.abs(grid.ghost @ field).max() < 1e-9 * np.abs(field).max()
    assert np.abs(grid.ghost @ x**3).max() > 1.0


def test_bond_holds_the_core_alone() -> None:
    assert grid_of(PAD).bond.nnz == 0
    bond = grid_of(DOME).bond
    field = np.ones(bond.shape[0])
    # Close to the base the mirrored weights take from the sum.
    area = 2.0 * np.pi * 6.0e-3**2
    assert 0.7 * area < field @ (bond @ field) < area


def test_grid_keeps_the_symmetries_of_the_shape() -> None:
    grid = grid_of(DOME)
    cells = {tuple(cell) for cell in grid.node_cell.tolist()}
    for image in QUARTER_TURNS_AND_MIRRORS:
        moved = np.floor((grid.node_cell + 0.5) @ image.T).astype(int)
        assert {tuple(cell) for cell in moved.tolist()} == cells


@pytest.mark.parametrize("spacing_m", [0.0, 4.0e-3, float("nan")])
def test_spacing_that_cannot_be_is_refused(spacing_m: float) -> None:
    with pytest.raises(ValueError, match="grid spacing"):
        grid_of(PAD, spacing_m)


def test_bodies_tell_what_they_hold() -> None:
    inside = np.array([[0.0, 0.0, 10e-3], [0.0, 0.0, 3e-3], [0.0, 0.0, 16e-3], [10e-3, 0.0, -1e-3]])
    assert DOME.contains(inside).tolist() == [True, False, False, False]
    assert PAD.contains(np.array([[5e-3, 5e-3, 7e-3], [7e-3, 0.0, 1e-3]])).tolist() == [True, False]
    _, area = DOME.bonded_surface(1.0e-3)
    assert area.sum() == pytest.approx(2.0 * np.pi * 6e-3**2)


@pytest.mark.parametrize("body", [DOME, PAD], ids=["dome", "pad"])
def test_knot_insertion_writes_the_same_field(body: Body) -> None:
    skin = skin_of(body).rest_position_m
    coarse, fine = discretize(body, skin, 3.0e-3), discretize(body, skin, 1.5e-3)
    every = np.arange(fine.node_count, dtype=np.int32)
    field = np.random.default_rng(2).normal(size=coarse.node_count)
    written = knot_insertion(coarse, fine, every) @ field
    expected = coarse.skin_interpolation.matrix(coarse.node_count) @ field
    found = fine.skin_interpolation.matrix(fine.node_count) @ written
    assert found == pytest.approx(expected, abs=1e-9)


@pytest.fixture(scope="module")
def small_refinement(tmp_path_factory: pytest.TempPathFactory) -> tuple[Refinement, Path]:
    folder = tmp_path_factory.mktemp("refinement") / "deeper"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DOTSIM_ROS_CACHE", str(folder))
        return build_refinement(), folder


def build_refinement(youngs_pa: float = 1.0e5) -> Refinement:
    law = NeoHookean(youngs_pa, 0.4)
    grid = grid_of(PAD)
    single = ElasticBody(grid, law, dtype=np.float32)
    compliance = inverse_at_rest(single)
    return refine(PAD, skin_of(PAD).rest_position_m, grid, lambda: compliance, law)


def test_refinement_makes_the_skin_softer(small_refinement: tuple[Refinement, Path]) -> None:
    refinement, _ = small_refinement
    nodes = np.arange(refinement.node_count, dtype=np.int32)
    dense = refinement.dense(nodes).astype(np.float64)
    assert_close(dense, dense.T, abs=2e-3 * np.abs(dense).max())
    value = np.linalg.eigvalsh(0.5 * (dense + dense.T))
    assert value[-1] > 0.0
    # What a finer grid adds can only give way.
    assert value[0] > -0.02 * value[-1]


def test_refinement_displacement_is_that_of_its_matrix(
    small_refinement: tuple[Refinement, Path],
) -> None:
    refinement, _ = small_refinement
    nodes = np.array([3, 10, 11, 40], dtype=np.int32)
    force = np.random.default_rng(3).normal(size=(4, 3))
    found = refinement.displacement(nodes, force)
    every = np.zeros((refinement.node_count, 3))
    every[nodes] = force
    dense = refinement.dense(np.arange(refinement.node_count, dtype=np.int32))
    assert found == pytest.approx(
        (dense @ every.ravel()).reshape(-1, 3), abs=2e-3 * np.abs(found).max()
    )
    part = refinement.dense(nodes)
    assert (part @ force.ravel()).reshape(-1, 3) == pytest.approx(
        found[nodes], abs=2e-3 * np.abs(found).max()
    )
    order = (3 * np.arange(4) + np.arange(3)[:, None]).ravel()
    assert np.array_equal(refinement.by_component(nodes), part[np.ix_(order, order)])


def test_refinement_is_read_back_from_its_cache(
    small_refinement: tuple[Refinement, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, folder = small_refinement
    files = list(folder.iterdir())
    assert [file.suffix for file in files] == [".npz"]
    written = files[0].stat().st_mtime_ns
    monkeypatch.setenv("DOTSIM_ROS_CACHE", str(folder))
    again = build_refinement()
    assert files[0].stat().st_mtime_ns == written
    assert np.array_equal(again.block, first.block)
    # In double precision a frame takes nearly twice as long.
    assert again.block.dtype == first.block.dtype == np.float32
    # Twice the modulus, half the compliance, from the same file.
    stiffer = build_refinement(2.0e5)
    assert len(list(folder.iterdir())) == 1
    assert_close(stiffer.block, 0.5 * first.block, rel=1e-5)
    # A broken file is made again.
    files[0].write_bytes(b"half a file")
    assert_close(build_refinement().block, first.block, abs=1e-6 * np.abs(first.block).max())
    assert files[0].stat().st_size > 1000


def test_the_compliance_at_rest_is_kept_and_that_of_another_modulus_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DOTSIM_ROS_CACHE", str(tmp_path))
    skin_m = skin_of(PAD).rest_position_m

    def kept(youngs_pa: float, poisson_ratio: float = 0.4) -> Float32Array:
        law = NeoHookean(youngs_pa, poisson_ratio)
        exact = inverse_at_rest(ElasticBody(grid_of(PAD), law, dtype=np.float32))
        found = kept_compliance(PAD, skin_m, grid_of(PAD), law)
        assert_close(found, exact, abs=1e-4 * np.abs(exact).max())
        return found

    first = kept(1.0e5)
    (file,) = tmp_path.iterdir()
    written = file.stat().st_mtime_ns
    assert np.array_equal(kept(1.0e5), first)
    kept(2.0e5)
    assert [f.stat().st_mtime_ns for f in tmp_path.iterdir()] == [written]
    kept(1.0e5, 0.45)
    assert len(list(tmp_path.iterdir())) == 2
    file.write_bytes(b"half a file")
    assert np.array_equal(kept(1.0e5), first)
