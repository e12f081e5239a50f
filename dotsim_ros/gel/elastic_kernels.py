# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels of the elastic body: stress, nodal forces, tangent stiffness.

Arrays carry a leading environment axis. The kernels are made for one scalar type at a time: double
precision where the CPU is the device and in every gradient, single precision on a GPU.
"""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: disable-error-code="no-untyped-def, valid-type, arg-type, assignment, index, operator, misc"

from functools import cache
from types import SimpleNamespace
from typing import Any

from dotsim_ros.io.warp_runtime import wp


@cache
def elastic_kernels(scalar: Any) -> SimpleNamespace:
    """Return the kernels for `wp.float32` or `wp.float64`."""
    vec3 = wp.types.vector(3, scalar)
    mat33 = wp.types.matrix((3, 3), scalar)
    vec5 = wp.types.vector(5, scalar)
    # Warp computes the quotient of two literals in single precision, whatever it is cast to.
    two_thirds = wp.constant(scalar(2.0 / 3.0))
    four_thirds = wp.constant(scalar(4.0 / 3.0))

    @wp.func
    def deformation_gradient(
        displacement: wp.array2d(dtype=vec3),
        node_index: wp.array2d(dtype=wp.int32),
        weight_gradient: wp.array2d(dtype=vec3),
        environment: int,
        particle: int,
    ):
        f = wp.identity(3, dtype=scalar)
        for a in range(27):
            f += wp.outer(
                displacement[environment, node_index[particle, a]], weight_gradient[particle, a]
            )
        return f

    @wp.func
    def shape_energy(f: mat33, c: vec5):
        j = wp.determinant(f)
        a = wp.pow(j, -two_thirds)
        cg = wp.transpose(f) * f
        i1 = wp.trace(cg)
        i2 = scalar(0.5) * (i1 * i1 - wp.ddot(cg, cg))
        e1 = a * i1 - scalar(3.0)
        e2 = a * a * i2 - scalar(3.0)
        return e1 * (c[0] + e1 * (c[2] + e1 * c[3])) + c[1] * e2

    @wp.func
    def volume_energy(f: mat33, c: vec5):
        d = wp.determinant(f) - scalar(1.0)
        return scalar(0.5) * c[4] * d * d

    @wp.func
    def shape_stress(f: mat33, c: vec5):
        """First Piola-Kirchhoff stress of the part of the energy without K."""
        j = wp.determinant(f)
        g = wp.transpose(wp.inverse(f))
        a = wp.pow(j, -two_thirds)
        cg = wp.transpose(f) * f
        i1 = wp.trace(cg)
        i2 = scalar(0.5) * (i1 * i1 - wp.ddot(cg, cg))
        e1 = a * i1 - scalar(3.0)
        s1 = c[0] + e1 * (scalar(2.0) * c[2] + scalar(3.0) * c[3] * e1)
        d1 = a * (scalar(2.0) * f - (two_thirds * i1) * g)
        d2 = (a * a) * (scalar(2.0) * (i1 * f - f * cg) - (four_thirds * i2) * g)
        return s1 * d1 + c[1] * d2

    @wp.func
    def volume_stress(f: mat33, c: vec5):
        j = wp.determinant(f)
        return (c[4] * (j - scalar(1.0)) * j) * wp.transpose(wp.inverse(f))

    @wp.func
    def stress_derivative(f: mat33, c: vec5, fast: scalar, df: mat33):
        """Derivative of fast * shape_stress + volume_stress along df."""
        j = wp.determinant(f)
        g = wp.transpose(wp.inverse(f))
        a = wp.pow(j, -two_thirds)
        cg = wp.transpose(f) * f
        i1 = wp.trace(cg)
        i2 = scalar(0.5) * (i1 * i1 - wp.ddot(cg, cg))
        e1 = a * i1 - scalar(3.0)
        s1 = c[0] + e1 * (scalar(2.0) * c[2] + scalar(3.0) * c[3] * e1)
        s11 = scalar(2.0) * c[2] + scalar(6.0) * c[3] * e1
        q = wp.ddot(g, df)
        dg = -(g * wp.transpose(df) * g)
        di1 = scalar(2.0) * wp.ddot(f, df)
        b1 = scalar(2.0) * f - (two_thirds * i1) * g
        d1 = a * b1
        dd1 = (-two_thirds * a * q) * b1 + a * (
            scalar(2.0) * df - (two_thirds * di1) * g - (two_thirds * i1) * dg
        )
        result = s1 * dd1 + (s11 * wp.ddot(d1, df)) * d1
        if c[1] != scalar(0.0):
            di2_df = scalar(2.0) * (i1 * f - f * cg)
            b2 = di2_df - (four_thirds * i2) * g
            dcg = wp.transpose(df) * f + wp.transpose(f) * df
            ddi2 = scalar(2.0) * (di1 * f + i1 * df - df * cg - f * dcg)
            dd2 = (a * a) * (
                (-four_thirds * q) * b2
                + ddi2
                - (four_thirds * wp.ddot(di2_df, df)) * g
                - (four_thirds * i2) * dg
            )
            result += c[1] * dd2
        jm = j - scalar(1.0)
        volume = (c[4] * (scalar(2.0) * j - scalar(1.0)) * j * q) * g + (c[4] * jm * j) * dg
        return fast * result + volume

    @wp.kernel(module="unique", enable_backward=False)
    def internal_force(
        particle: wp.array(dtype=wp.int32),
        node_index: wp.array2d(dtype=wp.int32),
        weight_gradient: wp.array2d(dtype=vec3),
        volume: wp.array(dtype=scalar),
        coefficients: wp.array(dtype=vec5),
        fast_share: wp.array(dtype=scalar),
        history_stress: wp.array2d(dtype=mat33),
        displacement: wp.array2d(dtype=vec3),
        force: wp.array2d(dtype=vec3),
        energy: wp.array2d(dtype=scalar),
    ):
        """Add dW/du of the listed particles to `force`, write their energies."""
        e, i = wp.tid()
        p = particle[i]
        f = deformation_gradient(displacement, node_index, weight_gradient, e, p)
        c = coefficients[e]
        s = history_stress[e, p]
        v = volume[p]
        stress = fast_share[e] * shape_stress(f, c) + volume_stress(f, c) + f * s
        for a in range(27):
            wp.atomic_add(force, e, node_index[p, a], v * (stress * weight_gradient[p, a]))
        psi = fast_share[e] * shape_energy(f, c) + volume_energy(f, c)
        psi += scalar(0.5) * (wp.ddot(s, wp.transpose(f) * f) - wp.trace(s))
        if wp.determinant(f) <= scalar(0.0):
            psi = scalar(wp.inf)
        energy[e, i] = v * psi

    @wp.kernel(module="unique", enable_backward=False)
    def stress_tangent(
        cell: wp.array(dtype=wp.int32),
        cell_particle: wp.array2d(dtype=wp.int32),
        node_index: wp.array2d(dtype=wp.int32),
        weight_gradient: wp.array2d(dtype=vec3),
        volume: wp.array(dtype=scalar),
        coefficients: wp.array(dtype=vec5),
        fast_share: wp.array(dtype=scalar),
        history_stress: wp.array2d(dtype=mat33),
        displacement: wp.array2d(dtype=vec3),
        environment: int,
        contracted: wp.array4d(dtype=scalar),
    ):
        """Write sum_l V dP_ij/dF_kl g_bl of each particle of the listed cells as
        contracted[cell, i, 3 particle + j, 27 k + b]."""
        n, q = wp.tid()
        p = cell_particle[cell[n], q]
        if p < 0:
            for i in range(3):
                for j in range(3):
                    for kb in range(81):
                        contracted[n, i, 3 * q + j, kb] = scalar(0.0)
            return
        f = deformation_gradient(displacement, node_index, weight_gradient, environment, p)
        c = coefficients[environment]
        fast = fast_share[environment]
        s = history_stress[environment, p]
        v = volume[p]
        for k in range(3):
            d0 = mat33()
            d1 = mat33()
            d2 = mat33()
            d0[k, 0] = v
            d1[k, 1] = v
            d2[k, 2] = v
            p0 = stress_derivative(f, c, fast, d0) + d0 * s
            p1 = stress_derivative(f, c, fast, d1) + d1 * s
            p2 = stress_derivative(f, c, fast, d2) + d2 * s
            for b in range(27):
                g = weight_gradient[p, b]
                y = p0 * g[0] + p1 * g[1] + p2 * g[2]
                for i in range(3):
                    for j in range(3):
                        contracted[n, i, 3 * q + j, 27 * k + b] = y[i, j]

    @wp.kernel(module="unique", enable_backward=False)
    def scatter_stiffness(
        cell_stiffness: wp.array4d(dtype=scalar),
        base: wp.array3d(dtype=wp.int32),
        row_stride: int,
        values: wp.array(dtype=scalar),
    ):
        """Add the 3 x 3 blocks of the cells' stiffness [cell, i, a, 27 k + b] to `values`, from
        base[cell, a, b] on with the given distance between rows; a negative base is left out."""
        n, a = wp.tid()
        for b in range(27):
            start = base[n, a, b]
            if start >= 0:
                for i in range(3):
                    for k in range(3):
                        wp.atomic_add(
                            values, start + i * row_stride + k, cell_stiffness[n, i, a, 27 * k + b]
                        )

    @wp.kernel(module="unique")
    def material_stress(
        node_index: wp.array2d(dtype=wp.int32),
        weight_gradient: wp.array2d(dtype=vec3),
        coefficients: wp.array(dtype=vec5),
        displacement: wp.array2d(dtype=vec3),
        second_stress: wp.array2d(dtype=mat33),
    ):
        """Write the second Piola-Kirchhoff stress of the part of the energy without K."""
        e, p = wp.tid()
        f = deformation_gradient(displacement, node_index, weight_gradient, e, p)
        second_stress[e, p] = wp.inverse(f) * shape_stress(f, coefficients[e])

    return SimpleNamespace(
        scalar=scalar,
        vec3=vec3,
        mat33=mat33,
        vec5=vec5,
        deformation_gradient=deformation_gradient,
        shape_energy=shape_energy,
        volume_energy=volume_energy,
        shape_stress=shape_stress,
        volume_stress=volume_stress,
        internal_force=internal_force,
        stress_tangent=stress_tangent,
        scatter_stiffness=scatter_stiffness,
        material_stress=material_stress,
    )
