# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The contact problem of `contact` in one kernel: a block of threads solves a gel's to its end.

The threads of a block, here lanes, share the sums over markers; on a CPU a block has one lane. A
sum over numbers goes over those of each lane first, every lane then has the whole.
"""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: ignore-errors

from dotsim_ros.gel.batched.kernels import (
    ROUNDS_ONCE,
    ContactLaw,
    IndenterField,
    add,
    coulomb,
    lanes_max,
    lanes_sum,
    meet,
    product,
)
from dotsim_ros.io.warp_runtime import wp

wp.set_module_options({"enable_backward": False})

KRYLOV = 8
"""Steps of GMRES at most..."""
FORCING = 0.03
"""...which ends where its residual is below this share of the right hand side."""
LARGEST_STEP_M = 0.3e-3
"""No Newton step moves a marker farther."""
LEAST_FORCE_N = 1.0e-12
"""Smaller forces on all markers of a gel are none: their squares would underflow."""
SECANTS = 2
"""Trial steps of a line search."""

_LARGEST_STEP_M = wp.constant(LARGEST_STEP_M)
_LEAST_FORCE_N = wp.constant(LEAST_FORCE_N)
_FORCING = wp.constant(FORCING)
_KRYLOV = wp.constant(KRYLOV)
_SECANTS = wp.constant(SECANTS)
_triangle = wp.types.matrix(shape=(KRYLOV, KRYLOV), dtype=wp.float32)
_vector = wp.types.vector(length=KRYLOV + 1, dtype=wp.float32)


@wp.struct
class Problem:
    """Of all gels b and their markers m, in the order of the fields' axes.

    compliance: [place[b], 3 m, 3 m] between the markers, m/N, symmetric; base: without contact
    forces; guess: where the markers may come to lie; area, start_position, start_slip: as `coulomb`
    takes them; gel: [b] numbers of the gels, for field, rotation, origin and law of all.
    """

    compliance: wp.array3d(dtype=wp.float32)
    base: wp.array2d(dtype=wp.vec3)
    guess: wp.array2d(dtype=wp.vec3)
    area: wp.array2d(dtype=wp.float32)
    start_position: wp.array2d(dtype=wp.vec3)
    start_slip: wp.array2d(dtype=wp.vec3)
    place: wp.array(dtype=wp.int32)
    gel: wp.array(dtype=wp.int32)
    field: wp.array(dtype=IndenterField)
    rotation: wp.array(dtype=wp.mat33)
    origin: wp.array(dtype=wp.vec3)
    law: wp.array(dtype=ContactLaw)


@wp.struct
class Answer:
    """force: [b, 3 m], the first ones, and the solution; position, distance, slip: of the markers
    under it."""

    force: wp.array2d(dtype=wp.float32)
    position: wp.array2d(dtype=wp.vec3)
    distance: wp.array2d(dtype=wp.float32)
    slip: wp.array2d(dtype=wp.vec3)


@wp.struct
class Memory:
    """Of the solution, uninitialised. answer, stiffness: of the indenter at the markers; moved,
    step: [b, 3 m] by the forces and by their change; basis: [b, KRYLOV + 1, 3 m] of GMRES."""

    answer: wp.array2d(dtype=wp.vec3)
    stiffness: wp.array2d(dtype=wp.mat33)
    moved: wp.array2d(dtype=wp.float32)
    step: wp.array2d(dtype=wp.float32)
    change: wp.array2d(dtype=wp.float32)
    basis: wp.array3d(dtype=wp.float32)


# It is symmetric: adjacent lanes read adjacent numbers of a row. Eight rows at once leave the sums
# in registers. The compiler makes vectors of the inner loop where a block has one lane.
@wp.func_native(
    ROUNDS_ONCE
    + """
    constexpr int lanes = WP_TILE_BLOCK_DIM;
    const int size = compliance.shape[2];
    const float* __restrict__ c = compliance.data + (long long)b * compliance.shape[1] * size;
    const float* __restrict__ f = force.data;
    float* __restrict__ x = moved.data;
    WP_TILE_SYNC();
    for (int j = lane; j < columns; j += lanes) x[j] = 0.0f;
    int i = 0;
    for (; i + 8 <= rows; i += 8) {
        const float* row = c + (long long)i * size;
        const float f0 = f[i], f1 = f[i + 1], f2 = f[i + 2], f3 = f[i + 3];
        const float f4 = f[i + 4], f5 = f[i + 5], f6 = f[i + 6], f7 = f[i + 7];
        for (int j = lane; j < columns; j += lanes) {
            x[j] += ((f0 * row[j] + f1 * row[j + size])
                + (f2 * row[j + 2 * size] + f3 * row[j + 3 * size]))
                + ((f4 * row[j + 4 * size] + f5 * row[j + 5 * size])
                + (f6 * row[j + 6 * size] + f7 * row[j + 7 * size]));
        }
    }
    for (; i < rows; ++i) {
        const float* row = c + (long long)i * size;
        const float fi = f[i];
        for (int j = lane; j < columns; j += lanes) x[j] += fi * row[j];
    }
    WP_TILE_SYNC();
