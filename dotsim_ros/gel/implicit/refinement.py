# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a finer grid adds to the skin's compliance at rest: fine contact at a coarse grid's cost.

The coarse grid cannot follow a contact narrower than its spacing. Its error is local and, to first
order, linear in the contact force: dG = G_fine - R G_coarse R^T, where R writes a coarse spline on
the fine grid (knot insertion of quadratic B-splines, nodes at cell centres: weights 3/4 and 1/4).
Contact then acts on positions x = X + S u + S_fine dG S_fine^T f. dG is computed once, kept for
pairs of nodes near each other, and cached on disk; it scales as 1/E.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from dotsim_ros.gel.body import Body
from dotsim_ros.gel.discretization import Discretization, discretize, images_of_cells
from dotsim_ros.gel.elasticity import GHOST_PENALTY, ElasticBody
from dotsim_ros.gel.implicit.block_solver import BlockCholesky
from dotsim_ros.gel.implicit.refinement_kernels import add_columns, gather_between
from dotsim_ros.gel.implicit.tangent import degrees_of_freedom
from dotsim_ros.gel.material import ElasticLaw, NeoHookean, small_strain_moduli_pa
from dotsim_ros.io.arrays import Float32Array, FloatArray, IndexArray
from dotsim_ros.io.cache import GEL, content_key, keep_table, load_arrays, tell_broken
from dotsim_ros.io.documents import ArrayForm
from dotsim_ros.io.files import cache_directory
from dotsim_ros.io.warp_runtime import wp

REACH_M = 7.0e-3
"""Pairs of nodes farther apart than this are left out of dG."""

TAPER_M = 14.0e-3
"""Length of the Gaussian that fades dG out towards its reach; a sharp end would make it indefinite
for contacts as wide as the reach."""


@dataclass(frozen=True)
class Refinement:
    """The added compliance at the fine grid's nodes next to the skin.

    Attributes:
        skin_weight: (V, F) weights of the fine nodes at the skin's markers.
        indptr: (F + 1,), index: (B,), block: (B, 3, 3) rows of dG, m/N.
    """

    skin_weight: sparse.csr_matrix
    indptr: IndexArray
    index: IndexArray
    block: Float32Array

    @property
    def node_count(self) -> int:
        return len(self.indptr) - 1

    def dense(self, nodes: IndexArray) -> Float32Array:
        """Return the (3 n, 3 n) block of dG between the given nodes (sorted)."""
        count = len(nodes)
        parts = self.by_component(nodes).reshape(3, count, 3, count)
        return np.ascontiguousarray(parts.transpose(1, 0, 3, 2)).reshape(3 * count, 3 * count)

    def by_component(self, nodes: IndexArray) -> Float32Array:
        """Return the (3 n, 3 n) block of dG between the given nodes with all x first."""
        number = np.full(self.node_count, -1, dtype=np.int32)
        number[nodes] = np.arange(len(nodes), dtype=np.int32)
        result = np.zeros((3 * len(nodes), 3 * len(nodes)), dtype=self.block.dtype)
        scalar = wp.float64 if self.block.dtype == np.float64 else wp.float32
        wp.launch(
            gather_between,
            dim=len(nodes),
            inputs=[
                wp.array(nodes, dtype=wp.int32, device="cpu"),
                wp.array(number, dtype=wp.int32, device="cpu", copy=False),
                wp.array(self.indptr, dtype=wp.int32, device="cpu", copy=False),
                wp.array(self.index, dtype=wp.int32, device="cpu", copy=False),
                wp.array(
                    self.block,
                    dtype=wp.types.matrix((3, 3), scalar),
                    device="cpu",
                    copy=False,
                ),
            ],
            outputs=[wp.array(result, dtype=scalar, device="cpu", copy=False)],
            device="cpu",
        )
        return result

    def displacement(self, nodes: IndexArray, force_n: FloatArray) -> FloatArray:
        """Return the displacement (F, 3) of all fine nodes under forces (n, 3) on some."""
        single = self.block.astype(np.float32, copy=False)
        result = wp.zeros(self.node_count, dtype=wp.vec3, device="cpu")
        wp.launch(
            add_columns,
            dim=len(nodes),
            inputs=[
                wp.array(nodes, dtype=wp.int32, device="cpu"),
                wp.array(force_n.astype(np.float32), dtype=wp.vec3, device="cpu"),
                wp.array(self.indptr, dtype=wp.int32, device="cpu", copy=False),
                wp.array(self.index, dtype=wp.int32, device="cpu", copy=False),
                wp.array(single, dtype=wp.mat33, device="cpu", copy=False),
            ],
            outputs=[result],
            device="cpu",
        )
        return result.numpy().astype(np.float64)


