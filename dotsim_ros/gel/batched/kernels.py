# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels of many gels, in single precision; B is the number of gels."""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: ignore-errors

from dotsim_ros.gel.distance_field import distance_functions
from dotsim_ros.gel.elastic_kernels import elastic_kernels
from dotsim_ros.gel.implicit.contact_kernels import contact_kernels
from dotsim_ros.io.warp_runtime import wp

wp.set_module_options({"enable_backward": False})

BLOCK = 128
"""Threads of a block on a GPU, here lanes, which share the sums of a gel; on a CPU it has one."""

GELS = 8
"""A CPU finds the elastic forces of so many gels at once."""

_distance = distance_functions(wp.float32)
_elastic = elastic_kernels(wp.float32)
_contact = contact_kernels(wp.float32)
IndenterField = _distance.IndenterField
ContactLaw = _contact.ContactLaw
indenter_distance = _distance.indenter_distance
coefficients = _elastic.vec5
shape_stress = _elastic.shape_stress
pressure = _contact.pressure
pressure_slope = _contact.pressure_slope


ROUNDS_ONCE = """
    #if defined(__clang__)
    #pragma clang fp contract(fast)
    #endif
"""
"""Lets a CPU's compiler, as that of a GPU does, round a product and a sum with it only once."""


@wp.func_native("WP_TILE_SYNC();")
def meet():
    """Wait for the other lanes, whose writes are there then."""
    ...


@wp.func
def lanes_sum(part: wp.float32):
    """Return the sum over the lanes."""
    return wp.tile_extract(wp.tile_sum(wp.tile(part)), 0)


@wp.func
def lanes_max(part: wp.float32):
    """Return the largest number of the lanes."""
    return wp.tile_extract(wp.tile_max(wp.tile(part)), 0)


# On a CPU the compiler may only make vectors of a sum whose order it may choose.
@wp.func_native("""
    #if defined(__clang__)
    #pragma clang fp reassociate(on) contract(fast)
    #endif
    const float* x = a.data;
    const float* y = b.data;
    float sum = 0.0f;
    for (int i = lane; i < count; i += WP_TILE_BLOCK_DIM) sum += x[i] * y[i];
    return sum;
""")
def lane_product(
    lane: int, count: int, a: wp.array(dtype=wp.float32), b: wp.array(dtype=wp.float32)
) -> wp.float32:
    """Return a lane's part of the scalar product of the first numbers."""
    ...


@wp.func
def product(lane: int, count: int, a: wp.array(dtype=wp.float32), b: wp.array(dtype=wp.float32)):
    """Return the scalar product of the first numbers."""
    return lanes_sum(lane_product(lane, count, a, b))


@wp.func_native(
    ROUNDS_ONCE
    + """
    const float* __restrict__ x = a.data;
    float* __restrict__ y = b.data;
    for (int i = lane; i < count; i += WP_TILE_BLOCK_DIM) y[i] += factor * x[i];
"""
)
def add(
    lane: int,
    count: int,
    factor: wp.float32,
    a: wp.array(dtype=wp.float32),
    b: wp.array(dtype=wp.float32),
):
    """Add the first numbers of a times a factor to those of b, a lane's part."""
    ...


@wp.func
def deformation_gradient(gradient: wp.array3d(dtype=wp.float32), p: int, b: int):
    """Return F of a particle, of gradient[3 p + j, i, b] = du_i/dX_j."""
    f = wp.identity(3, dtype=wp.float32)
    for i in range(3):
        for j in range(3):
            f[i, j] = f[i, j] + gradient[3 * p + j, i, b]
    return f


