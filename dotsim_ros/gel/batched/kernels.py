# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels of many gels, in single precision; B is the number of gels."""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, arg-type, assignment, index, operator, misc"

from dotsim_ros.gel.distance_field import distance_functions
from dotsim_ros.gel.elastic_kernels import elastic_kernels
from dotsim_ros.gel.implicit.contact_kernels import contact_kernels
from dotsim_ros.io.warp_runtime import wp

wp.set_module_options({"enable_backward": False})

KRYLOV = 8
"""Steps of GMRES at most."""

_hessenberg = wp.types.matrix(shape=(KRYLOV + 1, KRYLOV), dtype=wp.float32)
_turned = wp.types.vector(length=KRYLOV + 1, dtype=wp.float32)
_distance = distance_functions(wp.float32)
_elastic = elastic_kernels(wp.float32)
_contact = contact_kernels(wp.float32)
IndenterField = _distance.IndenterField
ContactLaw = _contact.ContactLaw
indenter_distance = _distance.indenter_distance
coefficients = _elastic.vec5
shape_stress = _elastic.shape_stress
volume_stress = _elastic.volume_stress
pressure = _contact.pressure
pressure_slope = _contact.pressure_slope


@wp.func
def deformation_gradient(gradient: wp.array3d(dtype=wp.float32), p: int, b: int):
    """Return F of a particle, of gradient[3 p + j, i, b] = du_i/dX_j."""
    f = wp.identity(3, dtype=wp.float32)
    for i in range(3):
        for j in range(3):
            f[i, j] = f[i, j] + gradient[3 * p + j, i, b]
    return f


@wp.kernel
def first_piola_kirchhoff(
    gradient: wp.array3d(dtype=wp.float32),
    volume: wp.array(dtype=wp.float32),
    law: wp.array(dtype=coefficients),
    gel: wp.array(dtype=wp.int32),
    fast_share: wp.array(dtype=wp.float32),
    history: wp.array3d(dtype=wp.float32),
    stress: wp.array3d(dtype=wp.float32),
):
    """Write V P of each particle; gradient[3 p + j, i, b] is du_i/dX_j, stress likewise. gel
    numbers what relaxation leaves of each gel's fast stress, and the stress that it remembers,
    which is empty where nothing relaxes."""
    p, b = wp.tid()
    f = deformation_gradient(gradient, p, b)
    g = gel[b]
    result = fast_share[g] * shape_stress(f, law[b]) + volume_stress(f, law[b])
    if history.shape[0] > 0:
        remembered = wp.mat33()
        for i in range(3):
            for j in range(3):
                remembered[i, j] = history[3 * p + j, i, g]
        result += f * remembered
    v = volume[p]
    for i in range(3):
        for j in range(3):
            stress[3 * p + j, i, b] = v * result[i, j]


@wp.kernel
def second_piola_kirchhoff(
    gradient: wp.array3d(dtype=wp.float32),
    law: wp.array(dtype=coefficients),
    stress: wp.array3d(dtype=wp.float32),
):
    """Write the stress of the part of the energy that relaxes; arrays as above."""
    p, b = wp.tid()
    f = deformation_gradient(gradient, p, b)
    result = wp.inverse(f) * shape_stress(f, law[b])
    for i in range(3):
        for j in range(3):
            stress[3 * p + j, i, b] = result[i, j]


@wp.kernel
def surface(
    position: wp.array2d(dtype=wp.vec3),
    field: wp.array(dtype=IndenterField),
    rotation: wp.array(dtype=wp.mat33),
    origin: wp.array(dtype=wp.vec3),
    distance: wp.array2d(dtype=wp.float32),
    normal: wp.array2d(dtype=wp.vec3),
):
    """Write the signed distance of points [b, v] from the indenter of their gel, and its gradient,
    base frame."""
    b, v = wp.tid()
    d, n, _h = indenter_distance(field[b], wp.transpose(rotation[b]) * (position[b, v] - origin[b]))
    distance[b, v] = d
    normal[b, v] = rotation[b] * n


