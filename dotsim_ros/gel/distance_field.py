"""Signed distance of an indenter inside Warp kernels: value, gradient and Hessian at a point.

Primitives are exact, meshes a quadratic B-spline on a grid. All functions can be differentiated by
Warp's tape: the value with respect to the point and the primitive's parameters.
"""

# Warp reads kernels by its own rules, which are none of a type checker's: float(...) declares a
# variable that a loop may change.
# mypy: disable-error-code="no-untyped-def, valid-type, arg-type, assignment, call-overload, index, operator"
# ruff: noqa: UP018

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from dotsim_ros.geometry.indenter import Indenter, IndenterKind

SPHERE = wp.constant(int(IndenterKind.SPHERE))
BOX = wp.constant(int(IndenterKind.BOX))
CYLINDER = wp.constant(int(IndenterKind.CYLINDER))
CONE = wp.constant(int(IndenterKind.CONE))
CAPSULE = wp.constant(int(IndenterKind.CAPSULE))
TORUS = wp.constant(int(IndenterKind.TORUS))
MESH = wp.constant(int(IndenterKind.MESH))

# Below this distance to an axis or to a centre of curvature a direction is arbitrary.
SMALLEST_LENGTH_M = wp.constant(1.0e-9)


@wp.struct
class IndenterField:
    """What kernels need to know of an indenter; made by `indenter_field`.

    kind: IndenterKind; parameters (n,): those of the Indenter; shape_from_indenter: inverse of the
    mount; coefficients (nx, ny, nz), origin, spacing: the distance grid of a mesh, else (1, 1, 1).
    """

    kind: int
    parameters: wp.array(dtype=float)
    shape_from_indenter: wp.transform
    coefficients: wp.array3d(dtype=float)
    origin: wp.vec3
    spacing: float


def indenter_field(
    indenter: Indenter, *, device: Any = None, spacing_m: float | None = None
) -> IndenterField:
    """Return the indenter as kernel input on a device; `spacing_m` is that of a mesh's grid."""
    field = IndenterField()
    field.kind = int(indenter.kind)
    parameters = np.array(indenter.parameters or (0.0,), dtype=np.float32)
    field.parameters = wp.array(parameters, dtype=float, device=device, requires_grad=True)
    mount = wp.transform(
        wp.vec3(*indenter.mount.position_m), wp.quat(*indenter.mount.quaternion_xyzw)
    )
    field.shape_from_indenter = wp.transform_inverse(mount)
    field.origin = wp.vec3(0.0, 0.0, 0.0)
    field.spacing = 1.0
    coefficients = np.zeros((1, 1, 1), dtype=np.float32)
    if indenter.kind == IndenterKind.MESH:
        grid = indenter.distance_grid(spacing_m)
        field.origin = wp.vec3(*grid.origin_m)
        field.spacing = grid.spacing_m
        coefficients = grid.coefficients
    field.coefficients = wp.array(coefficients, dtype=float, ndim=3, device=device)
    return field


