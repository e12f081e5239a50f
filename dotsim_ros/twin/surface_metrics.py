# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How far a predicted surface and force are from measured ones.

Four metrics compare samples, as is usual for point clouds: two samples of one surface differ as
well, by the floor that `cloud_distances` of the surface against itself shows. The others need none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from dotsim_ros.geometry.skin_mesh import face_vectors
from dotsim_ros.io.arrays import FloatArray, IndexArray

SAMPLE_COUNT = 2048
SIGNIFICANT_SHARE = 0.01
F_SCORE_THRESHOLD_M = 1.0e-3


@dataclass(frozen=True)
class CloudDistances:
    """What samples of two surfaces differ by.

    Attributes:
        chamfer_m: mean distance to the nearest point of the other cloud, both ways averaged.
        significant_chamfer_m: the same over the farthest 1 % of the points of each cloud.
        earth_mover_m: mean distance of the best one-to-one assignment.
        f_score: harmonic mean of the shares of points within 1 mm of the other cloud.
    """

    chamfer_m: float
    significant_chamfer_m: float
    earth_mover_m: float
    f_score: float


def sample_surface(
    position_m: FloatArray, triangles: IndexArray, count: int, random: np.random.Generator
) -> FloatArray:
    """Return points (count, 3) drawn uniformly by area from a triangle surface (V, 3), (T, 3).

    Raises:
        ValueError: a position is not finite, or the surface has no area.
    """
    area = np.linalg.norm(face_vectors(position_m, triangles), axis=1)
    total = float(area.sum())
    if not (np.isfinite(total) and total > 0.0):
        raise ValueError(f"a surface of twice {total} m^2 cannot be sampled")
    chosen = triangles[random.choice(len(triangles), size=count, p=area / total)]
    # Reflected at the diagonal, the unit square's points are uniform in the triangle.
    weight = random.random((count, 2))
    outside = weight.sum(axis=1) > 1.0
    weight[outside] = 1.0 - weight[outside]
    corner = position_m[chosen]
    return np.asarray(
        corner[:, 0]
        + weight[:, :1] * (corner[:, 1] - corner[:, 0])
        + weight[:, 1:] * (corner[:, 2] - corner[:, 0])
    )


def cloud_distances(first_m: FloatArray, second_m: FloatArray) -> CloudDistances:
    """Return the distances between two clouds (N, 3) of as many points, symmetric in them."""
    forward = KDTree(second_m).query(first_m)[0]
    backward = KDTree(first_m).query(second_m)[0]
    return CloudDistances(
        chamfer_m=float(0.5 * (forward.mean() + backward.mean())),
        significant_chamfer_m=float(0.5 * (_farthest_mean(forward) + _farthest_mean(backward))),
        earth_mover_m=earth_mover_distance(first_m, second_m),
        f_score=_f_score(forward, backward),
    )


def _farthest_mean(distance: FloatArray) -> float:
    count = max(1, round(SIGNIFICANT_SHARE * len(distance)))
    return float(np.partition(distance, -count)[-count:].mean())


def _f_score(forward: FloatArray, backward: FloatArray) -> float:
    precision = float(np.mean(forward < F_SCORE_THRESHOLD_M))
    recall = float(np.mean(backward < F_SCORE_THRESHOLD_M))
    return 2.0 * precision * recall / (precision + recall) if precision + recall > 0.0 else 0.0


def earth_mover_distance(first_m: FloatArray, second_m: FloatArray) -> float:
    """Return the least mean distance (m) over which one cloud (N, 3) is moved onto the other.

    Exact: between as many points of equal weight, a best transport is an assignment.
    """
    distance = cdist(first_m, second_m)
    return float(distance[linear_sum_assignment(distance)].mean())


def weighted_rms(values: FloatArray, weight: FloatArray) -> float:
    """Return the root of the weighted mean square of values (N,).

    Raises:
        ValueError: the weights (N,) sum to nothing.
    """
    total = float(weight.sum())
    if not total > 0.0:
        raise ValueError("the weights sum to zero, expected a positive sum")
    return float(np.sqrt(np.sum(weight * values**2) / total))


def along_surface(vectors: FloatArray, normal: FloatArray) -> FloatArray:
    """Return vectors (F, 3) without their components along unit normals (F, 3)."""
    along = np.sum(vectors * normal, axis=1)
    return np.asarray(vectors - along[:, None] * normal)


def relative_rms(error: FloatArray, measured: FloatArray) -> float | None:
    """Return the root mean square of errors (F, ...) over that of what was measured (F, ...).

    Small values, which are mostly noise, weigh little; None where all measured are zero.
    """
    scale = float(np.sum(measured**2))
    return float(np.sqrt(np.sum(error**2) / scale)) if scale > 0.0 else None
