# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which markers bear the contact."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros.gel.implicit.contact_points import SPACING_M, ContactPoints, borne
from dotsim_ros.geometry.indenter import Indenter, box_edge, flat_punch, sphere
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin
from dotsim_ros.io.arrays import FloatArray, IndexArray

PUNCH_RADIUS_M = 4.0e-3
GRID_SPACING_M = 2.4e-3


@pytest.fixture(scope="module")
def skin() -> SkinMesh:
    return dome_skin(0.01575, 0.5e-3)


def normals_of(indenter: Indenter, height_m: float, position_m: FloatArray) -> FloatArray:
    step = 1.0e-7
    local = position_m - np.array([0.0, 0.0, height_m])
    return np.stack(
        [
            (indenter.signed_distance(local + d) - indenter.signed_distance(local - d)) / (2 * step)
            for d in step * np.eye(3)
        ],
        axis=1,
    )


def near_the_apex(skin: SkinMesh, reach_m: float) -> IndexArray:
    gap = np.linalg.norm(skin.rest_position_m - skin.apex_m, axis=1)
    return np.flatnonzero(gap < reach_m).astype(np.int32)


def bearers(
    skin: SkinMesh,
    indenter: Indenter,
    reach_m: float = 5.5e-3,
    pressed_m: float = np.inf,
    grid_spacing_m: float = GRID_SPACING_M,
) -> IndexArray:
    marker = near_the_apex(skin, reach_m)
    height = skin.apex_m[2] - 1.0e-3
    return ContactPoints(skin, grid_spacing_m).bearers(
        marker,
        skin.rest_position_m[marker],
        np.isin(marker, near_the_apex(skin, pressed_m)),
        lambda x: normals_of(indenter, height, x),
    )


def test_under_a_flat_face_fewer_bear_for_the_same_area(skin: SkinMesh) -> None:
    bearer = bearers(skin, flat_punch(PUNCH_RADIUS_M, 0.02, 3.0e-4))
    area = ContactPoints(skin, GRID_SPACING_M).area_m2(bearer)
    assert area.sum() == pytest.approx(skin.rest_area_m2.sum())
    inside = near_the_apex(skin, 3.0e-3)
    assert np.count_nonzero(area[inside]) < 0.5 * len(inside)
    alone = area > 0.0
    assert np.array_equal(bearer[alone], np.flatnonzero(alone))
    far = np.linalg.norm(skin.rest_position_m - skin.rest_position_m[bearer], axis=1)
    assert far.max() < SPACING_M


def test_none_bears_for_others_that_is_not_pressed_itself(skin: SkinMesh) -> None:
    every = np.arange(skin.vertex_count)
    bearer = bearers(skin, flat_punch(PUNCH_RADIUS_M, 0.02, 3.0e-4), pressed_m=2.0e-3)
    given = bearer != every
    assert given.any()
    assert np.isin(bearer[given], near_the_apex(skin, 2.0e-3)).all()


def test_on_a_finer_grid_every_marker_bears_its_own(skin: SkinMesh) -> None:
    punch = flat_punch(PUNCH_RADIUS_M, 0.02, 3.0e-4)
    bearer = bearers(skin, punch, grid_spacing_m=2.0e-3)
    assert np.array_equal(bearer, np.arange(skin.vertex_count))


def test_beside_an_edge_every_marker_bears_its_own(skin: SkinMesh) -> None:
    bearer = bearers(skin, flat_punch(PUNCH_RADIUS_M, 0.02, 3.0e-4))
    radius = np.linalg.norm(skin.rest_position_m[:, :2], axis=1)
    ring = np.flatnonzero((radius > PUNCH_RADIUS_M - 0.3e-3) & (radius < PUNCH_RADIUS_M + 0.3e-3))
    assert len(ring) > 20
    assert np.array_equal(bearer[ring], ring)


@pytest.mark.parametrize("indenter", [sphere(PUNCH_RADIUS_M), box_edge([0.02, 0.02, 0.02], 3.0e-4)])
def test_on_a_curved_surface_every_marker_bears_its_own(skin: SkinMesh, indenter: Indenter) -> None:
    bearer = bearers(skin, indenter, 0.8e-3)
    assert np.array_equal(bearer, np.arange(skin.vertex_count))


def test_forces_go_to_those_that_bear() -> None:
    force = np.arange(12.0).reshape(4, 3)
    moved = borne(force, np.array([0, 0, 2, 2]))
    assert np.array_equal(
        moved, [force[0] + force[1], np.zeros(3), force[2] + force[3], np.zeros(3)]
    )