# The columns of F are x, y and z, those of its cofactors u, v and w. Adjacent gels are adjacent
# numbers: a CPU's compiler makes vectors of them, which it makes of no call of `pow`.
@wp.func_native(
    ROUNDS_ONCE
    + """
    #if defined(__CUDA_ARCH__)
    constexpr int gels = 1;
    #else
    constexpr int gels = HOST_NUMBER;
    #endif
    constexpr int row = 3 * gels;
    const int count = displacement.shape[2], some = wp::min(gels, count - first);
    const int* __restrict__ nodes = node.data + 27LL * cell;
    const float* __restrict__ weights = weight.data + 24LL * 27 * cell;
    const float c10 = law[0], c01 = law[1], c20 = law[2], c30 = law[3], bulk = law[4];
    float moved[27 * row] = {}, stress[24 * row] = {}, fast[gels] = {};
    const auto read = [&](int number) {
        for (int k = 0; k < 81; ++k) {
            const float* from = displacement.data + (3LL * nodes[k / 3] + k % 3) * count + first;
            for (int b = 0; b < number; ++b) moved[gels * k + b] = from[b];
        }
    };
    // A number that the compiler knows makes them vectors.
    if (some == gels) read(gels); else read(some);
    for (int b = 0; b < some; ++b) fast[b] = fast_share.data[first + b];
    for (int q = 0; q < 8; ++q) {
        const float v = volume.data[8 * cell + q];
        if (v == 0.0f) continue;
        const float* __restrict__ along = weights + 81 * q;
        float* __restrict__ result = stress + 3 * row * q;
        float x[row] = {}, y[row] = {}, z[row] = {};
        for (int a = 0; a < 27; ++a) {
            const float* __restrict__ here = moved + row * a;
            for (int k = 0; k < row; ++k) x[k] += along[a] * here[k];
            for (int k = 0; k < row; ++k) y[k] += along[27 + a] * here[k];
            for (int k = 0; k < row; ++k) z[k] += along[54 + a] * here[k];
        }
        float g[3 * row];
        for (int k = 0; k < row; ++k) g[k] = x[k];
        for (int k = 0; k < row; ++k) g[row + k] = y[k];
        for (int k = 0; k < row; ++k) g[2 * row + k] = z[k];
        for (int b = 0; b < gels; ++b) {
            const float x0 = 1.0f + g[b], x1 = g[gels + b], x2 = g[2 * gels + b];
            const float y0 = g[3 * gels + b], y1 = 1.0f + g[4 * gels + b], y2 = g[5 * gels + b];
            const float z0 = g[6 * gels + b], z1 = g[7 * gels + b], z2 = 1.0f + g[8 * gels + b];
            const float u0 = y1 * z2 - y2 * z1, u1 = y2 * z0 - y0 * z2, u2 = y0 * z1 - y1 * z0;
            const float v0 = z1 * x2 - z2 * x1, v1 = z2 * x0 - z0 * x2, v2 = z0 * x1 - z1 * x0;
            const float w0 = x1 * y2 - x2 * y1, w1 = x2 * y0 - x0 * y2, w2 = x0 * y1 - x1 * y0;
            const float j = x0 * u0 + x1 * u1 + x2 * u2;
            const float xx = x0 * x0 + x1 * x1 + x2 * x2, xy = x0 * y0 + x1 * y1 + x2 * y2;
            const float yy = y0 * y0 + y1 * y1 + y2 * y2, yz = y0 * z0 + y1 * z1 + y2 * z2;
            const float zz = z0 * z0 + z1 * z1 + z2 * z2, zx = z0 * x0 + z1 * x1 + z2 * x2;
            const float i1 = xx + yy + zz;
            const float i2 = (xx * yy - xy * xy) + (yy * zz - yz * yz) + (zz * xx - zx * zx);
            // The inverse cube root of J by Newton's method, from a third of its exponent.
            union { float number; int bits; } root;
            root.number = j;
            root.bits = 0x54a2fa8e - root.bits / 3;
            float r = root.number;
            for (int k = 0; k < 3; ++k) r *= (4.0f - j * r * r * r) * (1.0f / 3.0f);
            const float a = j > 0.0f ? r * r : NAN;
            const float e1 = a * i1 - 3.0f;
            const float s1 = a * (c10 + e1 * (2.0f * c20 + 3.0f * c30 * e1)), s2 = a * a * c01;
            const float f = v * fast[b];
            const float alpha = f * 2.0f * (s1 + s2 * i1), gamma = f * 2.0f * s2;
            const float beta = v * bulk * (j - 1.0f)
                - f * (2.0f / 3.0f) * (s1 * i1 + 2.0f * s2 * i2) / j;
            const float ax = alpha - gamma * xx, ay = alpha - gamma * yy, az = alpha - gamma * zz;
            const float bxy = gamma * xy, byz = gamma * yz, bzx = gamma * zx;
            result[b] = ax * x0 - bxy * y0 - bzx * z0 + beta * u0;
            result[gels + b] = ax * x1 - bxy * y1 - bzx * z1 + beta * u1;
            result[2 * gels + b] = ax * x2 - bxy * y2 - bzx * z2 + beta * u2;
            result[3 * gels + b] = ay * y0 - bxy * x0 - byz * z0 + beta * v0;
            result[4 * gels + b] = ay * y1 - bxy * x1 - byz * z1 + beta * v1;
            result[5 * gels + b] = ay * y2 - bxy * x2 - byz * z2 + beta * v2;
            result[6 * gels + b] = az * z0 - byz * y0 - bzx * x0 + beta * w0;
            result[7 * gels + b] = az * z1 - byz * y1 - bzx * x1 + beta * w1;
            result[8 * gels + b] = az * z2 - byz * y2 - bzx * x2 + beta * w2;
        }
        // F times what is remembered, of the second Piola-Kirchhoff stress.
        for (int j = 0; history.shape[0] && j < 3; ++j)
            for (int k = 0; k < 3; ++k) {
                const float* remembered = history.data
                    + ((8LL * cell + q) * 9 + 3 * j + k) * history.shape[2];
                for (int i = 0; i < 3; ++i)
                    for (int b = 0; b < some; ++b)
                        result[row * j + gels * i + b] += v * remembered[gel.data[first + b]]
                            * (g[row * k + gels * i + b] + (i == k ? 1.0f : 0.0f));
            }
    }
    for (int a = 0; a < 27; a += 3) {
        float x[row] = {}, y[row] = {}, z[row] = {};
        for (int r = 0; r < 24; ++r) {
            const float* __restrict__ here = stress + row * r;
            const float* __restrict__ along = weights + 27 * r + a;
            for (int k = 0; k < row; ++k) x[k] += along[0] * here[k];
            for (int k = 0; k < row; ++k) y[k] += along[1] * here[k];
            for (int k = 0; k < row; ++k) z[k] += along[2] * here[k];
        }
        for (int k = 0; k < row; ++k) moved[row * a + k] = x[k];
        for (int k = 0; k < row; ++k) moved[row * a + row + k] = y[k];
        for (int k = 0; k < row; ++k) moved[row * a + 2 * row + k] = z[k];
    }
    const auto write = [&](int number) {
        for (int k = 0; k < 81; ++k) {
            float* to = force.data + (3LL * nodes[k / 3] + k % 3) * count + first;
            for (int b = 0; b < number; ++b) wp::atomic_add(to + b, moved[gels * k + b]);
        }
    };
    if (some == gels) write(gels); else write(some);
""".replace("HOST_NUMBER", str(GELS))
)
def add_cell_force(
    cell: int,
    first: int,
    displacement: wp.array3d(dtype=wp.float32),
    node: wp.array2d(dtype=wp.int32),
    weight: wp.array3d(dtype=wp.float32),
    volume: wp.array(dtype=wp.float32),
    law: coefficients,
    gel: wp.array(dtype=wp.int32),
    fast_share: wp.array(dtype=wp.float32),
    history: wp.array3d(dtype=wp.float32),
    force: wp.array3d(dtype=wp.float32),
):
    """Add the forces of a cell of some gels from the first on."""
    ...