"""
)
def multiply(
    b: int,
    lane: int,
    compliance: wp.array3d(dtype=wp.float32),
    rows: int,
    columns: int,
    force: wp.array(dtype=wp.float32),
    moved: wp.array(dtype=wp.float32),
):
    """Write the first numbers of C f; only the first of f are not zero."""
    ...


@wp.func_native("for (int i = lane; i < count; i += WP_TILE_BLOCK_DIM) a.data[i] *= factor;")
def scale(lane: int, count: int, factor: wp.float32, a: wp.array(dtype=wp.float32)):
    """Multiply the first numbers by a factor, a lane's part."""
    ...


@wp.func
def vector_of(numbers: wp.array(dtype=wp.float32), m: int):
    """Return the vector of a marker."""
    return wp.vec3(numbers[3 * m], numbers[3 * m + 1], numbers[3 * m + 2])


@wp.func
def respond(b: int, lane: int, share: wp.float32, problem: Problem, answer: Answer, memory: Memory):
    """Find what the indenter answers the markers moved by a share of a step."""
    for m in range(lane, problem.base.shape[1], wp.block_dim()):
        x = problem.base[b, m] + vector_of(memory.moved[b], m)
        x += share * vector_of(memory.step[b], m)
        touch(b, m, x, problem, answer, memory)


@wp.func
def touch(b: int, m: int, x: wp.vec3, problem: Problem, answer: Answer, memory: Memory):
    """Find what the indenter answers a marker at x."""
    g = problem.gel[b]
    force, stiffness, distance, slip = coulomb(
        x,
        problem.area[b, m],
        problem.field[g],
        problem.rotation[g],
        problem.origin[g],
        problem.law[g],
        problem.start_position[b, m],
        problem.start_slip[b, m],
    )
    memory.answer[b, m] = force
    memory.stiffness[b, m] = stiffness
    answer.distance[b, m] = distance
    answer.slip[b, m] = slip


@wp.func
def gmres(b: int, lane: int, count: int, problem: Problem, memory: Memory):
    """Write the change df of (I + H C) df = right, which lies in the first vector of the basis and
    is there of unit length then; return its length. Only the first markers take part.

    The basis is that of Arnoldi's process, and Givens's rotations keep the residual known.
    """
    basis = memory.basis[b]
    change = memory.change[b]
    numbers = 3 * count
    lanes = wp.block_dim()
    triangle = _triangle()
    cosine = _vector()
    sine = _vector()
    turned = _vector()
    meet()
    size = wp.sqrt(product(lane, numbers, basis[0], basis[0]))
    turned[0] = size
    scale(lane, numbers, 1.0 / size, basis[0])
    done = wp.int32(0)
    for k in range(_KRYLOV):
        image = basis[k + 1]
        multiply(problem.place[b], lane, problem.compliance, numbers, numbers, basis[k], image)
        for m in range(lane, count, lanes):
            x = memory.stiffness[b, m] * vector_of(image, m)
            for i in range(3):
                image[3 * m + i] = basis[k, 3 * m + i] + x[i]
        meet()
        column = _vector()
        # Twice is enough for orthogonality to the last bits.
        for _ in range(2):
            for j in range(k + 1):
                along = product(lane, numbers, basis[j], image)
                column[j] = column[j] + along
                add(lane, numbers, -along, basis[j], image)
        length = wp.sqrt(product(lane, numbers, image, image))
        scale(lane, numbers, 1.0 / wp.max(length, 1.0e-30), image)
        for j in range(k):
            above = column[j]
            below = column[j + 1]
            column[j] = cosine[j] * above + sine[j] * below
            column[j + 1] = cosine[j] * below - sine[j] * above
        whole = wp.sqrt(column[k] * column[k] + length * length)
        cosine[k] = column[k] / wp.max(whole, 1.0e-30)
        sine[k] = length / wp.max(whole, 1.0e-30)
        column[k] = whole
        for j in range(k + 1):
            triangle[j, k] = column[j]
        turned[k + 1] = -sine[k] * turned[k]
        turned[k] = cosine[k] * turned[k]
        done = k + 1
        if wp.abs(turned[k + 1]) < _FORCING * size:
            break
    largest = wp.float32(1.0e-30)
    for k in range(done):
        largest = wp.max(largest, triangle[k, k])
    for reverse in range(done):
        k = done - 1 - reverse
        for j in range(k + 1, done):
            turned[k] = turned[k] - triangle[k, j] * turned[j]
        turned[k] = turned[k] / wp.max(triangle[k, k], 1.0e-7 * largest)
    for k in range(done):
        add(lane, numbers, turned[k], basis[k], change)
    meet()
    return size


