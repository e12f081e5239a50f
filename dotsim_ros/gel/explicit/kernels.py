# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels of the explicit MLS-MPM: equations 1 to 3 of the paper, and the skin on it.

Particle to grid and back: Hu et al., "A moving least squares material point method with
displacement discontinuity and two-way rigid body coupling" (2018), with quadratic B-splines and the
affine velocity field of Jiang et al. (2015). Arrays carry a leading environment axis; grid nodes
are flattened, x slowest. The kernels are made for one scalar type at a time.
"""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, index, operator, misc, call-overload"

from functools import cache
from types import SimpleNamespace
from typing import Any

from dotsim_ros.gel.distance_field import distance_functions
from dotsim_ros.io.warp_runtime import wp

# Columns of the parameter array.
LOG_YOUNGS_MODULUS, POISSON_RATIO, SOFTNESS, FRICTION = 0, 1, 2, 3
PARAMETER_COUNT = 4

# Below this volume ratio a particle counts as diverged; the stress is evaluated no lower.
SMALLEST_VOLUME_RATIO = 0.05


@cache
def explicit_kernels(scalar: Any) -> SimpleNamespace:
    """Return the kernels for `wp.float32` or `wp.float64`."""
    vec2 = wp.types.vector(2, scalar)
    vec3 = wp.types.vector(3, scalar)
    mat33 = wp.types.matrix((3, 3), scalar)
    transform = wp.types.transformation(scalar)
    functions = distance_functions(scalar)
    field_type = functions.IndenterField
    indenter_distance = functions.indenter_distance
    smallest_ratio = wp.constant(scalar(SMALLEST_VOLUME_RATIO))

    @wp.struct
    class Grid:
        """A box of nodes: count along each axis, position of the first, spacing (m)."""

        count: wp.vec3i
        origin: vec3
        spacing: scalar

    @wp.struct
    class Particles:
        """Particles and skin between two substeps."""

        position: wp.array2d(dtype=vec3)
        velocity: wp.array2d(dtype=vec3)
        affine: wp.array2d(dtype=mat33)
        deformation: wp.array2d(dtype=mat33)
        skin: wp.array2d(dtype=vec3)

    @wp.struct
    class Nodes:
        """Nodes during one substep; free: the velocity without contact; area, wanted: of the skin,
        as `touch` writes them."""

        mass: wp.array2d(dtype=scalar)
        momentum: wp.array2d(dtype=vec3)
        area: wp.array2d(dtype=scalar)
        wanted: wp.array2d(dtype=vec3)
        free: wp.array2d(dtype=vec3)
        velocity: wp.array2d(dtype=vec3)

    @wp.struct
    class Motion:
        """The indenter during a frame, by substep, and force and torque on it."""

        pose: wp.array2d(dtype=transform)
        linear: wp.array2d(dtype=vec3)
        angular: wp.array2d(dtype=vec3)
        force: wp.array2d(dtype=vec3)
        torque: wp.array2d(dtype=vec3)

    @wp.func
    def cell_position(grid: Grid, x: vec3):
        """Position in cells, kept a cell away from the grid's sides: a body that has blown up
        must not read or write outside of the arrays."""
        p = (x - grid.origin) / grid.spacing
        return vec3(
            wp.clamp(p[0], scalar(1.0), scalar(grid.count[0] - 2)),
            wp.clamp(p[1], scalar(1.0), scalar(grid.count[1] - 2)),
            wp.clamp(p[2], scalar(1.0), scalar(grid.count[2] - 2)),
        )

    @wp.func
    def first_node(grid: Grid, p: vec3):
        # Clamped again, since the conversion of a number that is not finite is undefined.
        return wp.vec3i(
            wp.clamp(int(p[0] - scalar(0.5)), 0, grid.count[0] - 3),
            wp.clamp(int(p[1] - scalar(0.5)), 0, grid.count[1] - 3),
            wp.clamp(int(p[2] - scalar(0.5)), 0, grid.count[2] - 3),
        )

    @wp.func
    def weights(p: vec3, first: wp.vec3i, axis: int):
        f = p[axis] - scalar(first[axis])
        a = scalar(1.5) - f
        b = f - scalar(1.0)
        c = f - scalar(0.5)
        return vec3(scalar(0.5) * a * a, scalar(0.75) - b * b, scalar(0.5) * c * c)

    @wp.func
    def node_number(grid: Grid, first: wp.vec3i, i: int, j: int, k: int):
        row = (first[0] + i) * grid.count[1] + first[1] + j
        return row * grid.count[2] + first[2] + k

    @wp.kernel
    def elastic_moduli(parameters: wp.array2d(dtype=scalar), moduli: wp.array(dtype=vec2)):
        """(log E, nu) to shear and bulk modulus."""
        e = wp.tid()
        youngs = wp.exp(parameters[e, LOG_YOUNGS_MODULUS])
        nu = parameters[e, POISSON_RATIO]
        moduli[e] = vec2(
            youngs / (scalar(2.0) * (scalar(1.0) + nu)),
            youngs / (scalar(3.0) * (scalar(1.0) - scalar(2.0) * nu)),
        )

    @wp.func
    def kirchhoff_stress(f: mat33, moduli: vec2):
        """psi = mu/2 (I1b - 3) + K/2 (J - 1)^2."""
        determinant = wp.determinant(f)
        j = wp.max(determinant, smallest_ratio)
        b = f * wp.transpose(f)
        shape = b - (wp.trace(b) / scalar(3.0)) * wp.identity(3, dtype=scalar)
        shear = moduli[0] * wp.pow(j, scalar(-2.0 / 3.0))
        pressure = moduli[1] * (determinant - scalar(1.0)) * j
        return shear * shape + pressure * wp.identity(3, dtype=scalar)

    @wp.kernel
    def particle_to_grid(
        grid: Grid,
        particle_mass: scalar,
        particle_volume: scalar,
        time_step: scalar,
        moduli: wp.array(dtype=vec2),
        particles: Particles,
        nodes: Nodes,
    ):
        e, n = wp.tid()
        p = cell_position(grid, particles.position[e, n])
        first = first_node(grid, p)
        wx = weights(p, first, 0)
        wy = weights(p, first, 1)
        wz = weights(p, first, 2)
        stress = kirchhoff_stress(particles.deformation[e, n], moduli[e])
        scale = scalar(4.0) * time_step * particle_volume / (grid.spacing * grid.spacing)
        flux = particle_mass * particles.affine[e, n] - scale * stress
        own = particle_mass * particles.velocity[e, n]
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    w = wx[i] * wy[j] * wz[k]
                    offset = grid.spacing * (
                        vec3(scalar(first[0] + i), scalar(first[1] + j), scalar(first[2] + k)) - p
                    )
                    number = node_number(grid, first, i, j, k)
                    wp.atomic_add(nodes.mass, e, number, w * particle_mass)
                    wp.atomic_add(nodes.momentum, e, number, w * (own + flux * offset))

    @wp.kernel
    def free_velocity(
        time_step: scalar,
        acceleration: vec3,
        decay: scalar,
        fixed: wp.array(dtype=wp.int32),
        nodes: Nodes,
    ):
        """Momentum to velocity, held nodes at rest."""
        e, n = wp.tid()
        m = nodes.mass[e, n]
        v = vec3(scalar(0.0), scalar(0.0), scalar(0.0))
        if m > scalar(0.0) and fixed[n] == 0:
            v = decay * nodes.momentum[e, n] / m + time_step * acceleration
        nodes.free[e, n] = v

    @wp.func
    def coulomb_change(relative: vec3, normal: vec3, lift: scalar, friction: scalar):
        """Change of a relative velocity that makes its normal part at least `lift`."""
        change = vec3(scalar(0.0), scalar(0.0), scalar(0.0))
        push = lift - wp.dot(relative, normal)
        if push > scalar(0.0):
            slip = relative - wp.dot(relative, normal) * normal
            # The tiny length keeps the derivative finite where nothing slips.
            speed = wp.sqrt(wp.dot(slip, slip) + scalar(1.0e-16))
            change = push * normal - wp.min(friction * push / speed, scalar(1.0)) * slip
        return change

    @wp.kernel
    def touch(
        grid: Grid,
        field: field_type,
        motion: Motion,
        substep: int,
        time_step: scalar,
        recovery: scalar,
        parameters: wp.array2d(dtype=scalar),
        skin_area: wp.array(dtype=scalar),
        particles: Particles,
        nodes: Nodes,
    ):
        """Skin near the indenter to grid: its area, and the part in contact times the change of
        velocity that the contact law asks for."""
        e, n = wp.tid()
        x = particles.skin[e, n]
        placed = motion.pose[substep, e]
        local = wp.transform_point(wp.transform_inverse(placed), x)
        distance, gradient, _hessian = indenter_distance(field, local)
        # Skin farther away shares no node with skin in contact (supports are 3 cells wide).
        if distance < scalar(7.0) * grid.spacing:
            p = cell_position(grid, x)
            first = first_node(grid, p)
            wx = weights(p, first, 0)
            wy = weights(p, first, 1)
            wz = weights(p, first, 2)
            depth = distance * parameters[e, SOFTNESS] / grid.spacing
            contact = scalar(0.0)
            change = vec3(scalar(0.0), scalar(0.0), scalar(0.0))
            if depth < scalar(1.0):
                rest = scalar(1.0) - wp.max(depth, scalar(0.0))
                contact = rest * rest * (scalar(3.0) - scalar(2.0) * rest) * skin_area[n]
                v = vec3(scalar(0.0), scalar(0.0), scalar(0.0))
                for i in range(3):
                    for j in range(3):
                        for k in range(3):
                            v += (wx[i] * wy[j] * wz[k]) * nodes.free[
                                e, node_number(grid, first, i, j, k)
                            ]
                arm = x - wp.transform_get_translation(placed)
                relative = v - motion.linear[substep, e] - wp.cross(motion.angular[substep, e], arm)
                lift = recovery * wp.max(-distance, scalar(0.0)) / time_step
                change = coulomb_change(
                    relative, wp.transform_vector(placed, gradient), lift, parameters[e, FRICTION]
                )
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        w = wx[i] * wy[j] * wz[k]
                        number = node_number(grid, first, i, j, k)
                        wp.atomic_add(nodes.area, e, number, w * skin_area[n])
                        if contact > scalar(0.0):
                            wp.atomic_add(nodes.wanted, e, number, (w * contact) * change)

    @wp.kernel
    def correct_velocity(
        grid: Grid,
        substep: int,
        time_step: scalar,
        fixed: wp.array(dtype=wp.int32),
        nodes: Nodes,
        motion: Motion,
    ):
        """Contact model; force and torque are those on the indenter, the torque about the base
        frame's origin."""
        e, n = wp.tid()
        v = nodes.free[e, n]
        if nodes.area[e, n] > scalar(0.0) and nodes.mass[e, n] > scalar(0.0) and fixed[n] == 0:
            # Skin that does not touch counts in the mean: leaving it out lets contact pump energy.
            change = nodes.wanted[e, n] / nodes.area[e, n]
            v += change
            k = n % grid.count[2]
            row = n / grid.count[2]
            x = grid.origin + grid.spacing * vec3(
                scalar(row / grid.count[1]), scalar(row % grid.count[1]), scalar(k)
            )
            reaction = (-nodes.mass[e, n] / time_step) * change
            wp.atomic_add(motion.force, substep, e, reaction)
            wp.atomic_add(motion.torque, substep, e, wp.cross(x, reaction))
        nodes.velocity[e, n] = v

    @wp.kernel
    def grid_to_particle(
        grid: Grid,
        time_step: scalar,
        node_velocity: wp.array2d(dtype=vec3),
        particles: Particles,
        following: Particles,
        smallest_volume_ratio: wp.array(dtype=scalar),
    ):
        e, n = wp.tid()
        p = cell_position(grid, particles.position[e, n])
        first = first_node(grid, p)
        wx = weights(p, first, 0)
        wy = weights(p, first, 1)
        wz = weights(p, first, 2)
        v = vec3(scalar(0.0), scalar(0.0), scalar(0.0))
        b = mat33(scalar(0.0))
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    offset = (
                        vec3(scalar(first[0] + i), scalar(first[1] + j), scalar(first[2] + k)) - p
                    )
                    share = (wx[i] * wy[j] * wz[k]) * node_velocity[
                        e, node_number(grid, first, i, j, k)
                    ]
                    v += share
                    b += wp.outer(share, offset)
        gradient = (scalar(4.0) / grid.spacing) * b
        f = (wp.identity(3, dtype=scalar) + time_step * gradient) * particles.deformation[e, n]
        following.position[e, n] = particles.position[e, n] + time_step * v
        following.velocity[e, n] = v
        following.affine[e, n] = gradient
        following.deformation[e, n] = f
        ratio = wp.determinant(f)
        # Written so that a number that is not finite counts as collapsed.
        if not (ratio > scalar(2.0) * smallest_ratio):
            wp.atomic_min(
                smallest_volume_ratio, e, wp.where(ratio > smallest_ratio, ratio, scalar(0.0))
            )

    @wp.kernel
    def carry_skin(
        grid: Grid,
        time_step: scalar,
        held: wp.array(dtype=wp.int32),
        mass: wp.array2d(dtype=scalar),
        node_velocity: wp.array2d(dtype=vec3),
        particles: Particles,
        following: Particles,
    ):
        e, n = wp.tid()
        x = particles.skin[e, n]
        moved = x
        if held[n] == 0:
            p = cell_position(grid, x)
            first = first_node(grid, p)
            wx = weights(p, first, 0)
            wy = weights(p, first, 1)
            wz = weights(p, first, 2)
            v = vec3(scalar(0.0), scalar(0.0), scalar(0.0))
            total = scalar(0.0)
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        number = node_number(grid, first, i, j, k)
                        if mass[e, number] > scalar(0.0):
                            w = wx[i] * wy[j] * wz[k]
                            v += w * node_velocity[e, number]
                            total += w
            if total > scalar(0.0):
                moved = x + (time_step / total) * v
        following.skin[e, n] = moved

    @wp.kernel
    def penetration(
        field: field_type,
        pose: wp.array2d(dtype=transform),
        last: int,
        skin: wp.array2d(dtype=vec3),
        deepest: wp.array(dtype=scalar),
    ):
        e, n = wp.tid()
        local = wp.transform_point(wp.transform_inverse(pose[last, e]), skin[e, n])
        distance, _gradient, _hessian = indenter_distance(field, local)
        wp.atomic_max(deepest, e, -distance)

    return SimpleNamespace(
        Grid=Grid,
        Particles=Particles,
        Nodes=Nodes,
        Motion=Motion,
        elastic_moduli=elastic_moduli,
        particle_to_grid=particle_to_grid,
        free_velocity=free_velocity,
        touch=touch,
        correct_velocity=correct_velocity,
        grid_to_particle=grid_to_particle,
        carry_skin=carry_skin,
        penetration=penetration,
    )
