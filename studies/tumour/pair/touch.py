# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Contact of markers with the deformable top of a layer: an energy of the gaps between them.

A marker's gap is its distance to the nearest point of the top, a smooth spline surface (closest
point projection: Wriggers, "Computational Contact Mechanics", 2006, chapter 4). Marker and nearest
point lie on one normal, so that the forces on both bodies are opposite, on one line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from dotsim_ros.io.arrays import BoolArray, FloatArray, IndexArray
from studies.tumour.pair.layer import SoftLayer

ONSET_M = 10.0e-6
"""Gap at which the pressure begins."""
SMOOTHING_M = 20.0e-6
"""Depth below the onset over which the stiffness of the contact rises to its full value."""
PROJECTIONS = 4
"""Newton iterations for the nearest point; the last changes nothing within rounding."""


@dataclass(frozen=True)
class Touch:
    """The contact of candidates; vectors are in the layer's frame.

    Attributes:
        gap_m: (C,) signed distance to the top, negative inside.
        normal: (C, 3) outward normal of the top at the nearest point.
        energy_j: of all.
        force_n: (C,) magnitude of the force on each marker, along its normal; on the layer it is
            the opposite.
        stiffness_n_m: (C,) its derivative by the depth.
        layer_weight: (C, N) weights of the layer's nodes at the nearest points.
        parameters_m: (C, 2) where on the top these lie.
    """

    gap_m: FloatArray
    normal: FloatArray
    energy_j: float
    force_n: FloatArray
    stiffness_n_m: FloatArray
    layer_weight: sparse.csr_matrix
    parameters_m: FloatArray

    def layer_force_n(self) -> FloatArray:
        """Return the gradient (N, 3) of the energy by the layer's displacements."""
        return np.asarray(self.layer_weight.T @ (self.force_n[:, None] * self.normal))


def pressed(depth_m: FloatArray, stiffness: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return energy (C,), pressure and its derivative per area, of depths (C,) below the onset."""
    w, d = SMOOTHING_M, np.maximum(depth_m, 0.0)
    soft = d < w
    energy = np.where(soft, d**3 / (6.0 * w), 0.5 * d * (d - w) + w**2 / 6.0)
    pressure = np.where(soft, d**2 / (2.0 * w), d - 0.5 * w)
    slope = np.where(soft, d / w, 1.0)
    return stiffness * energy, stiffness * pressure, stiffness * slope


def touch(
    layer: SoftLayer,
    displacement_m: FloatArray,
    marker_m: FloatArray,
    area_m2: FloatArray,
    stiffness_pa_m: float,
    start_m: FloatArray,
) -> Touch:
    """Return the contact of markers with the layer's top.

    Args:
        layer: the layer.
        displacement_m: (N, 3) of its nodes.
        marker_m: (C, 3) candidates, layer's frame.
        area_m2: (C,) of the skin that each stands for.
        stiffness_pa_m: pressure over depth.
        start_m: (C, 2) where on the top the search for the nearest points begins.
    """
    at = start_m.copy()
    # Half a cell within the rim, where the surface ends.
    reach = 0.5 * (layer.specification.side_m - layer.specification.spacing_m)
    for _ in range(PROJECTIONS):
        top = layer.surface(at, displacement_m)
        away = marker_m - top.position_m
        slope = -np.einsum("cxk,cx->ck", top.tangent, away)
        metric = np.einsum("cxk,cxl->ckl", top.tangent, top.tangent)
        bend = metric - np.einsum("cxkl,cx->ckl", top.curvature, away)
        # Far from a strongly curved top the distance has no minimum; the metric alone serves there.
        bent = np.linalg.det(bend) > 0.1 * np.linalg.det(metric)
        hessian = np.where(bent[:, None, None], bend, metric)
        at = np.clip(at - np.linalg.solve(hessian, slope[..., None])[..., 0], -reach, reach)
    top = layer.surface(at, displacement_m)
    normal = np.cross(top.tangent[..., 0], top.tangent[..., 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    gap = np.einsum("cx,cx->c", marker_m - top.position_m, normal)
    energy, pressure, slope_pa = pressed(ONSET_M - gap, stiffness_pa_m)
    return Touch(
        gap_m=gap,
        normal=normal,
        energy_j=float(area_m2 @ energy),
        force_n=area_m2 * pressure,
        stiffness_n_m=area_m2 * slope_pa,
        layer_weight=top.interpolation.matrix(layer.node_count),
        parameters_m=at,
    )


def near_top(
    layer: SoftLayer, marker_m: FloatArray, reach_m: float
) -> tuple[IndexArray, BoolArray]:
    """Return markers (C,) over the layer and closer to its top at rest than a reach, or below it;
    and for each marker (V,) whether it has left the layer's sides below its top."""
    half = 0.5 * layer.specification.side_m - layer.specification.spacing_m
    low = marker_m[:, 2] < layer.specification.thickness_m + reach_m
    over = np.all(np.abs(marker_m[:, :2]) < half, axis=1)
    return np.flatnonzero(low & over).astype(np.int32), low & ~over