@wp.func
def sample_distance_grid(
    coefficients: wp.array3d(dtype=float), origin: wp.vec3, spacing: float, x: wp.vec3
):
    """Return distance, gradient (vec3) and Hessian (mat33) of a quadratic B-spline at x.

    Outside of the grid: the value on its boundary plus the distance to it.
    """
    position = (x - origin) / spacing
    nx = coefficients.shape[0]
    ny = coefficients.shape[1]
    nz = coefficients.shape[2]
    inside = wp.vec3(
        wp.clamp(position[0], 0.5, float(nx) - 1.5),
        wp.clamp(position[1], 0.5, float(ny) - 1.5),
        wp.clamp(position[2], 0.5, float(nz) - 1.5),
    )
    i = wp.clamp(int(inside[0] + 0.5), 1, nx - 2)
    j = wp.clamp(int(inside[1] + 0.5), 1, ny - 2)
    k = wp.clamp(int(inside[2] + 0.5), 1, nz - 2)
    fx = inside[0] - float(i)
    fy = inside[1] - float(j)
    fz = inside[2] - float(k)
    wx = _weights(fx)
    wy = _weights(fy)
    wz = _weights(fz)
    dx = wp.vec3(fx - 0.5, -2.0 * fx, fx + 0.5)
    dy = wp.vec3(fy - 0.5, -2.0 * fy, fy + 0.5)
    dz = wp.vec3(fz - 0.5, -2.0 * fz, fz + 0.5)
    # Second derivatives of the three weights are 1, -2, 1.
    second = wp.vec3(1.0, -2.0, 1.0)

    value = float(0.0)
    gx = float(0.0)
    gy = float(0.0)
    gz = float(0.0)
    hxx = float(0.0)
    hyy = float(0.0)
    hzz = float(0.0)
    hxy = float(0.0)
    hxz = float(0.0)
    hyz = float(0.0)
    for a in range(3):
        for b in range(3):
            c0 = coefficients[i + a - 1, j + b - 1, k - 1]
            c1 = coefficients[i + a - 1, j + b - 1, k]
            c2 = coefficients[i + a - 1, j + b - 1, k + 1]
            line = wz[0] * c0 + wz[1] * c1 + wz[2] * c2
            slope = dz[0] * c0 + dz[1] * c1 + dz[2] * c2
            value += wx[a] * wy[b] * line
            gx += dx[a] * wy[b] * line
            gy += wx[a] * dy[b] * line
            gz += wx[a] * wy[b] * slope
            hxx += second[a] * wy[b] * line
            hyy += wx[a] * second[b] * line
            hzz += wx[a] * wy[b] * (c0 - 2.0 * c1 + c2)
            hxy += dx[a] * dy[b] * line
            hxz += dx[a] * wy[b] * slope
            hyz += wx[a] * dy[b] * slope
    gradient = wp.vec3(gx, gy, gz) / spacing
    hessian = wp.mat33(hxx, hxy, hxz, hxy, hyy, hyz, hxz, hyz, hzz) / (spacing * spacing)

    beyond = (position - inside) * spacing
    distance = wp.length(beyond)
    if distance > SMALLEST_LENGTH_M:
        value += distance
        free = wp.vec3(
            wp.where(beyond[0] == 0.0, 1.0, 0.0),
            wp.where(beyond[1] == 0.0, 1.0, 0.0),
            wp.where(beyond[2] == 0.0, 1.0, 0.0),
        )
        gradient = wp.cw_mul(gradient, free) + beyond / distance
        hessian = wp.mat33(0.0)
    return value, gradient, hessian


@wp.func
def _weights(f: float):
    return wp.vec3(0.5 * (0.5 - f) * (0.5 - f), 0.75 - f * f, 0.5 * (0.5 + f) * (0.5 + f))


@wp.func
def _arc(rho: float, z: float, centre_rho: float, centre_z: float, radius: float):
    """Meridian profile around one point: (distance, normal rho, normal z, curvature)."""
    d_rho = rho - centre_rho
    d_z = z - centre_z
    length = wp.max(wp.length(wp.vec2(d_rho, d_z)), SMALLEST_LENGTH_M)
    return wp.vec4(length - radius, d_rho / length, d_z / length, 1.0 / length)


@wp.func
def _cylinder_profile(rho: float, z: float, radius: float, length: float, edge: float):
    q_rho = rho - (radius - edge)
    height = z - 0.5 * length
    side = wp.where(height < 0.0, -1.0, 1.0)
    q_z = side * height - (0.5 * length - edge)
    profile = wp.vec4(q_rho - edge, 1.0, 0.0, 0.0)
    if q_rho > 0.0 and q_z > 0.0:
        corner = _arc(q_rho, q_z, 0.0, 0.0, edge)
        profile = wp.vec4(corner[0], corner[1], side * corner[2], corner[3])
    elif q_z > q_rho:
        profile = wp.vec4(q_z - edge, 0.0, side, 0.0)
    return profile


@wp.func
def _cone_profile(rho: float, z: float, half_angle: float, height: float, tip: float):
    """A sharp cone from z = tip to height - tip, grown by the tip's radius."""
    sine = wp.sin(half_angle)
    cosine = wp.cos(half_angle)
    top = height - 2.0 * tip
    up = z - tip
    rim = top * sine / cosine
    along = rho * sine + up * cosine
    to_flank = rho * cosine - up * sine
    to_face = up - top
    flank = wp.vec4(to_flank - tip, cosine, -sine, 0.0)
    profile = wp.vec4(to_face - tip, 0.0, 1.0, 0.0)
    if to_flank <= 0.0 and to_face <= 0.0:
        if to_flank > to_face:
            profile = flank
    elif to_face <= 0.0 or rho > rim:
        if along < 0.0:
            profile = _arc(rho, up, 0.0, 0.0, tip)
        elif along * cosine > top:
            profile = _arc(rho, up, rim, top, tip)
        else:
            profile = flank
    return profile


@wp.func
def _capsule_profile(rho: float, z: float, radius: float, length: float):
    profile = wp.vec4(rho - radius, 1.0, 0.0, 0.0)
    if z < radius:
        profile = _arc(rho, z, 0.0, radius, radius)
    elif z > radius + length:
        profile = _arc(rho, z, 0.0, radius + length, radius)
    return profile