@wp.kernel
def add_elastic_forces(
    displacement: wp.array3d(dtype=wp.float32),
    node: wp.array2d(dtype=wp.int32),
    weight: wp.array3d(dtype=wp.float32),
    volume: wp.array(dtype=wp.float32),
    law: coefficients,
    gel: wp.array(dtype=wp.int32),
    fast_share: wp.array(dtype=wp.float32),
    history: wp.array3d(dtype=wp.float32),
    width: int,
    force: wp.array3d(dtype=wp.float32),
):
    """Add the forces [n, i, b] on nodes of each cell's eight particles for `width` gels at a time,
    of displacements likewise. node [c, a] are a cell's nodes, weight [c, 3 q + j, a] their weights'
    derivatives by X_j at particle q, volume [8 c + q]. fast_share [b] is what relaxation leaves of
    each gel's fast stress, history [3 p + j, k, g] the stress that it remembers, by the numbers
    gel[b] of all gels, empty where nothing relaxes. Forces are NaN where a particle is turned
    inside out."""
    cell, part = wp.tid()
    add_cell_force(
        cell,
        part * width,
        displacement,
        node,
        weight,
        volume,
        law,
        gel,
        fast_share,
        history,
        force,
    )


@wp.kernel
def second_piola_kirchhoff(
    gradient: wp.array3d(dtype=wp.float32),
    law: coefficients,
    stress: wp.array3d(dtype=wp.float32),
):
    """Write the stress of the part of the energy that relaxes; arrays as above."""
    p, b = wp.tid()
    f = deformation_gradient(gradient, p, b)
    result = wp.inverse(f) * shape_stress(f, law)
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
def skin_distance(
    position: wp.array2d(dtype=wp.vec3),
    is_wanted: wp.array(dtype=wp.bool),
    is_left_out: wp.array(dtype=wp.bool),
    field: wp.array(dtype=IndenterField),
    rotation: wp.array(dtype=wp.mat33),
    origin: wp.array(dtype=wp.vec3),
    distance: wp.array2d(dtype=wp.float32),
):
    """Write the signed distance of markers [b, v] from the indenter of their gel; infinite for
    those that are left out, and of gels that are not wanted. Without normals it takes half the
    time."""
    b, v = wp.tid()
    d = wp.float32(wp.inf)
    if is_wanted[b] and not is_left_out[v]:
        y = wp.transpose(rotation[b]) * (position[b, v] - origin[b])
        d, _n, _h = indenter_distance(field[b], y)
    distance[b, v] = d