@wp.kernel
def coulomb(
    position: wp.array2d(dtype=wp.vec3),
    area: wp.array2d(dtype=wp.float32),
    gel: wp.array(dtype=wp.int32),
    field: wp.array(dtype=IndenterField),
    rotation: wp.array(dtype=wp.mat33),
    origin: wp.array(dtype=wp.vec3),
    law: wp.array(dtype=ContactLaw),
    start_position: wp.array2d(dtype=wp.vec3),
    start_slip: wp.array2d(dtype=wp.vec3),
    force: wp.array2d(dtype=wp.vec3),
    stiffness: wp.array2d(dtype=wp.mat33),
    distance: wp.array2d(dtype=wp.float32),
    slip: wp.array2d(dtype=wp.vec3),
):
    """Write the force on markers [b, m] by Coulomb's law and minus its derivative, and what the
    friction of the next step starts from, in the indenter's frame; gel numbers what all gels have.
    """
    b, m = wp.tid()
    g = gel[b]
    turn_back = rotation[g]
    y = wp.transpose(turn_back) * (position[b, m] - origin[g])
    d, n, _curvature = indenter_distance(field[g], y)
    c = law[g]
    depth = c.onset - d
    distance[b, m] = d
    elastic_slip = wp.vec3()
    if depth <= 0.0:
        force[b, m] = wp.vec3()
        stiffness[b, m] = wp.mat33()
        slip[b, m] = elastic_slip
        return
    p = pressure(c, depth)
    slope = pressure_slope(c, depth)
    f = p * n
    h = slope * wp.outer(n, n)
    if c.friction > 0.0:
        k = c.tangential_stiffness
        # The gradient of a mesh's distance, interpolated on a grid, is not of unit length.
        unit = wp.normalize(n)
        projector = wp.identity(3, dtype=wp.float32) - wp.outer(unit, unit)
        moved = start_slip[b, m] + y - start_position[b, m]
        s = projector * moved
        length = wp.length(s)
        limit = c.friction * p / k
        if length <= limit:
            f -= k * s
            h += k * projector
            elastic_slip = s
        elif length > 1.0e-12:
            direction = s / length
            f -= (k * limit) * direction
            turning = wp.identity(3, dtype=wp.float32) - wp.outer(direction, direction)
            h += (k * limit / length) * (turning * projector)
            h -= (c.friction * slope) * wp.outer(direction, n)
            elastic_slip = limit * direction
    a = area[b, m]
    slip[b, m] = elastic_slip
    force[b, m] = a * (turn_back * f)
    stiffness[b, m] = a * (turn_back * h * wp.transpose(turn_back))


@wp.kernel
def least_squares(
    hessenberg: wp.array3d(dtype=wp.float32),
    size: wp.array(dtype=wp.float32),
    steps: wp.int32,
    solution: wp.array2d(dtype=wp.float32),
    left: wp.array(dtype=wp.float32),
):
    """Write the x [b, k] of so many steps with the least |size e_1 - H x|, and how much that is, by
    Givens rotations."""
    b = wp.tid()
    r = _hessenberg()
    g = _turned()
    g[0] = size[b]
    for i in range(steps + 1):
        for j in range(steps):
            r[i, j] = hessenberg[b, i, j]
    largest = wp.float32(1.0e-30)
    for j in range(steps):
        length = wp.sqrt(r[j, j] * r[j, j] + r[j + 1, j] * r[j + 1, j])
        cosine = wp.float32(1.0)
        sine = wp.float32(0.0)
        if length > 0.0:
            cosine = r[j, j] / length
            sine = r[j + 1, j] / length
        for i in range(j, steps):
            above = r[j, i]
            below = r[j + 1, i]
            r[j, i] = cosine * above + sine * below
            r[j + 1, i] = cosine * below - sine * above
        g[j + 1] = -sine * g[j]
        g[j] = cosine * g[j]
        if length > largest:
            largest = length
    left[b] = wp.abs(g[steps])
    tiny = 1.0e-7 * largest
    for k in range(steps):
        j = steps - 1 - k
        total = g[j]
        for i in range(j + 1, steps):
            total -= r[j, i] * solution[b, i]
        # It is a length.
        solution[b, j] = total / wp.max(r[j, j], tiny)