@wp.func
def _box_distance(parameters: wp.array(dtype=float), x: wp.vec3):
    edge = parameters[3]
    half = 0.5 * wp.vec3(parameters[0], parameters[1], parameters[2])
    centred = x - wp.vec3(0.0, 0.0, half[2])
    side = wp.vec3(
        wp.where(centred[0] < 0.0, -1.0, 1.0),
        wp.where(centred[1] < 0.0, -1.0, 1.0),
        wp.where(centred[2] < 0.0, -1.0, 1.0),
    )
    q = wp.cw_mul(side, centred) - (half - wp.vec3(edge, edge, edge))
    axis = wp.vec3(0.0, 0.0, 1.0)
    deepest = q[2]
    if q[0] >= q[1] and q[0] >= q[2]:
        axis = wp.vec3(1.0, 0.0, 0.0)
        deepest = q[0]
    elif q[1] >= q[2]:
        axis = wp.vec3(0.0, 1.0, 0.0)
        deepest = q[1]
    distance = deepest - edge
    gradient = wp.cw_mul(side, axis)
    hessian = wp.mat33(0.0)
    if deepest > 0.0:
        beyond = wp.vec3(wp.max(q[0], 0.0), wp.max(q[1], 0.0), wp.max(q[2], 0.0))
        length = wp.length(beyond)
        distance = length - edge
        gradient = wp.cw_mul(side, beyond) / length
        active = wp.vec3(
            wp.where(q[0] > 0.0, 1.0, 0.0),
            wp.where(q[1] > 0.0, 1.0, 0.0),
            wp.where(q[2] > 0.0, 1.0, 0.0),
        )
        hessian = (wp.diag(active) - wp.outer(gradient, gradient)) / length
    return distance, gradient, hessian


@wp.func
def _revolve(profile: wp.vec4, x: wp.vec3):
    """Return (distance, gradient, Hessian) of a meridian profile turned about z."""
    rho = wp.length(wp.vec2(x[0], x[1]))
    radial = wp.vec3(1.0, 0.0, 0.0)
    hoop = profile[3]
    if rho > SMALLEST_LENGTH_M:
        radial = wp.vec3(x[0] / rho, x[1] / rho, 0.0)
        hoop = profile[1] / rho
    gradient = profile[1] * radial + wp.vec3(0.0, 0.0, profile[2])
    tangent = wp.vec3(0.0, 0.0, profile[1]) - profile[2] * radial
    around = wp.vec3(-radial[1], radial[0], 0.0)
    hessian = profile[3] * wp.outer(tangent, tangent) + hoop * wp.outer(around, around)
    return profile[0], gradient, hessian


@wp.func
def indenter_distance(field: IndenterField, x: wp.vec3):
    """Return signed distance, gradient (vec3) and Hessian (mat33) at x, all in the indenter's
    frame; metres, negative inside."""
    distance = float(0.0)
    gradient = wp.vec3(0.0, 0.0, 0.0)
    hessian = wp.mat33(0.0)
    if field.kind == MESH:
        distance, gradient, hessian = sample_distance_grid(
            field.coefficients, field.origin, field.spacing, x
        )
    else:
        local = wp.transform_point(field.shape_from_indenter, x)
        local_gradient = wp.vec3(0.0, 0.0, 0.0)
        local_hessian = wp.mat33(0.0)
        if field.kind == BOX:
            distance, local_gradient, local_hessian = _box_distance(field.parameters, local)
        else:
            rho = wp.length(wp.vec2(local[0], local[1]))
            z = local[2]
            p = field.parameters
            profile = wp.vec4(0.0, 0.0, 0.0, 0.0)
            if field.kind == SPHERE:
                profile = _arc(rho, z, 0.0, p[0], p[0])
            elif field.kind == CYLINDER:
                profile = _cylinder_profile(rho, z, p[0], p[1], p[2])
            elif field.kind == CONE:
                profile = _cone_profile(rho, z, p[0], p[1], p[2])
            elif field.kind == CAPSULE:
                profile = _capsule_profile(rho, z, p[0], p[1])
            else:
                profile = _arc(rho, z, p[0], p[1], p[1])
            distance, local_gradient, local_hessian = _revolve(profile, local)
        turn = wp.quat_to_matrix(wp.transform_get_rotation(field.shape_from_indenter))
        gradient = wp.transpose(turn) * local_gradient
        hessian = wp.transpose(turn) * local_hessian * turn
    return distance, gradient, hessian