@wp.kernel
def remember_skin(
    found: wp.array2d(dtype=wp.vec3),
    is_moving: wp.array(dtype=wp.bool),
    keeps: wp.array(dtype=wp.bool),
    rotation: wp.array(dtype=wp.mat33),
    origin: wp.array(dtype=wp.vec3),
    skin: wp.array2d(dtype=wp.vec3),
    skin_change: wp.array2d(dtype=wp.vec3),
    local: wp.array2d(dtype=wp.vec3),
    local_change: wp.array2d(dtype=wp.vec3),
):
    """Replace the skin [b, v] of gels that move, in the base frame and in that of the indenter, and
    its changes, which only gels that stay in contact have."""
    b, v = wp.tid()
    if not is_moving[b]:
        return
    x = found[b, v]
    y = wp.transpose(rotation[b]) * (x - origin[b])
    moved = wp.vec3()
    slid = wp.vec3()
    if keeps[b]:
        moved = x - skin[b, v]
        slid = y - local[b, v]
    skin[b, v] = x
    skin_change[b, v] = moved
    local[b, v] = y
    local_change[b, v] = slid


@wp.func
def coulomb(
    position: wp.vec3,
    area: wp.float32,
    field: IndenterField,
    rotation: wp.mat33,
    origin: wp.vec3,
    law: ContactLaw,
    start_position: wp.vec3,
    start_slip: wp.vec3,
):
    """Return the force on a marker by Coulomb's law, minus its derivative, the distance, and the
    slip that the friction of the next step starts from, in the indenter's frame."""
    y = wp.transpose(rotation) * (position - origin)
    d, n, _curvature = indenter_distance(field, y)
    depth = law.onset - d
    elastic_slip = wp.vec3()
    f = wp.vec3()
    h = wp.mat33()
    if depth > 0.0:
        p = pressure(law, depth)
        slope = pressure_slope(law, depth)
        f = p * n
        h = slope * wp.outer(n, n)
        if law.friction > 0.0:
            k = law.tangential_stiffness
            # The gradient of a mesh's distance, interpolated on a grid, is not of unit length.
            unit = wp.normalize(n)
            projector = wp.identity(3, dtype=wp.float32) - wp.outer(unit, unit)
            moved = start_slip + y - start_position
            s = projector * moved
            length = wp.length(s)
            limit = law.friction * p / k
            if length <= limit:
                f -= k * s
                h += k * projector
                elastic_slip = s
            elif length > 1.0e-12:
                direction = s / length
                f -= (k * limit) * direction
                turning = wp.identity(3, dtype=wp.float32) - wp.outer(direction, direction)
                h += (k * limit / length) * (turning * projector)
                h -= (law.friction * slope) * wp.outer(direction, n)
                elastic_slip = limit * direction
        f = area * (rotation * f)
        h = area * (rotation * h * wp.transpose(rotation))
    return f, h, d, elastic_slip