@wp.kernel
def solve_symmetric(
    matrix: wp.array3d(dtype=wp.float64),
    right: wp.array2d(dtype=wp.float64),
):
    """Write the solutions [b, i] over the right hand sides, and L D L' over the matrices."""
    b = wp.tid()
    size = right.shape[1]
    for j in range(size):
        for i in range(j, size):
            total = matrix[b, i, j]
            for k in range(j):
                total -= matrix[b, i, k] * matrix[b, k, k] * matrix[b, j, k]
            if i > j:
                total /= matrix[b, j, j]
            matrix[b, i, j] = total
        for k in range(j):
            right[b, j] -= matrix[b, j, k] * right[b, k]
    for reverse in range(size):
        i = size - 1 - reverse
        total = right[b, i] / matrix[b, i, i]
        for k in range(i + 1, size):
            total -= matrix[b, k, i] * right[b, k]
        right[b, i] = total


@wp.kernel
def interpolate(
    node: wp.array3d(dtype=wp.int32),
    weight: wp.array3d(dtype=wp.float32),
    nodal: wp.array2d(dtype=wp.vec3),
    base: wp.array2d(dtype=wp.vec3),
    result: wp.array2d(dtype=wp.vec3),
):
    """Write base + sum of weight times the vectors [b, node] at markers [b, m]."""
    b, m = wp.tid()
    x = base[b, m]
    for a in range(27):
        x += weight[b, m, a] * nodal[b, node[b, m, a]]
    result[b, m] = x


@wp.kernel
def gather_compliance(
    node: wp.array2d(dtype=wp.int32),
    place: wp.array2d(dtype=wp.int32),
    sign: wp.array3d(dtype=wp.float32),
    block: wp.array3d(dtype=wp.float32),
    between: wp.array4d(dtype=wp.float32),
):
    """Write the compliance between nodes [b, i] and [b, j] from its blocks by parity; place holds
    each node's orbit and image, sign is [component, parity, image]."""
    b, i, j = wp.tid()
    if j > i:
        return
    first = node[b, i]
    second = node[b, j]
    for row in range(3):
        for column in range(3):
            total = wp.float32(0.0)
            for parity in range(4):
                total += (
                    sign[row, parity, place[first, 1]]
                    * sign[column, parity, place[second, 1]]
                    * block[parity, 3 * place[first, 0] + row, 3 * place[second, 0] + column]
                )
            between[b, i, j, 3 * row + column] = total
            between[b, j, i, 3 * column + row] = total


@wp.kernel
def gather_refinement(
    node: wp.array2d(dtype=wp.int32),
    number: wp.array2d(dtype=wp.int32),
    indptr: wp.array(dtype=wp.int32),
    index: wp.array(dtype=wp.int32),
    block: wp.array(dtype=wp.mat33),
    between: wp.array4d(dtype=wp.float32),
):
    """Write what refinement adds to the compliance between nodes [b, i] of the finer grid, whose
    numbers the others lack (-1)."""
    b, i = wp.tid()
    n = node[b, i]
    for k in range(indptr[n], indptr[n + 1]):
        j = number[b, index[k]]
        if j >= 0:
            c = block[k]
            for row in range(3):
                for column in range(3):
                    between[b, i, j, 3 * row + column] = c[row, column]


@wp.kernel
def refined_displacement(
    force: wp.array2d(dtype=wp.vec3),
    indptr: wp.array(dtype=wp.int32),
    index: wp.array(dtype=wp.int32),
    block: wp.array(dtype=wp.mat33),
    displacement: wp.array2d(dtype=wp.vec3),
):
    """Add what refinement adds to the nodes [b, n] of the finer grid under forces on them."""
    b, n = wp.tid()
    f = force[b, n]
    if wp.length_sq(f) == 0.0:
        return
    # It is symmetric: the transpose of a row is a column.
    for k in range(indptr[n], indptr[n + 1]):
        wp.atomic_add(displacement, b, index[k], wp.transpose(block[k]) * f)