@wp.func
def secant_share(
    b: int,
    lane: int,
    count: int,
    size: wp.float32,
    share: wp.float32,
    problem: Problem,
    answer: Answer,
    memory: Memory,
):
    """Return a share of a Newton step after which it would not turn back, with the indenter's
    answer there; that at the given share is known. The residual before is the first vector of the
    basis times its length."""
    before = size * product(lane, 3 * count, memory.step[b], memory.basis[b, 0])
    for _ in range(_SECANTS):
        part = wp.float32(0.0)
        for m in range(lane, problem.base.shape[1], wp.block_dim()):
            left = memory.answer[b, m] - vector_of(answer.force[b], m)
            left -= share * vector_of(memory.change[b], m)
            part += wp.dot(vector_of(memory.step[b], m), left)
        after = lanes_sum(part)
        if before <= 0.0 or after >= -0.5 * before:
            break
        share *= wp.clamp(before / (before - after), 0.1, 0.9)
        respond(b, lane, share, problem, answer, memory)
    return share


@wp.kernel
def solve(
    problem: Problem, newton_steps: int, tolerance: wp.float32, answer: Answer, memory: Memory
):
    """Solve the contact of gel b; it ends after so many steps, or where no marker moves farther
    than the tolerance."""
    b, lane = wp.tid()
    markers = problem.base.shape[1]
    lanes = wp.block_dim()
    force = answer.force[b]
    moved = memory.moved[b]
    step = memory.step[b]
    change = memory.change[b]
    # What follows the last marker with a force or a stiffness takes no part.
    last = wp.float32(-1.0)
    for m in range(lane, markers, lanes):
        touch(b, m, problem.guess[b, m], problem, answer, memory)
        if wp.length_sq(vector_of(force, m)) > 0.0:
            last = wp.float32(m)
    count = 1 + int(lanes_max(last))
    multiply(problem.place[b], lane, problem.compliance, 3 * count, 3 * markers, force, moved)
    # The indenter's linear answer around the guess, at the markers that the forces would cause.
    for m in range(lane, markers, lanes):
        off = problem.base[b, m] + vector_of(moved, m) - problem.guess[b, m]
        memory.answer[b, m] = memory.answer[b, m] - memory.stiffness[b, m] * off
    for number in range(newton_steps):
        last = wp.float32(-1.0)
        most = wp.float32(0.0)
        for m in range(lane, markers, lanes):
            left = memory.answer[b, m] - vector_of(force, m)
            for i in range(3):
                memory.basis[b, 0, 3 * m + i] = left[i]
                change[3 * m + i] = 0.0
            most = wp.max(most, wp.length(left))
            if wp.length_sq(left) > 0.0 or wp.trace(memory.stiffness[b, m]) != 0.0:
                last = wp.float32(m)
        count = 1 + int(lanes_max(last))
        size = wp.float32(0.0)
        if lanes_max(most) >= _LEAST_FORCE_N:
            size = gmres(b, lane, count, problem, memory)
        multiply(problem.place[b], lane, problem.compliance, 3 * count, 3 * markers, change, step)
        most = wp.float32(0.0)
        for i in range(lane, 3 * markers, lanes):
            most = wp.max(most, wp.abs(step[i]))
        largest = lanes_max(most)
        share = wp.min(_LARGEST_STEP_M / wp.max(largest, 1.0e-12), 1.0)
        respond(b, lane, share, problem, answer, memory)
        if number > 0:
            share = secant_share(b, lane, count, size, share, problem, answer, memory)
        meet()
        for i in range(lane, 3 * markers, lanes):
            moved[i] = moved[i] + share * step[i]
            force[i] = force[i] + share * change[i]
        meet()
        if largest * share < tolerance:
            break
    for m in range(lane, markers, lanes):
        answer.position[b, m] = problem.base[b, m] + vector_of(moved, m)