@wp.func
def solve_symmetric(
    matrix: wp.array2d(dtype=wp.float64),
    right: wp.array(dtype=wp.float64),
):
    """Write the solution over the right hand side, and L D L' over the matrix."""
    size = right.shape[0]
    for j in range(size):
        for i in range(j, size):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[k, k] * matrix[j, k]
            if i > j:
                total /= matrix[j, j]
            matrix[i, j] = total
        for k in range(j):
            right[j] -= matrix[j, k] * right[k]
    for reverse in range(size):
        i = size - 1 - reverse
        total = right[i] / matrix[i, i]
        for k in range(i + 1, size):
            total -= matrix[k, i] * right[k]
        right[i] = total


@wp.struct
class Memories:
    """What `mix` remembers of each gel g, of its last steps m: changes of its points and of its
    steps, [g, m, i]; products of the latter with each other, [g, m, m], and the share of their mean
    that keeps these solvable; the stiffness, [g, m], the quotient of their lengths; how many there
    were, [g]; the last point and step, [g, i]. A change of the point that is shorter than
    least_change is mostly rounding."""

    points: wp.array3d(dtype=wp.float32)
    steps: wp.array3d(dtype=wp.float32)
    products: wp.array3d(dtype=wp.float32)
    stiffness: wp.array2d(dtype=wp.float32)
    count: wp.array(dtype=wp.int32)
    last_point: wp.array2d(dtype=wp.float32)
    last_step: wp.array2d(dtype=wp.float32)
    least_change: wp.float32
    regularisation: wp.float32


@wp.func
def remember(
    g: int,
    lane: int,
    point: wp.array(dtype=wp.float32),
    step: wp.array(dtype=wp.float32),
    known: Memories,
):
    """Remember how a gel's step changed, unless the gel hardly moves or has diverged."""
    size = point.shape[0]
    lanes = wp.block_dim()
    longest = wp.float32(0.0)
    for i in range(lane, size, lanes):
        moved = point[i] - known.last_point[g, i]
        if wp.isfinite(moved + step[i] - known.last_step[g, i]):
            longest = wp.max(longest, wp.abs(moved))
        else:
            longest = wp.inf
    longest = lanes_max(longest)
    if longest <= known.least_change or longest == wp.inf:
        return
    memory = known.steps.shape[1]
    slot = known.count[g] % memory
    points = known.points[g, slot]
    steps = known.steps[g, slot]
    for i in range(lane, size, lanes):
        points[i] = point[i] - known.last_point[g, i]
        steps[i] = step[i] - known.last_step[g, i]
    meet()
    for m in range(memory):
        found = product(lane, size, known.steps[g, m], steps)
        if lane == 0:
            known.products[g, slot, m] = found
            known.products[g, m, slot] = found
    stiffness = wp.sqrt(product(lane, size, steps, steps) / product(lane, size, points, points))
    if lane == 0:
        known.stiffness[g, slot] = stiffness
        known.count[g] = known.count[g] + 1


