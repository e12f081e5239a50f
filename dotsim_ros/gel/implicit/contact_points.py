# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which markers of the skin bear the contact: all of them, or under a flat face fewer.

Markers lie closer together than the gel can bend, so that where an indenter's surface is flat,
pressure hardly changes from one to the next. There a marker in three bears what its neighbours
would; next to edges, on surfaces that are curved, and on a grid that is hardly wider than the
markers' distance, each bears its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import BoolArray, FloatArray, IndexArray

SPACING_M = 0.75e-3
"""Least distance of the markers that bear for others."""
CLOSE_SHARE = 0.2
"""Markers lie closer than the gel can bend where their distance is below this share of the grid's
spacing. At 0.25 the gel bends between those that bear: the skin of a pad 4 mm thick left a punch by
0.06 mm. At half the grid's spacing it went 0.4 mm into the punch, at four fifths of the force."""
FLAT_M = 0.6e-3
"""A surface counts as flat at a marker where its normal hardly turns so far around."""
TURN = 0.02
"""How far a normal turns where it hardly does, rad."""


class ContactPoints:
    """The markers that may bear the contact of a skin.

    Args:
        skin: whose markers they are.
        grid_spacing_m: of the gel's grid; with 0 each marker bears its own.
    """

    def __init__(self, skin: SkinMesh, grid_spacing_m: float) -> None:
        self._rest_area_m2 = skin.rest_area_m2
        # Of triangles with equal sides.
        apart_m = math.sqrt(2.0 / math.sqrt(3.0) * float(np.median(skin.rest_area_m2)))
        self._spacing_m = SPACING_M if apart_m < CLOSE_SHARE * grid_spacing_m else 0.0
        self._bearer = _bearers(skin.rest_position_m, ~skin.on_base, self._spacing_m)

    def bearers(
        self,
        marker: IndexArray,
        position_m: FloatArray,
        is_pressed: BoolArray,
        normals: Callable[[FloatArray], FloatArray],
    ) -> IndexArray:
        """Return which marker (V,) bears what presses on each of the skin: most of them themselves.

        Args:
            marker: (C,) numbers of those that may touch.
            position_m: (C, 3) where they are.
            is_pressed: (C,) whether they are, or will be unless they move: where the contact ends
                every marker bears its own, or some would sink in.
            normals: the indenter's at positions (C, 3) of these.
        """
        bearer = np.arange(len(self._bearer), dtype=np.int32)
        if self._spacing_m == 0.0:
            return bearer
        given = marker[is_pressed & _is_flat(position_m, normals)]
        given = given[np.isin(self._bearer[given], marker[is_pressed])]
        bearer[given] = self._bearer[given]
        return bearer

    def area_m2(self, bearer: IndexArray) -> FloatArray:
        """Return the area (V,) for which each marker bears, zero of those that others bear for."""
        return np.asarray(np.bincount(bearer, self._rest_area_m2, len(bearer)), dtype=np.float64)


def borne(force_n: FloatArray, bearer: IndexArray) -> FloatArray:
    """Return forces (V, 3) with those of each marker on the one that bears them."""
    given = np.flatnonzero(bearer != np.arange(len(bearer)))
    result = force_n.copy()
    result[given] = 0.0
    np.add.at(result, bearer[given], force_n[given])
    return result


def _bearers(position_m: FloatArray, is_free: BoolArray, spacing_m: float) -> IndexArray:
    """Return for each marker the one of a coarser choice that is nearest to it."""
    free = np.flatnonzero(is_free)
    bearer = np.arange(len(position_m), dtype=np.int32)
    if len(free) == 0:
        return bearer
    is_chosen = np.zeros(len(free), dtype=bool)
    is_left = np.ones(len(free), dtype=bool)
    for number, near in enumerate(
        cKDTree(position_m[free]).query_ball_point(position_m[free], spacing_m)
    ):
        if is_left[number]:
            is_chosen[number] = True
            is_left[near] = False
    chosen = free[is_chosen]
    _, nearest = cKDTree(position_m[chosen]).query(position_m[free])
    bearer[free] = chosen[nearest]
    return bearer


def _is_flat(position_m: FloatArray, normals: Callable[[FloatArray], FloatArray]) -> BoolArray:
    """Return for each of the markers (C, 3) whether the surface next to it is flat."""
    here = normals(position_m)
    # Along the axis that a normal leans to least.
    axis = np.eye(3)[np.argmin(np.abs(here), axis=1)]
    first = np.cross(here, axis)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
    second = np.cross(here, first)
    is_flat = np.ones(len(position_m), dtype=bool)
    for aside in (first, second, -first, -second):
        turned = normals(position_m + FLAT_M * aside) - here
        is_flat &= np.einsum("ci,ci->c", turned, turned) < TURN**2
        if not is_flat.any():
            break
    return is_flat
