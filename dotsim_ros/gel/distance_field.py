# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Signed distance of an indenter inside Warp kernels: value, gradient and Hessian at a point.

Primitives are exact, meshes a quadratic B-spline on a grid. All functions can be differentiated by
Warp's tape: the value with respect to the point and the primitive's parameters.

    distance = distance_functions(wp.float64)
    field = indenter_field(indenter, scalar=wp.float64)     # host
    d, gradient, hessian = distance.indenter_distance(field, x)  # in a kernel; x in its frame
"""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, arg-type, assignment, index, operator"

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from dotsim_ros.geometry.indenter import Indenter, IndenterKind
from dotsim_ros.io.warp_runtime import wp

SPHERE = wp.constant(int(IndenterKind.SPHERE))
BOX = wp.constant(int(IndenterKind.BOX))
CYLINDER = wp.constant(int(IndenterKind.CYLINDER))
CONE = wp.constant(int(IndenterKind.CONE))
CAPSULE = wp.constant(int(IndenterKind.CAPSULE))
TORUS = wp.constant(int(IndenterKind.TORUS))
MESH = wp.constant(int(IndenterKind.MESH))

# Below this distance to an axis or to a centre of curvature a direction is arbitrary.
SMALLEST_LENGTH_M = 1.0e-9


@cache
def distance_functions(scalar: Any) -> SimpleNamespace:
    """Return the struct `IndenterField` and the Warp functions `indenter_distance(field, x)` and
    `sample_distance_grid(coefficients, origin, spacing, x)` for `wp.float32` or `wp.float64`.

    Both functions return distance (m), gradient (vec3) and Hessian (mat33, 1/m) at x (vec3).
    """
    vec2 = wp.types.vector(2, scalar)
    vec3 = wp.types.vector(3, scalar)
    vec4 = wp.types.vector(4, scalar)
    mat33 = wp.types.matrix((3, 3), scalar)
    transform = wp.types.transformation(scalar)
    smallest = wp.constant(scalar(SMALLEST_LENGTH_M))

    @wp.struct
    class IndenterField:
        """What kernels need to know of an indenter; made by `indenter_field`.

        kind: an IndenterKind; parameters (n,): those of the Indenter; shape_from_indenter: the
        inverse of its mount; coefficients (nx, ny, nz), origin, spacing: the distance grid of a
        mesh, one node for a primitive.
        """

        kind: int
        parameters: wp.array(dtype=scalar)
        shape_from_indenter: transform
        coefficients: wp.array3d(dtype=scalar)
        origin: vec3
        spacing: scalar

    @wp.func
    def sample_distance_grid(
        coefficients: wp.array3d(dtype=scalar), origin: vec3, spacing: scalar, x: vec3
    ):
        """Return distance, gradient (vec3) and Hessian (mat33) of a quadratic B-spline at x.

        Outside of the grid: the value on its boundary plus the distance to it.
        """
        position = (x - origin) / spacing
        nx = coefficients.shape[0]
        ny = coefficients.shape[1]
        nz = coefficients.shape[2]
        inside = vec3(
            wp.clamp(position[0], scalar(0.5), scalar(nx) - scalar(1.5)),
            wp.clamp(position[1], scalar(0.5), scalar(ny) - scalar(1.5)),
            wp.clamp(position[2], scalar(0.5), scalar(nz) - scalar(1.5)),
        )
        i = wp.clamp(int(inside[0] + scalar(0.5)), 1, nx - 2)
        j = wp.clamp(int(inside[1] + scalar(0.5)), 1, ny - 2)
        k = wp.clamp(int(inside[2] + scalar(0.5)), 1, nz - 2)
        fx = inside[0] - scalar(i)
        fy = inside[1] - scalar(j)
        fz = inside[2] - scalar(k)
        wx = _weights(fx)
        wy = _weights(fy)
        wz = _weights(fz)
        dx = vec3(fx - scalar(0.5), -scalar(2.0) * fx, fx + scalar(0.5))
        dy = vec3(fy - scalar(0.5), -scalar(2.0) * fy, fy + scalar(0.5))
        dz = vec3(fz - scalar(0.5), -scalar(2.0) * fz, fz + scalar(0.5))
        # Second derivatives of the three weights are 1, -2, 1.
        second = vec3(scalar(1.0), -scalar(2.0), scalar(1.0))

        value = scalar(0.0)
        gx = scalar(0.0)
        gy = scalar(0.0)
        gz = scalar(0.0)
        hxx = scalar(0.0)
        hyy = scalar(0.0)
        hzz = scalar(0.0)
        hxy = scalar(0.0)
        hxz = scalar(0.0)
        hyz = scalar(0.0)
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
                hzz += wx[a] * wy[b] * (c0 - scalar(2.0) * c1 + c2)
                hxy += dx[a] * dy[b] * line
                hxz += dx[a] * wy[b] * slope
                hyz += wx[a] * dy[b] * slope
        gradient = vec3(gx, gy, gz) / spacing
        hessian = mat33(hxx, hxy, hxz, hxy, hyy, hyz, hxz, hyz, hzz) / (spacing * spacing)

        beyond = (position - inside) * spacing
        distance = wp.length(beyond)
        if distance > smallest:
            value += distance
            free = vec3(
                wp.where(beyond[0] == scalar(0.0), scalar(1.0), scalar(0.0)),
                wp.where(beyond[1] == scalar(0.0), scalar(1.0), scalar(0.0)),
                wp.where(beyond[2] == scalar(0.0), scalar(1.0), scalar(0.0)),
            )
            gradient = wp.cw_mul(gradient, free) + beyond / distance
            hessian = mat33(scalar(0.0))
        return value, gradient, hessian

    @wp.func
    def _weights(f: scalar):
        return vec3(
            scalar(0.5) * (scalar(0.5) - f) * (scalar(0.5) - f),
            scalar(0.75) - f * f,
            scalar(0.5) * (scalar(0.5) + f) * (scalar(0.5) + f),
        )

    @wp.func
    def _arc(rho: scalar, z: scalar, centre_rho: scalar, centre_z: scalar, radius: scalar):
        """Meridian profile around one point: (distance, normal rho, normal z, curvature)."""
        d_rho = rho - centre_rho
        d_z = z - centre_z
        length = wp.max(wp.length(vec2(d_rho, d_z)), smallest)
        return vec4(length - radius, d_rho / length, d_z / length, scalar(1.0) / length)

    @wp.func
    def _cylinder_profile(rho: scalar, z: scalar, radius: scalar, length: scalar, edge: scalar):
        q_rho = rho - (radius - edge)
        height = z - scalar(0.5) * length
        side = wp.where(height < scalar(0.0), -scalar(1.0), scalar(1.0))
        q_z = side * height - (scalar(0.5) * length - edge)
        profile = vec4(q_rho - edge, scalar(1.0), scalar(0.0), scalar(0.0))
        if q_rho > scalar(0.0) and q_z > scalar(0.0):
            corner = _arc(q_rho, q_z, scalar(0.0), scalar(0.0), edge)
            profile = vec4(corner[0], corner[1], side * corner[2], corner[3])
        elif q_z > q_rho:
            profile = vec4(q_z - edge, scalar(0.0), side, scalar(0.0))
        return profile

    @wp.func
    def _cone_profile(rho: scalar, z: scalar, half_angle: scalar, height: scalar, tip: scalar):
        """A sharp cone from z = tip to height - tip, grown by the tip's radius."""
        sine = wp.sin(half_angle)
        cosine = wp.cos(half_angle)
        top = height - scalar(2.0) * tip
        up = z - tip
        rim = top * sine / cosine
        along = rho * sine + up * cosine
        to_flank = rho * cosine - up * sine
        to_face = up - top
        flank = vec4(to_flank - tip, cosine, -sine, scalar(0.0))
        profile = vec4(to_face - tip, scalar(0.0), scalar(1.0), scalar(0.0))
        if to_flank <= scalar(0.0) and to_face <= scalar(0.0):
            if to_flank > to_face:
                profile = flank
        elif to_face <= scalar(0.0) or rho > rim:
            if along < scalar(0.0):
                profile = _arc(rho, up, scalar(0.0), scalar(0.0), tip)
            elif along * cosine > top:
                profile = _arc(rho, up, rim, top, tip)
            else:
                profile = flank
        return profile

    @wp.func
    def _capsule_profile(rho: scalar, z: scalar, radius: scalar, length: scalar):
        profile = vec4(rho - radius, scalar(1.0), scalar(0.0), scalar(0.0))
        if z < radius:
            profile = _arc(rho, z, scalar(0.0), radius, radius)
        elif z > radius + length:
            profile = _arc(rho, z, scalar(0.0), radius + length, radius)
        return profile

    @wp.func
    def _box_distance(parameters: wp.array(dtype=scalar), x: vec3):
        edge = parameters[3]
        half = scalar(0.5) * vec3(parameters[0], parameters[1], parameters[2])
        centred = x - vec3(scalar(0.0), scalar(0.0), half[2])
        side = vec3(
            wp.where(centred[0] < scalar(0.0), -scalar(1.0), scalar(1.0)),
            wp.where(centred[1] < scalar(0.0), -scalar(1.0), scalar(1.0)),
            wp.where(centred[2] < scalar(0.0), -scalar(1.0), scalar(1.0)),
        )
        q = wp.cw_mul(side, centred) - (half - vec3(edge, edge, edge))
        axis = vec3(scalar(0.0), scalar(0.0), scalar(1.0))
        deepest = q[2]
        if q[0] >= q[1] and q[0] >= q[2]:
            axis = vec3(scalar(1.0), scalar(0.0), scalar(0.0))
            deepest = q[0]
        elif q[1] >= q[2]:
            axis = vec3(scalar(0.0), scalar(1.0), scalar(0.0))
            deepest = q[1]
        distance = deepest - edge
        gradient = wp.cw_mul(side, axis)
        hessian = mat33(scalar(0.0))
        if deepest > scalar(0.0):
            beyond = vec3(
                wp.max(q[0], scalar(0.0)), wp.max(q[1], scalar(0.0)), wp.max(q[2], scalar(0.0))
            )
            length = wp.length(beyond)
            distance = length - edge
            gradient = wp.cw_mul(side, beyond) / length
            active = vec3(
                wp.where(q[0] > scalar(0.0), scalar(1.0), scalar(0.0)),
                wp.where(q[1] > scalar(0.0), scalar(1.0), scalar(0.0)),
                wp.where(q[2] > scalar(0.0), scalar(1.0), scalar(0.0)),
            )
            hessian = (wp.diag(active) - wp.outer(gradient, gradient)) / length
        return distance, gradient, hessian

    @wp.func
    def _revolve(profile: vec4, x: vec3):
        """Return (distance, gradient, Hessian) of a meridian profile turned about z."""
        rho = wp.length(vec2(x[0], x[1]))
        radial = vec3(scalar(1.0), scalar(0.0), scalar(0.0))
        hoop = profile[3]
        if rho > smallest:
            radial = vec3(x[0] / rho, x[1] / rho, scalar(0.0))
            hoop = profile[1] / rho
        gradient = profile[1] * radial + vec3(scalar(0.0), scalar(0.0), profile[2])
        tangent = vec3(scalar(0.0), scalar(0.0), profile[1]) - profile[2] * radial
        around = vec3(-radial[1], radial[0], scalar(0.0))
        hessian = profile[3] * wp.outer(tangent, tangent) + hoop * wp.outer(around, around)
        return profile[0], gradient, hessian

    @wp.func
    def indenter_distance(field: IndenterField, x: vec3):
        """Return signed distance, gradient (vec3) and Hessian (mat33) at x, all in the indenter's
        frame; metres, negative inside."""
        distance = scalar(0.0)
        gradient = vec3(scalar(0.0), scalar(0.0), scalar(0.0))
        hessian = mat33(scalar(0.0))
        if field.kind == MESH:
            distance, gradient, hessian = sample_distance_grid(
                field.coefficients, field.origin, field.spacing, x
            )
        else:
            local = wp.transform_point(field.shape_from_indenter, x)
            local_gradient = vec3(scalar(0.0), scalar(0.0), scalar(0.0))
            local_hessian = mat33(scalar(0.0))
            if field.kind == BOX:
                distance, local_gradient, local_hessian = _box_distance(field.parameters, local)
            else:
                rho = wp.length(vec2(local[0], local[1]))
                z = local[2]
                p = field.parameters
                profile = vec4(scalar(0.0), scalar(0.0), scalar(0.0), scalar(0.0))
                if field.kind == SPHERE:
                    profile = _arc(rho, z, scalar(0.0), p[0], p[0])
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

    return SimpleNamespace(
        IndenterField=IndenterField,
        indenter_distance=indenter_distance,
        sample_distance_grid=sample_distance_grid,
    )


