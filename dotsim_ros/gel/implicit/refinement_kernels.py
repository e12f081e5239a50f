# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels of the refinement."""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, arg-type, assignment, index, operator, misc"

from typing import Any

from dotsim_ros.io.warp_runtime import wp


@wp.kernel(enable_backward=False)
def add_columns(
    node: wp.array(dtype=wp.int32),
    force: wp.array(dtype=wp.vec3),
    indptr: wp.array(dtype=wp.int32),
    index: wp.array(dtype=wp.int32),
    block: wp.array(dtype=wp.mat33),
    displacement: wp.array(dtype=wp.vec3),
):
    """Add dG times the forces on some nodes; dG is symmetric, so a row's transpose is a column."""
    i = wp.tid()
    n = node[i]
    for k in range(indptr[n], indptr[n + 1]):
        wp.atomic_add(displacement, index[k], wp.transpose(block[k]) * force[i])


@wp.kernel(enable_backward=False)
def gather_between(
    node: wp.array(dtype=wp.int32),
    number: wp.array(dtype=wp.int32),
    indptr: wp.array(dtype=wp.int32),
    index: wp.array(dtype=wp.int32),
    block: wp.array(dtype=Any),
    matrix: wp.array2d(dtype=Any),
):
    """Write dG between some nodes, whose numbers the others lack (-1), by component."""
    i = wp.tid()
    count = node.shape[0]
    n = node[i]
    for k in range(indptr[n], indptr[n + 1]):
        j = number[index[k]]
        if j >= 0:
            b = block[k]
            for row in range(3):
                for column in range(3):
                    matrix[row * count + i, column * count + j] = b[row, column]
