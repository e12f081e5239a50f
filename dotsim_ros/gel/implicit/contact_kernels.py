# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels of the contact between skin markers and a rigid indenter."""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, arg-type, assignment, index, operator"

from functools import cache
from types import SimpleNamespace
from typing import Any

from dotsim_ros.gel.distance_field import distance_functions
from dotsim_ros.io.warp_runtime import wp


@cache
def contact_kernels(scalar: Any) -> SimpleNamespace:
    """Return the kernels for `wp.float32` or `wp.float64`."""
    vec3 = wp.types.vector(3, scalar)
    mat33 = wp.types.matrix((3, 3), scalar)
    functions = distance_functions(scalar)
    field_type = functions.IndenterField
    indenter_distance = functions.indenter_distance
    smallest = wp.constant(scalar(1.0e-12))

    @wp.struct
    class ContactLaw:
        """stiffness, tangential_stiffness: Pa/m; friction: mu; onset: distance (m) at which the
        pressure begins; smoothing: distance (m) over which its slope grows."""

        stiffness: scalar
        tangential_stiffness: scalar
        friction: scalar
        onset: scalar
        smoothing: scalar

    @wp.struct
    class Markers:
        """Candidates and their positions, in their order; area, and position and slip at the start
        of the step in the indenter's frame, of all markers."""

        candidate: wp.array(dtype=wp.int32)
        position: wp.array(dtype=vec3)
        area: wp.array(dtype=scalar)
        start_position: wp.array(dtype=vec3)
        start_slip: wp.array(dtype=vec3)

    @wp.struct
    class PlacedIndenter:
        """A shape, and its pose in the base frame."""

        field: field_type
        rotation: mat33
        origin: vec3

    @wp.struct
    class Response:
        """Of the candidates, as `contact.ContactResponse`."""

        distance: wp.array(dtype=scalar)
        pressure: wp.array(dtype=scalar)
        force: wp.array(dtype=vec3)
        energy: wp.array(dtype=scalar)
        stiffness: wp.array(dtype=mat33)
        local_position: wp.array(dtype=vec3)
        slip: wp.array(dtype=vec3)
        normal: wp.array(dtype=vec3)

    @wp.func
    def pressure_energy(law: ContactLaw, depth: scalar):
        w = law.smoothing
        if depth <= scalar(0.0):
            return scalar(0.0)
        if depth < w:
            return law.stiffness * depth * depth * depth / (scalar(6.0) * w)
        s = depth - w
        return law.stiffness * (w * w / scalar(6.0) + scalar(0.5) * w * s + scalar(0.5) * s * s)

    @wp.func
    def pressure(law: ContactLaw, depth: scalar):
        w = law.smoothing
        if depth <= scalar(0.0):
            return scalar(0.0)
        if depth < w:
            return law.stiffness * depth * depth / (scalar(2.0) * w)
        return law.stiffness * (depth - scalar(0.5) * w)

    @wp.func
    def pressure_slope(law: ContactLaw, depth: scalar):
        if depth <= scalar(0.0):
            return scalar(0.0)
        return law.stiffness * wp.min(depth / law.smoothing, scalar(1.0))

    @wp.kernel(module="unique", enable_backward=False)
    def contact_response(
        markers: Markers,
        indenter: PlacedIndenter,
        law: ContactLaw,
        lagged_pressure: wp.array(dtype=scalar),
        lagged_normal: wp.array(dtype=vec3),
        response: Response,
    ):
        """Distance, pressure, force on the marker, energy and positive part of the stiffness of
        the candidates. Friction lies in the plane of the lagged normal (zero: the present
        one), its limit is mu times the lagged pressure.
        """
        i = wp.tid()
        m = markers.candidate[i]
        rotation = indenter.rotation
        y = wp.transpose(rotation) * (markers.position[i] - indenter.origin)
        d, n, _curvature = indenter_distance(indenter.field, y)
        depth = law.onset - d
        p = pressure(law, depth)
        a = markers.area[m]
        response.distance[i] = d
        response.pressure[i] = p
        response.local_position[i] = y
        f = (a * p) * n
        psi = a * pressure_energy(law, depth)
        h = (a * pressure_slope(law, depth)) * wp.outer(n, n)
        tangent_slip = vec3()
        if lagged_pressure[i] > scalar(0.0) and law.friction > scalar(0.0):
            m0 = n
            if wp.length_sq(lagged_normal[i]) > scalar(0.0):
                m0 = wp.transpose(rotation) * lagged_normal[i]
            # The gradient of a mesh's distance, interpolated on a grid, is not of unit length.
            m0 = wp.normalize(m0)
            projector = wp.identity(3, dtype=scalar) - wp.outer(m0, m0)
            s = projector * (markers.start_slip[m] + y - markers.start_position[m])
            length = wp.length(s)
            limit = law.friction * lagged_pressure[i] / law.tangential_stiffness
            if length <= limit:
                f -= (a * law.tangential_stiffness) * s
                psi += scalar(0.5) * a * law.tangential_stiffness * length * length
                h += (a * law.tangential_stiffness) * projector
                tangent_slip = s
            elif length > smallest:
                direction = s / length
                force_limit = a * law.tangential_stiffness * limit
                f -= force_limit * direction
                psi += force_limit * (length - scalar(0.5) * limit)
                h += (force_limit / length) * (projector - wp.outer(direction, direction))
                tangent_slip = limit * direction
        response.slip[i] = tangent_slip
        response.normal[i] = rotation * n
        response.force[i] = rotation * f
        response.energy[i] = psi
        response.stiffness[i] = rotation * h * wp.transpose(rotation)

    @wp.kernel(module="unique", enable_backward=False)
    def coulomb_response(
        markers: Markers,
        indenter: PlacedIndenter,
        law: ContactLaw,
        response: Response,
    ):
        """As `contact_response`, with friction in the plane of the present normal and limited by
        the present pressure, and with all of the stiffness, which is not symmetric."""
        i = wp.tid()
        m = markers.candidate[i]
        rotation = indenter.rotation
        y = wp.transpose(rotation) * (markers.position[i] - indenter.origin)
        d, n, curvature = indenter_distance(indenter.field, y)
        depth = law.onset - d
        p = pressure(law, depth)
        slope = pressure_slope(law, depth)
        f = p * n
        psi = pressure_energy(law, depth)
        h = slope * wp.outer(n, n) - p * curvature
        tangent_slip = vec3()
        if p > scalar(0.0) and law.friction > scalar(0.0):
            k = law.tangential_stiffness
            # The gradient of a mesh's distance, interpolated on a grid, is not of unit length.
            unit = wp.normalize(n)
            projector = wp.identity(3, dtype=scalar) - wp.outer(unit, unit)
            turn = (projector * curvature) / wp.length(n)
            moved = markers.start_slip[m] + y - markers.start_position[m]
            s = projector * moved
            by_position = projector - wp.outer(unit, wp.transpose(turn) * moved)
            by_position -= wp.dot(unit, moved) * turn
            length = wp.length(s)
            limit = law.friction * p / k
            if length <= limit:
                f -= k * s
                psi += scalar(0.5) * k * length * length
                h += k * by_position
                tangent_slip = s
            elif length > smallest:
                direction = s / length
                f -= (k * limit) * direction
                psi += k * limit * (length - scalar(0.5) * limit)
                turning = wp.identity(3, dtype=scalar) - wp.outer(direction, direction)
                h += (k * limit / length) * (turning * by_position)
                h -= (law.friction * slope) * wp.outer(direction, n)
                tangent_slip = limit * direction
        a = markers.area[m]
        response.distance[i] = d
        response.pressure[i] = p
        response.local_position[i] = y
        response.slip[i] = tangent_slip
        response.normal[i] = rotation * n
        response.force[i] = a * (rotation * f)
        response.energy[i] = a * psi
        response.stiffness[i] = a * (rotation * h * wp.transpose(rotation))

    return SimpleNamespace(
        scalar=scalar,
        vec3=vec3,
        mat33=mat33,
        ContactLaw=ContactLaw,
        Markers=Markers,
        PlacedIndenter=PlacedIndenter,
        Response=Response,
        contact_response=contact_response,
        coulomb_response=coulomb_response,
        pressure=pressure,
        pressure_slope=pressure_slope,
    )
