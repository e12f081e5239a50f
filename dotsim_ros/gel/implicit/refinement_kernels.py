# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels of the refinement."""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, arg-type, assignment, index, operator, misc"

from typing import Any

from dotsim_ros.io.warp_runtime import wp

LEAST_RATIO = wp.constant(0.05)
"""Where the gel is left with less of its volume, its gradient tells no turn."""
HALVINGS = wp.constant(6)
"""Steps of Newton's method to the turn in a gradient."""


@wp.func
def gradient_at(
    b: int,
    f: int,
    node: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.vec3),
    displacement: wp.array2d(dtype=wp.vec3),
):
    """Return a gel's deformation gradient at a point with such stencils; that at rest where it is
    left without a volume."""
    result = wp.identity(n=3, dtype=wp.float32)
    for a in range(27):
        result += wp.outer(displacement[b, node[f, a]], gradient[f, a])
    if wp.determinant(result) <= LEAST_RATIO:
        result = wp.identity(n=3, dtype=wp.float32)
    return result


@wp.func
def turn_in(gradient: wp.mat33):
    """Return the turn in a gradient (Higham, "Functions of Matrices", 2008, chapter 8)."""
    result = gradient
    for _ in range(HALVINGS):
        result = 0.5 * (result + wp.transpose(wp.inverse(result)))
    return result


@wp.kernel(enable_backward=False)
def turn_with_gel(
    node: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.vec3),
    displacement: wp.array2d(dtype=wp.vec3),
    turn: wp.array2d(dtype=wp.mat33),
):
    """Write how gels [b] turn at points [f]."""
    b, f = wp.tid()
    turn[b, f] = turn_in(gradient_at(b, f, node, gradient, displacement))


@wp.kernel(enable_backward=False)
def resist_turning(
    node: wp.array2d(dtype=wp.int32),
    gradient: wp.array2d(dtype=wp.vec3),
    displacement: wp.array2d(dtype=wp.vec3),
    force: wp.array2d(dtype=wp.vec3),
    moved: wp.array2d(dtype=wp.vec3),
    nodal: wp.array2d(dtype=wp.vec3),
):
    """Add to the nodes' forces those by which gels [b] resist to be turned by forces on points [f]
    that have moved so: as `Turning.resistance`."""
    b, f = wp.tid()
    couple = wp.cross(moved[b, f], force[b, f])
    if wp.length_sq(couple) == 0.0:
        return
    deformed = gradient_at(b, f, node, gradient, displacement)
    turn = turn_in(deformed)
    stretch = wp.transpose(turn) * deformed
    matrix = wp.trace(stretch) * wp.identity(n=3, dtype=wp.float32) - stretch
    spin = wp.inverse(matrix) * (wp.transpose(turn) * couple)
    for a in range(27):
        wp.atomic_add(nodal, b, node[f, a], turn * wp.cross(spin, gradient[f, a]))


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
    turn: wp.array(dtype=Any),
    matrix: wp.array2d(dtype=Any),
):
    """Write dG between some nodes, whose numbers the others lack (-1), by component, turned as the
    gel is."""
    i = wp.tid()
    count = node.shape[0]
    n = node[i]
    for k in range(indptr[n], indptr[n + 1]):
        j = number[index[k]]
        if j >= 0:
            b = turn[n] * block[k] * wp.transpose(turn[index[k]])
            for row in range(3):
                for column in range(3):
                    matrix[row * count + i, column * count + j] = b[row, column]