def knot_insertion(
    coarse: Discretization, fine: Discretization, nodes: IndexArray
) -> sparse.csr_matrix:
    """Return (n, N) weights that write a coarse spline at the given fine nodes.

    The fine spacing must be half of the coarse one.
    """
    numbers = {tuple(cell): i for i, cell in enumerate(coarse.node_cell.tolist())}
    rows, columns, values = [], [], []
    for row, cell in enumerate(fine.node_cell[nodes].tolist()):
        pairs = [((c // 2, 0.75), (c // 2 + (1 if c % 2 else -1), 0.25)) for c in cell]
        for (i, wi), (j, wj), (k, wk) in (
            (a, b, c) for a in pairs[0] for b in pairs[1] for c in pairs[2]
        ):
            sign = -1.0 if k < 0 else 1.0
            number = numbers.get((i, j, -1 - k if k < 0 else k))
            if number is not None:
                rows.append(row)
                columns.append(number)
                values.append(sign * wi * wj * wk)
    shape = (len(nodes), coarse.node_count)
    return sparse.coo_matrix((values, (rows, columns)), shape=shape).tocsr()


def refine(
    body: Body,
    skin_position_m: FloatArray,
    coarse: Discretization,
    coarse_compliance: Callable[[], Float32Array],
    law: ElasticLaw,
    *,
    progress: Callable[[float], None] | None = None,
) -> Refinement:
    """Return dG between a coarse grid and one of half its spacing, from the cache if it is there.

    Args:
        body: the gel's shape.
        skin_position_m: (V, 3) rest positions of the markers.
        coarse: the coarse grid.
        coarse_compliance: returns the (3 N, 3 N) inverse of its stiffness at rest, m/N; called
            where there is nothing in the cache, since it takes seconds.
        law: the material; only its Poisson's ratio matters for the cache.
        progress: called with the finished share, 0 to 1.
    """
    youngs, bulk = small_strain_moduli_pa(law)
    key = content_key(
        GEL,
        body,
        coarse.spacing_m,
        round(bulk / youngs, 9),
        GHOST_PENALTY,
        skin_position_m,
    )
    path = cache_directory() / f"refinement-{key}.npz"
    # The fine grid is what takes long to make: what is needed of it lies next to dG.
    table = _load(path)
    if table is None:
        fine = discretize(body, skin_position_m, coarse.spacing_m / 2.0)
        table = _compute(body, fine, coarse, coarse_compliance() * youngs, law, progress)
        _store(path, table)
    np.divide(table.block, np.float32(youngs), out=table.block)
    return table


def _compute(
    body: Body,
    fine: Discretization,
    coarse: Discretization,
    coarse_compliance: Float32Array,
    law: ElasticLaw,
    progress: Callable[[float], None] | None,
) -> Refinement:
    """Return dG for E = 1 Pa, which is what is kept on disk."""
    weight = fine.skin_interpolation.matrix(fine.node_count)
    supporting = images_of_cells(fine.node_cell[np.unique(weight.indices)], body).reshape(-1, 3)
    wanted = {tuple(c) for c in supporting.tolist()}
    nodes = np.array(
        [i for i, c in enumerate(fine.node_cell.tolist()) if tuple(c) in wanted], dtype=np.int32
    )
    youngs, bulk = small_strain_moduli_pa(law)
    elastic = ElasticBody(fine, NeoHookean(1.0, 0.5 - youngs / (6.0 * bulk)), dtype=np.float32)
    stiffness = elastic.stiffness(np.zeros((fine.node_count, 3), dtype=np.float32), 0)
    factor = BlockCholesky(stiffness.astype(np.float32), fine.node_cell)
    insertion = knot_insertion(coarse, fine, nodes).astype(np.float32)
    cell = fine.node_cell[nodes]
    centre = cell + 0.5
    number = {tuple(c): i for i, c in enumerate(cell.tolist())}
    images = np.array(
        [
            [number[tuple(c)] for c in np.floor(centre @ s.T).astype(int).tolist()]
            for s in body.symmetries
        ]
    )
    # Of its images a node in the last slab leads: a solve begins at the first slab with a force.
    rank = np.argsort(np.argsort(cell[:, factor.axis], kind="stable"))
    leader = images[rank[images].argmax(axis=0), np.arange(len(nodes))]
    leaders = np.flatnonzero(leader == np.arange(len(nodes)))
    leaders = leaders[np.argsort(rank[leaders])]
    tree = cKDTree(fine.node_position_m[nodes])
    neighbours: list[IndexArray] = [np.zeros(0, dtype=np.int32)] * len(nodes)
    blocks: list[Float32Array] = [np.zeros((0, 3, 3), dtype=np.float32)] * len(nodes)
    batch = 64
    spread = sparse.kron(insertion, sparse.eye(3, dtype=np.float32), format="csr")
    for first in range(0, len(leaders), batch):
        group = leaders[first : first + batch]
        reached = [
            np.array(near, dtype=np.int32)
            for near in tree.query_ball_point(fine.node_position_m[nodes[group]], REACH_M)
        ]
        rows = np.unique(np.concatenate(reached))
        forced, needed = degrees_of_freedom(nodes[group]), degrees_of_freedom(nodes[rows])
        right = np.zeros((3 * fine.node_count, len(forced)), dtype=np.float32)
        right[forced, np.arange(len(forced))] = 1.0
        # The coarse compliance is symmetric.
        coarse_column = (spread[degrees_of_freedom(group.astype(np.int32))] @ coarse_compliance).T
        column = factor.solve(right, needed)[needed]
        column -= spread[degrees_of_freedom(rows)] @ coarse_column
        column = column.reshape(len(rows), 3, len(group), 3)
        for position, (leading, near) in enumerate(zip(group, reached, strict=True)):
            # Rows of dG: block (leading, near) is the transpose of block (near, leading).
            block = column[np.searchsorted(rows, near), :, position, :].transpose(0, 2, 1)
            for symmetry, image in zip(body.symmetries.astype(np.float32), images, strict=True):
                neighbours[image[leading]] = image[near].astype(np.int32)
                blocks[image[leading]] = symmetry @ block @ symmetry.T
        if progress is not None:
            progress(min(1.0, (first + batch) / len(leaders)))
    indptr = np.concatenate([[0], np.cumsum([len(n) for n in neighbours])]).astype(np.int32)
    index, node_m = np.concatenate(neighbours), fine.node_position_m[nodes]
    row = np.repeat(np.arange(len(nodes)), np.diff(indptr))
    distance = np.linalg.norm(node_m[row] - node_m[index], axis=1)
    block = np.concatenate(blocks) * np.exp(-((distance / TAPER_M) ** 2))[:, None, None]
    return Refinement(weight[:, nodes], indptr, index, block.astype(np.float32))


_FORMS = {
    "indptr": ArrayForm((None,), "whole number"),
    "index": ArrayForm((None,), "whole number"),
    "block": ArrayForm((None, 3, 3)),
    "weight": ArrayForm((None,)),
    "weight_index": ArrayForm((None,), "whole number"),
    "weight_indptr": ArrayForm((None,), "whole number"),
}


def _load(path: Path) -> Refinement | None:
    stored = load_arrays(path, _FORMS)
    if stored is None:
        return None
    count = len(stored["indptr"]) - 1
    try:
        weight = sparse.csr_matrix(
            (stored["weight"], stored["weight_index"], stored["weight_indptr"]),
            shape=(len(stored["weight_indptr"]) - 1, count),
        )
        weight.check_format()
        # The same rules hold for the rows of dG.
        sparse.csr_matrix(
            (np.arange(len(stored["index"])), stored["index"], stored["indptr"]),
            shape=(count, count),
        ).check_format()
    except ValueError as error:
        tell_broken(path, error)
        return None
    return Refinement(weight, stored["indptr"], stored["index"], stored["block"])


def _store(path: Path, table: Refinement) -> None:
    keep_table(
        path,
        {
            "indptr": table.indptr,
            "index": table.index,
            "block": table.block,
            "weight": table.skin_weight.data,
            "weight_index": table.skin_weight.indices,
            "weight_indptr": table.skin_weight.indptr,
        },
    )