@wp.kernel
def mix(
    gel: wp.array(dtype=wp.int32),
    point: wp.array2d(dtype=wp.float32),
    step: wp.array2d(dtype=wp.float32),
    is_first: int,
    known: Memories,
    matrix: wp.array3d(dtype=wp.float64),
    share: wp.array2d(dtype=wp.float64),
    mixed: wp.array2d(dtype=wp.float32),
):
    """Write the step that gel[b] takes from point[b], where the iteration takes another one; matrix
    and share are memory."""
    b, lane = wp.tid()
    lanes = wp.block_dim()
    g = gel[b]
    memory = known.steps.shape[1]
    size = point.shape[1]
    if is_first == 0:
        remember(g, lane, point[b], step[b], known)
    for m in range(memory):
        along = product(lane, size, known.steps[g, m], step[b])
        if lane == 0:
            share[b, m] = wp.float64(along)
    if lane == 0:
        mean = wp.float32(0.0)
        for m in range(memory):
            mean += known.products[g, m, m] / wp.float32(memory)
        # What is not known yet gets no share.
        least = known.regularisation * wp.max(mean, known.least_change * known.least_change)
        for m in range(memory):
            for k in range(memory):
                matrix[b, m, k] = wp.float64(known.products[g, m, k])
            matrix[b, m, m] = matrix[b, m, m] + wp.float64(least)
        solve_symmetric(matrix[b], share[b])
    meet()
    stiffest = wp.float32(1.0)
    for m in range(memory):
        stiffest = wp.max(stiffest, known.stiffness[g, m])
    damping = 1.0 / wp.sqrt(stiffest)
    for i in range(lane, size, lanes):
        mixed[b, i] = damping * step[b, i]
        known.last_point[g, i] = point[b, i]
        known.last_step[g, i] = step[b, i]
    for m in range(memory):
        part = wp.float32(share[b, m])
        add(lane, size, -damping * part, known.steps[g, m], mixed[b])
        add(lane, size, -part, known.points[g, m], mixed[b])


@wp.kernel
def add_interpolated(
    marker: wp.array2d(dtype=wp.int32),
    node: wp.array2d(dtype=wp.int32),
    weight: wp.array2d(dtype=wp.float32),
    nodal: wp.array2d(dtype=wp.vec3),
    result: wp.array2d(dtype=wp.vec3),
):
    """Add to [b, m] what vectors [b, n] of nodes are at marker [b, m], by the nodes and weights
    [marker, a] that it moves with."""
    b, m = wp.tid()
    v = marker[b, m]
    x = result[b, m]
    for a in range(27):
        x += weight[v, a] * nodal[b, node[v, a]]
    result[b, m] = x


@wp.kernel
def spread(
    marker: wp.array2d(dtype=wp.int32),
    node: wp.array2d(dtype=wp.int32),
    weight: wp.array2d(dtype=wp.float32),
    force: wp.array2d(dtype=wp.vec3),
    nodal: wp.array2d(dtype=wp.vec3),
):
    """Add forces [b, m] on markers to those [b, n] on nodes; arrays as above."""
    b, m = wp.tid()
    f = force[b, m]
    if wp.length_sq(f) == 0.0:
        return
    v = marker[b, m]
    for a in range(27):
        wp.atomic_add(nodal, b, node[v, a], weight[v, a] * f)


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
