# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels that the adjoint differentiates: the contact law with the current pressure, and the
power of the elastic stress along a virtual displacement. Double precision only."""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, arg-type, assignment, index, operator"

from functools import cache
from types import SimpleNamespace

from dotsim_ros.gel.distance_field import distance_functions
from dotsim_ros.gel.elastic_kernels import elastic_kernels
from dotsim_ros.gel.implicit.contact_kernels import contact_kernels
from dotsim_ros.io.warp_runtime import wp

STIFFNESS = wp.constant(0)
TANGENTIAL_STIFFNESS = wp.constant(1)
FRICTION = wp.constant(2)


@cache
def adjoint_kernels() -> SimpleNamespace:
    """Return the kernels."""
    scalar = wp.float64
    contact = contact_kernels(scalar)
    elastic = elastic_kernels(scalar)
    vec3, mat33, vec5 = elastic.vec3, elastic.mat33, elastic.vec5
    law_type, pressure = contact.ContactLaw, contact.pressure
    deformation_gradient = elastic.deformation_gradient
    shape_stress, volume_stress = elastic.shape_stress, elastic.volume_stress
    functions = distance_functions(scalar)
    field_type, indenter_distance = functions.IndenterField, functions.indenter_distance
    smallest = wp.constant(scalar(1.0e-12))

    @wp.kernel(module="unique")
    def marker_force(
        position: wp.array(dtype=vec3),
        anchor: wp.array(dtype=vec3),
        memory: wp.array(dtype=vec3),
        area: wp.array(dtype=scalar),
        field: field_type,
        unit_law: law_type,
        constants: wp.array(dtype=scalar),
        force: wp.array(dtype=vec3),
        slip: wp.array(dtype=vec3),
        pressures: wp.array(dtype=scalar),
    ):
        """Force on markers and their elastic slip, all in the indenter's frame.

        `memory` is slip minus position at the end of the last step; `unit_law` has stiffness 1.
        `anchor` is the position once more: the tape takes derivatives by it for the indenter's
        parameters alone. Those by the position come from the distance's Hessian, which unlike the
        tape's own holds on an indenter's axis too.
        """
        i = wp.tid()
        y = position[i]
        at_anchor, n_at_anchor, curvature = indenter_distance(field, anchor[i])
        away = y - anchor[i]
        d = at_anchor + wp.dot(n_at_anchor, away)
        n = n_at_anchor + curvature * away
        depth = unit_law.onset - d  # type: ignore[attr-defined]
        p = constants[STIFFNESS] * pressure(unit_law, depth)
        a = area[i]
        f = (a * p) * n
        elastic_slip = vec3()
        if depth > scalar(0.0) and constants[FRICTION] > scalar(0.0):
            tangential = constants[TANGENTIAL_STIFFNESS]
            moved = memory[i] + y
            unit = wp.normalize(n)
            s = moved - wp.dot(unit, moved) * unit
            length = wp.length(s)
            limit = constants[FRICTION] * p / tangential
            if length <= limit:
                elastic_slip = s
            elif length > smallest:
                elastic_slip = (limit / length) * s
            f = f - (a * tangential) * elastic_slip
        pressures[i] = p
        force[i] = f
        slip[i] = elastic_slip

    @wp.kernel(module="unique")
    def stress_power(
        node_index: wp.array2d(dtype=wp.int32),
        weight_gradient: wp.array2d(dtype=vec3),
        volume: wp.array(dtype=scalar),
        coefficients: wp.array(dtype=vec5),
        fast_share: wp.array(dtype=scalar),
        history_stress: wp.array2d(dtype=mat33),
        displacement: wp.array2d(dtype=vec3),
        virtual_move: wp.array2d(dtype=vec3),
        power: wp.array(dtype=scalar),
    ):
        """Stress of each particle times the gradient of a virtual displacement, times volume."""
        p = wp.tid()
        f = deformation_gradient(displacement, node_index, weight_gradient, 0, p)
        df = deformation_gradient(virtual_move, node_index, weight_gradient, 0, p)
        df = df - wp.identity(3, dtype=scalar)
        c = coefficients[0]
        stress = fast_share[0] * shape_stress(f, c) + volume_stress(f, c)
        stress = stress + f * history_stress[0, p]
        power[p] = volume[p] * wp.ddot(stress, df)

    return SimpleNamespace(
        vec3=vec3,
        mat33=mat33,
        vec5=vec5,
        ContactLaw=law_type,
        marker_force=marker_force,
        stress_power=stress_power,
        material_stress=elastic.material_stress,
    )
