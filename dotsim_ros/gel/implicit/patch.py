# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The part of the skin that the indenter can touch in a step, as contact sees it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dotsim_ros.gel.implicit.contact_problem import by_component, by_marker
from dotsim_ros.gel.implicit.refinement import Refinement
from dotsim_ros.io.arrays import AnyFloatArray, Float32Array, FloatArray, IndexArray


@dataclass(frozen=True)
class Patch:
    """Markers that may come into contact, with their weights on the grid and on the refinement.

    Attributes:
        marker: (C,) numbers of the markers.
        rest_position_m: (C, 3).
        weight: (C, N) weights of the grid's nodes.
        node: (n,) nodes of the grid next to the markers.
        node_weight: (C, n) their weights once more, dense.
        fine_node: (F,) nodes of the refinement next to the markers.
        fine_weight: (C, F) weights of those.
        fine_node_weight: (C, F) the same, dense.
        added_compliance: (3 F, 3 F) of the refinement by component, m/N; empty without one.
    """

    marker: IndexArray
    rest_position_m: FloatArray
    weight: sparse.csr_matrix
    node: IndexArray
    node_weight: FloatArray
    fine_node: IndexArray
    fine_weight: sparse.csr_matrix
    fine_node_weight: Float32Array
    added_compliance: Float32Array

    def added_displacement(self, force_n: FloatArray) -> FloatArray:
        """Return what the refinement adds to the markers' displacement under forces (C, 3)."""
        if len(self.fine_node) == 0:
            return np.zeros_like(force_n)
        load = by_component(self.fine_weight.T @ force_n)
        flat = self.added_compliance @ load.astype(self.added_compliance.dtype)
        moved: FloatArray = self.fine_weight @ by_marker(flat)
        return moved

    def position(self, displacement_m: FloatArray, added_m: FloatArray) -> FloatArray:
        """Return the markers (C, 3) at displacements (N, 3) of the grid, with (C, 3) added."""
        position: FloatArray = self.rest_position_m + self.weight @ displacement_m + added_m
        return position


def make_patch(
    marker: IndexArray,
    skin_position_m: FloatArray,
    skin_weight: sparse.csr_matrix,
    refinement: Refinement | None,
) -> Patch:
    """Return the patch of the given markers."""
    if refinement is None:
        fine_weight = sparse.csr_matrix((len(marker), 0))
        nodes, compliance = np.zeros(0, dtype=np.int32), np.zeros((0, 0), dtype=np.float32)
    else:
        rows = refinement.skin_weight[marker]
        nodes = np.unique(rows.indices).astype(np.int32)
        fine_weight = sparse.csr_matrix(
            (rows.data, np.searchsorted(nodes, rows.indices), rows.indptr),
            shape=(len(marker), len(nodes)),
        )
        compliance = refinement.by_component(nodes)
    weight = skin_weight[marker]
    node = np.unique(weight.indices).astype(np.int32)
    return Patch(
        marker,
        skin_position_m[marker],
        weight,
        node,
        weight[:, node].toarray(),
        nodes,
        fine_weight,
        fine_weight.toarray().astype(np.float32),
        compliance,
    )


def _component_order(matrix: AnyFloatArray) -> AnyFloatArray:
    """Return a (3 n, 3 n) matrix whose rows and columns go node by node, by component."""
    count = len(matrix) // 3
    blocks = matrix.reshape(count, 3, count, 3).transpose(1, 0, 3, 2)
    return np.ascontiguousarray(blocks).reshape(3 * count, 3 * count)


class NearMarkers:
    """Markers in contact or close to it, and the grid's nodes next to them.

    Args:
        patch: the patch.
        rows: (A,) its rows that may be in contact in this step.

    Attributes:
        rows: as given.
        marker: (A,) their numbers.
        node: (n,) grid nodes next to them.
        weight: (A, n) their weights on these.
    """

    def __init__(self, patch: Patch, rows: NDArray[np.int64]) -> None:
        self.rows = rows
        self.marker = patch.marker[rows]
        weight = patch.node_weight[rows]
        beside = np.flatnonzero(weight.any(axis=0))
        self.node = patch.node[beside]
        self.weight: FloatArray = weight[:, beside]
        count = len(rows)
        self._added = np.zeros((3 * count, 3 * count), dtype=np.float32)
        if len(patch.fine_node):
            fine_weight = patch.fine_node_weight[rows]
            fine = np.flatnonzero(fine_weight.any(axis=0))
            dof = (np.arange(3)[:, None] * len(patch.fine_node) + fine).ravel()
            _add_between(
                self._added,
                np.ascontiguousarray(fine_weight[:, fine]),
                patch.added_compliance[dof].take(dof, axis=1),
            )

    def compliance(self, of_nodes: AnyFloatArray) -> AnyFloatArray:
        """Return (3 A, 3 A) of the gel between the markers by component, the refinement included.

        Args:
            of_nodes: (3 n, 3 n) of the grid between the nodes next to them, node by node.
        """
        result = self._added.astype(of_nodes.dtype)
        _add_between(result, self.weight.astype(of_nodes.dtype), _component_order(of_nodes))
        return result

    def displacement(self, of_nodes_m: FloatArray) -> FloatArray:
        """Return the markers' displacement (A, 3) on the grid under (N, 3) of its nodes."""
        moved: FloatArray = self.weight @ of_nodes_m[self.node]
        return moved

    def load(self, force_n: FloatArray, node_count: int) -> FloatArray:
        """Return the forces (N, 3) on the grid's nodes under (A, 3) on the markers."""
        load = np.zeros((node_count, 3))
        load[self.node] = self.weight.T @ force_n
        return load


def _add_between(result: AnyFloatArray, weight: AnyFloatArray, between: AnyFloatArray) -> None:
    """Add W Z W^T to (3 A, 3 A), for weights (A, n) and Z (3 n, 3 n) symmetric, by component."""
    count, nodes = weight.shape
    for i in range(3):
        rows = slice(i * count, (i + 1) * count)
        half = weight @ between[i * nodes : (i + 1) * nodes, i * nodes :].reshape(nodes, -1)
        for j in range(i, 3):
            block = half[:, (j - i) * nodes : (j - i + 1) * nodes] @ weight.T
            columns = slice(j * count, (j + 1) * count)
            result[rows, columns] += block
            if j > i:
                result[columns, rows] += block.T
