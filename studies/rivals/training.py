# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a baseline is fitted on: frames with skin and force, drawn from presses by a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dotsim_ros.data.presses import Press
from dotsim_ros.geometry.skin_mesh import SkinMesh, vertex_normals
from dotsim_ros.io.arrays import FloatArray


def check_training(train: Sequence[Press]) -> None:
    """Refuse presses that a baseline cannot be fitted on.

    Raises:
        ValueError: no press, or one without skin or force.
    """
    if not train:
        raise ValueError("no press to fit on")
    for press in train:
        if press.skin_position_m is None or press.force_n is None:
            raise ValueError(f"{press.name}: a baseline is fitted on skin and force; one is absent")


@dataclass(frozen=True)
class MeasuredSurface:
    """One measured skin, to which predicted points are compared.

    Attributes:
        position_m: (V, 3) measured vertices.
        normal: (V, 3) their normals.
        tree: of the vertices.
    """

    position_m: FloatArray
    normal: FloatArray
    tree: cKDTree

    def squared_distance(self, points_m: FloatArray) -> FloatArray:
        """Return (N,) squared distances of points (N, 3) to the plane of the nearest vertex."""
        _, nearest = self.tree.query(points_m)
        gap = np.sum((points_m - self.position_m[nearest]) * self.normal[nearest], axis=1)
        return np.asarray(gap**2)


def measured_surface(position_m: FloatArray, skin: SkinMesh) -> MeasuredSurface:
    """Return a measured skin (V, 3) with what comparing to it needs."""
    return MeasuredSurface(
        position_m, vertex_normals(position_m, skin.triangles), cKDTree(position_m)
    )


def surface_rms_m(predicted_m: FloatArray, measured: Sequence[MeasuredSurface]) -> float:
    """Return the root mean square distance of predicted skins (F, V, 3) to F measured ones."""
    squares = [
        surface.squared_distance(points).mean()
        for points, surface in zip(predicted_m, measured, strict=True)
    ]
    return float(np.sqrt(np.mean(squares)))
