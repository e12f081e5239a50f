# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel's linear solves against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from dotsim_ros.gel.body import Dome, Pad
from dotsim_ros.gel.discretization import Discretization, discretize
from dotsim_ros.gel.elasticity import ElasticBody
from dotsim_ros.gel.implicit.block_solver import BlockCholesky
from dotsim_ros.gel.implicit.tangent import (
    ExactTangent,
    LocalTangent,
    bordered,
    degrees_of_freedom,
    factor_shifted,
    inverse_at_rest,
    inverse_of_positive,
    without,
)
from dotsim_ros.gel.material import NeoHookean

LAW = NeoHookean(1.0e5, 0.45)


def random_grid(shape: tuple[int, int, int]) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Return a positive definite matrix that couples nodes up to three lines apart."""
    random = np.random.default_rng(0)
    cell = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    cell = cell[random.permutation(len(cell))] - 2
    near = np.abs(cell[:, None] - cell[None]).max(axis=-1) <= 3
    dense = np.kron(near, np.ones((3, 3))) * random.normal(size=(3 * len(cell),) * 2)
    dense = dense + dense.T
    dense += np.diag(np.abs(dense).sum(axis=1) + 1.0)
    return sparse.csr_matrix(dense), cell


@pytest.mark.parametrize("shape", [(2, 11, 2), (3, 3, 7)])
@pytest.mark.parametrize("columns", [None, 4])
def test_block_cholesky_agrees_with_scipy(shape: tuple[int, int, int], columns: int | None) -> None:
    matrix, cell = random_grid(shape)
    size = (matrix.shape[0],) if columns is None else (matrix.shape[0], columns)
    right = np.random.default_rng(1).normal(size=size)
    found = BlockCholesky(matrix, cell).solve(right)
    expected = sparse_linalg.spsolve(matrix.tocsc(), right)
    assert found == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("forced_line", "wanted_line"), [(10, 7), (2, 9)])
def test_block_cholesky_gives_the_rows_that_are_wanted(forced_line: int, wanted_line: int) -> None:
    matrix, cell = random_grid((2, 14, 2))
    line = cell[:, 1] - cell[:, 1].min()
    forced = degrees_of_freedom(np.flatnonzero(line == forced_line))
    wanted = degrees_of_freedom(np.flatnonzero(line >= wanted_line))
    right = np.zeros((matrix.shape[0], len(forced)))
    right[forced, np.arange(len(forced))] = 1.0
    factor = BlockCholesky(matrix, cell)
    found = factor.solve(right, wanted)
    assert found[wanted] == pytest.approx(factor.solve(right)[wanted], abs=1e-15)
    assert not found[line.repeat(3) < wanted_line - 2].any()  # nor is the rest computed


def test_block_cholesky_refuses_an_indefinite_matrix() -> None:
    matrix, cell = random_grid((6, 2, 2))
    with pytest.raises(np.linalg.LinAlgError):
        BlockCholesky((-matrix).tocsr(), cell)


@pytest.fixture(scope="module")
def grid() -> Discretization:
    return discretize(Dome(12.0e-3, 4.0e-3), np.array([[0.0, 0.0, 12.0e-3]]), 2.4e-3)


def test_block_cholesky_of_the_gel(grid: Discretization) -> None:
    matrix = ElasticBody(grid, LAW).stiffness(np.zeros((grid.node_count, 3)), 0)
    right = np.random.default_rng(2).normal(size=matrix.shape[0])
    found = BlockCholesky(matrix, grid.node_cell).solve(right)
    assert np.abs(matrix @ found - right).max() < 1e-8


def test_local_tangent_is_the_inverse_at_rest(grid: Discretization) -> None:
    mass = grid.mass_over_density * (1070.0 / 1e-3**2)
    single = ElasticBody(grid, LAW, dtype=np.float32)
    local = LocalTangent(single, inverse_at_rest(single, mass))
    rest = np.zeros((grid.node_count, 3))
    double = ElasticBody(grid, LAW).stiffness(rest, 0) + sparse.kron(mass, sparse.eye(3))
    right = np.random.default_rng(3).normal(size=3 * grid.node_count)
    expected = sparse_linalg.spsolve(double.tocsc(), right)
    found = local.solve_at_rest(right)
    assert np.linalg.norm(found - expected) < 1e-4 * np.linalg.norm(expected)
    exact = ExactTangent(single, mass).factor(rest.astype(np.float32), 0)
    solved = exact.solve(right.astype(np.float32))
    assert np.linalg.norm(solved - expected) < 1e-4 * np.linalg.norm(expected)


def test_region_step_is_exact_where_the_strain_lies_within() -> None:
    """With all cells in the region the local step is the whole Newton step."""
    body = Pad((9.6e-3, 9.6e-3, 7.2e-3))
    grid = discretize(body, np.array([[0.0, 0.0, 7.2e-3]]), 2.4e-3)
    single = ElasticBody(grid, LAW, dtype=np.float32)
    local = LocalTangent(single, inverse_at_rest(single))
    field = 0.05 * grid.node_position_m[:, 2:] * np.array([0.5, -0.3, 1.0])
    every = np.arange(grid.node_count, dtype=np.int32)
    region = local.region(single.all_cells, every, 0)
    stiffness = local.assemble(region, field.astype(np.float32), 0)
    factor = local.factor(region, stiffness)
    double = ElasticBody(grid, LAW).stiffness(field, 0)
    right = np.random.default_rng(4).normal(size=3 * grid.node_count)
    expected = sparse_linalg.spsolve(double.tocsc(), right)
    assert np.linalg.norm(factor.solve(right) - expected) < 1e-3 * np.linalg.norm(expected)


def test_inverse_of_positive() -> None:
    random = np.random.default_rng(5).normal(size=(40, 40)).astype(np.float32)
    matrix = np.asfortranarray(random @ random.T + 40.0 * np.eye(40, dtype=np.float32))
    kept = matrix.copy()
    inverse = inverse_of_positive(matrix)
    assert inverse @ kept == pytest.approx(np.eye(40), abs=1e-4)
    assert np.array_equal(inverse, inverse.T)
    with pytest.raises(np.linalg.LinAlgError, match="40 rows"):
        inverse_of_positive(np.asfortranarray(-kept))


def test_shift_is_the_first_that_helps() -> None:
    tried: list[float] = []

    def factor(share: float) -> float:
        tried.append(share)
        if share < 0.05:
            raise np.linalg.LinAlgError("not yet")
        return share

    assert factor_shifted(factor) == 0.1
    assert tried == sorted(tried)

    def hopeless(share: float) -> float:
        raise np.linalg.LinAlgError(f"never, {share}")

    with pytest.raises(np.linalg.LinAlgError, match="never"):
        factor_shifted(hopeless)


def test_inverse_follows_a_region_that_grows_and_shrinks() -> None:
    random = np.random.default_rng(0)
    node = np.arange(40, dtype=np.int32)
    half = random.normal(size=(120, 120))
    matrix = (half @ half.T + 120.0 * np.eye(120)).astype(np.float32)
    first, added = node[:25], node[25:]
    inverse = inverse_of_positive(np.asfortranarray(matrix[:75, :75]))
    grown = bordered(inverse, matrix, degrees_of_freedom(first), degrees_of_freedom(added))
    np.testing.assert_allclose(grown @ matrix, np.eye(120), atol=2e-4)
    is_kept = np.arange(40) % 3 != 0
    kept = degrees_of_freedom(node[is_kept])
    shrunk = without(grown, is_kept)
    np.testing.assert_allclose(shrunk @ matrix[np.ix_(kept, kept)], np.eye(len(kept)), atol=2e-4)
    assert without(grown, np.ones(40, dtype=bool)) is grown
    assert bordered(grown, matrix, degrees_of_freedom(node), node[:0]) is grown