def indenter_field(
    indenter: Indenter,
    *,
    scalar: Any = wp.float32,
    device: Any = None,
    spacing_m: float | None = None,
) -> Any:
    """Return the indenter as `distance_functions(scalar).IndenterField` on a device.

    Args:
        indenter: primitive or mesh.
        scalar: `wp.float32` or `wp.float64`, as the kernels that take it.
        device: a Warp device, by default the current one.
        spacing_m: node spacing of a mesh's distance grid, see `Indenter.distance_grid`.
    """
    vec3 = wp.types.vector(3, scalar)
    transform = wp.types.transformation(scalar)
    field = distance_functions(scalar).IndenterField()
    field.kind = int(indenter.kind)
    parameters = np.array(indenter.parameters or (0.0,))
    field.parameters = wp.array(parameters, dtype=scalar, device=device, requires_grad=True)
    turn = indenter.mount.rotation().T
    quaternion = indenter.mount.quaternion_xyzw * [-1.0, -1.0, -1.0, 1.0]
    field.shape_from_indenter = transform(*(-turn @ indenter.mount.position_m), *quaternion)
    origin, spacing = np.zeros(3), 1.0
    coefficients = np.zeros((1, 1, 1), dtype=np.float32)
    if indenter.kind == IndenterKind.MESH:
        grid = indenter.distance_grid(spacing_m)
        origin, spacing, coefficients = grid.origin_m, grid.spacing_m, grid.coefficients
    field.origin = vec3(*origin)
    field.spacing = spacing
    field.coefficients = wp.array(coefficients, dtype=scalar, ndim=3, device=device)
    return field
