# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The skins: on their surface, closed, well shaped, within the spacing, and facing outwards."""

import numpy as np
import pytest

from dotsim_ros.geometry.skin_mesh import (
    dome_skin,
    face_vectors,
    flat_pad_skin,
    skin_of_triangles,
    vertex_normals,
)

RADIUS_M = 0.01575


def edges_of(mesh):
    pairs = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    return np.unique(np.sort(pairs, axis=1), axis=0, return_counts=True)


def edge_lengths(mesh):
    edges, _ = edges_of(mesh)
    start, end = mesh.rest_position_m[edges[:, 0]], mesh.rest_position_m[edges[:, 1]]
    return np.linalg.norm(end - start, axis=1)


def smallest_angle_deg(mesh):
    corner = mesh.rest_position_m[mesh.triangles]
    ahead = np.roll(corner, -1, axis=1) - corner
    behind = np.roll(corner, 1, axis=1) - corner
    cosine = np.sum(ahead * behind, axis=2) / (
        np.linalg.norm(ahead, axis=2) * np.linalg.norm(behind, axis=2)
    )
    return np.degrees(np.arccos(cosine)).min()


@pytest.mark.parametrize("spacing_m", [0.5e-3, 2.0e-3])
def test_dome_keeps_the_spacing_with_nearly_equilateral_triangles(spacing_m):
    mesh = dome_skin(RADIUS_M, spacing_m)
    lengths = edge_lengths(mesh)
    assert lengths.max() <= spacing_m
    # Not finer than needed either: an even frequency is at most two steps off.
    assert lengths.max() > 0.75 * spacing_m
    assert smallest_angle_deg(mesh) > 50.0


def test_dome_is_a_disc_whose_rim_is_the_base_ring():
    mesh = dome_skin(RADIUS_M, 1.0e-3)
    edges, uses = edges_of(mesh)
    rim = np.unique(edges[uses == 1])
    assert np.all(uses <= 2)
    assert mesh.vertex_count - len(edges) + len(mesh.triangles) == 1
    assert np.array_equal(rim, np.nonzero(mesh.on_base)[0])
    assert np.all(mesh.rest_position_m[mesh.on_base, 2] == 0.0)
    assert np.all(mesh.rest_position_m[~mesh.on_base, 2] > 0.0)
    assert np.unique(mesh.triangles).size == mesh.vertex_count


def test_dome_lies_on_its_sphere_and_faces_outwards():
    mesh = dome_skin(RADIUS_M, 0.5e-3)
    outward = mesh.rest_position_m / RADIUS_M
    assert np.linalg.norm(outward, axis=1) == pytest.approx(1.0, abs=1e-12)
    normals = vertex_normals(mesh.rest_position_m, mesh.triangles)
    angle = np.degrees(np.arccos(np.clip(np.sum(normals * outward, axis=1), -1.0, 1.0)))
    assert angle[~mesh.on_base].max() < 0.1
    # The rim sees the triangles of one side only.
    assert angle[mesh.on_base].max() < 1.0


def test_dome_areas_sum_to_the_hemisphere():
    mesh = dome_skin(RADIUS_M, 0.5e-3)
    assert mesh.rest_area_m2.sum() == pytest.approx(2.0 * np.pi * RADIUS_M**2, rel=3e-4)
    assert mesh.rest_area_m2.min() > 0.0


def test_pad_is_flat_and_whole():
    mesh = flat_pad_skin((0.020, 0.025), 0.004, 0.7e-3)
    edges, uses = edges_of(mesh)
    assert edge_lengths(mesh).max() <= 0.7e-3 + 1e-15
    assert mesh.vertex_count - len(edges) + len(mesh.triangles) == 1
    assert np.all(uses <= 2)
    assert np.all(mesh.rest_position_m[:, 2] == 0.004)
    assert mesh.rest_position_m.min(axis=0)[:2] == pytest.approx([-0.010, -0.0125])
    assert mesh.rest_position_m.max(axis=0)[:2] == pytest.approx([0.010, 0.0125])
    assert np.all(face_vectors(mesh.rest_position_m, mesh.triangles)[:, 2] > 0.0)
    assert mesh.rest_area_m2.sum() == pytest.approx(0.020 * 0.025)
    assert not mesh.on_base.any()


def test_normals_of_a_vertex_without_area_are_zero():
    position = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [5.0, 5.0, 5.0]])
    triangles = np.array([[0, 1, 2], [3, 3, 3]], dtype=np.int32)
    normals = vertex_normals(position, triangles)
    assert normals == pytest.approx(np.array([[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 0]]))


@pytest.mark.parametrize("spacing_m", [0.0, 0.01, float("nan")])
def test_senseless_spacings_are_refused(spacing_m):
    with pytest.raises(ValueError, match="spacing"):
        dome_skin(RADIUS_M, spacing_m)
    with pytest.raises(ValueError, match="spacing"):
        flat_pad_skin((0.015, 0.015), 0.004, spacing_m)


@pytest.mark.parametrize(
    ("position", "triangles", "message"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], "expected \\(V, 3\\)"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], "finite"),
        (np.zeros((3, 3)), [[0, 1]], "expected \\(T, 3\\)"),
        (np.zeros((3, 3)), [[0.0, 1.0, 2.0]], "integers"),
        (np.zeros((3, 3)), [[0, 1, 3]], "expected 0 to 2"),
    ],
)
def test_broken_meshes_are_refused(position, triangles, message):
    with pytest.raises(ValueError, match=message):
        skin_of_triangles(position, triangles)
