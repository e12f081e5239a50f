# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels of a dynamic gel of linear tetrahedra with penalty contact, in double precision.

Lengths are metres. Young's modulus and density are one, so that forces are in units of the modulus
and times in those that a wave needs; see `difftactile`.
"""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, index, operator, misc, arg-type, assignment"

from dotsim_ros.gel.distance_field import distance_functions
from dotsim_ros.io.warp_runtime import wp

SCALAR = wp.float64
VEC3 = wp.types.vector(3, SCALAR)
MAT33 = wp.types.matrix((3, 3), SCALAR)
TRANSFORM = wp.types.transformation(SCALAR)

_functions = distance_functions(SCALAR)
_field_type = _functions.IndenterField
_indenter_distance = _functions.indenter_distance

_one = wp.constant(SCALAR(1.0))
_zero = wp.constant(SCALAR(0.0))
_smallest_speed = wp.constant(SCALAR(1.0e-12))


@wp.struct
class PenaltyContactLaw:
    """stiffness kn (1/m), its rate kd (s/m^2), drag kt (s/m), each by area and in units of the
    modulus; friction: Coulomb's coefficient."""

    stiffness: SCALAR
    rate: SCALAR
    drag: SCALAR
    friction: SCALAR


def contact_law(stiffness: float, rate: float, drag: float, friction: float):
    """Return the constants as kernels take them; see `PenaltyContactLaw`."""
    law = PenaltyContactLaw()
    law.stiffness = stiffness
    law.rate = rate
    law.drag = drag
    law.friction = friction
    return law


@wp.kernel
def element_forces(
    position: wp.array(dtype=VEC3),
    tetrahedra: wp.array(dtype=wp.vec4i),
    inverse_edges: wp.array(dtype=MAT33),
    volume: wp.array(dtype=SCALAR),
    shear: SCALAR,
    dilation: SCALAR,
    force: wp.array2d(dtype=VEC3),
):
    """Forces (T, 4) of the stable neo-Hookean solid on the nodes of each element.

    Smith, de Goes and Kim, "Stable Neo-Hookean Flesh Simulation", 2018, with their
    shear and dilation (section 3.4), so that at small strain it is the linear solid.
    """
    t = wp.tid()
    node = tetrahedra[t]
    last = position[node[3]]
    edges = wp.matrix_from_cols(
        position[node[0]] - last, position[node[1]] - last, position[node[2]] - last
    )
    rest = inverse_edges[t]
    f = edges * rest
    f0 = VEC3(f[0, 0], f[1, 0], f[2, 0])
    f1 = VEC3(f[0, 1], f[1, 1], f[2, 1])
    f2 = VEC3(f[0, 2], f[1, 2], f[2, 2])
    cofactor = wp.matrix_from_cols(wp.cross(f1, f2), wp.cross(f2, f0), wp.cross(f0, f1))
    ratio = wp.dot(f0, wp.cross(f1, f2))
    squares = wp.dot(f0, f0) + wp.dot(f1, f1) + wp.dot(f2, f2)
    alpha = _one + SCALAR(0.75) * shear / dilation
    stress = shear * (_one - _one / (squares + _one)) * f + dilation * (ratio - alpha) * cofactor
    h = -volume[t] * stress * wp.transpose(rest)
    h0 = VEC3(h[0, 0], h[1, 0], h[2, 0])
    h1 = VEC3(h[0, 1], h[1, 1], h[2, 1])
    h2 = VEC3(h[0, 2], h[1, 2], h[2, 2])
    force[t, 0] = h0
    force[t, 1] = h1
    force[t, 2] = h2
    force[t, 3] = -(h0 + h1 + h2)


@wp.kernel
def contact_forces(
    rest: wp.array(dtype=VEC3),
    area: wp.array(dtype=SCALAR),
    node: wp.array(dtype=wp.vec3i),
    weight: wp.array(dtype=VEC3),
    displacement: wp.array(dtype=VEC3),
    velocity: wp.array(dtype=VEC3),
    field: _field_type,
    lower: VEC3,
    upper: VEC3,
    pose: wp.array(dtype=TRANSFORM),
    step: int,
    dt: SCALAR,
    law: PenaltyContactLaw,
    force: wp.array(dtype=VEC3),
):
    """Forces (V,) of the indenter on the skin's vertices."""
    v = wp.tid()
    n = node[v]
    w = weight[v]
    x = rest[v] + w[0] * displacement[n[0]] + w[1] * displacement[n[1]] + w[2] * displacement[n[2]]
    local = wp.transform_point(wp.transform_inverse(pose[step]), x)
    force[v] = VEC3(_zero, _zero, _zero)
    if (
        local[0] > lower[0]
        and local[1] > lower[1]
        and local[2] > lower[2]
        and local[0] < upper[0]
        and local[1] < upper[1]
        and local[2] < upper[2]
    ):
        distance, gradient, _ = _indenter_distance(field, local)
        if distance < _zero:
            normal = wp.transform_vector(pose[step], gradient)
            moved = (wp.transform_point(pose[step + 1], local) - x) / dt
            relative = w[0] * velocity[n[0]] + w[1] * velocity[n[1]] + w[2] * velocity[n[2]] - moved
            approach = wp.max(-wp.dot(relative, normal), _zero)
            pressure = -(law.stiffness + law.rate * approach) * distance
            slip = relative - wp.dot(relative, normal) * normal
            speed = wp.length(slip)
            traction = pressure * normal
            if speed > _smallest_speed:
                drag = wp.min(law.drag * speed, law.friction * pressure)
                traction = traction - (drag / speed) * slip
            force[v] = area[v] * traction


@wp.kernel
def move_nodes(
    rest: wp.array(dtype=VEC3),
    is_fixed: wp.array(dtype=wp.bool),
    mass: SCALAR,
    dt: SCALAR,
    kept: SCALAR,
    element_force: wp.array2d(dtype=VEC3),
    element_first: wp.array(dtype=int),
    element_entry: wp.array(dtype=wp.vec2i),
    skin_force: wp.array(dtype=VEC3),
    skin_first: wp.array(dtype=int),
    skin_entry: wp.array(dtype=int),
    skin_weight: wp.array(dtype=SCALAR),
    velocity: wp.array(dtype=VEC3),
    displacement: wp.array(dtype=VEC3),
    position: wp.array(dtype=VEC3),
):
    """Symplectic Euler: velocity by the forces and the damping, then position by the velocity.

    Each node gathers its forces, in a fixed order, so that runs repeat bit for bit.
    """
    i = wp.tid()
    if is_fixed[i]:
        return
    total = VEC3(_zero, _zero, _zero)
    for k in range(element_first[i], element_first[i + 1]):
        entry = element_entry[k]
        total += element_force[entry[0], entry[1]]
    for k in range(skin_first[i], skin_first[i + 1]):
        total += skin_weight[k] * skin_force[skin_entry[k]]
    v = kept * (velocity[i] + (dt / mass) * total)
    velocity[i] = v
    u = displacement[i] + dt * v
    displacement[i] = u
    position[i] = rest[i] + u
