# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The metrics against closed forms: shifted planes and spheres, and what samples alone give."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dotsim_ros.geometry.mesh_distance import surface_distance
from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin, flat_pad_skin
from dotsim_ros.twin.surface_metrics import (
    SAMPLE_COUNT,
    along_surface,
    cloud_distances,
    earth_mover_distance,
    relative_rms,
    sample_surface,
    weighted_rms,
)

FloatArray = NDArray[np.float64]

PAD = flat_pad_skin((0.02, 0.02), 0.004, 0.001)
DOME = dome_skin(0.01575, 0.0009)


def sampled(skin: SkinMesh, seed: int) -> FloatArray:
    random = np.random.default_rng(seed)
    return sample_surface(skin.rest_position_m, skin.triangles, SAMPLE_COUNT, random)


def test_samples_fill_a_surface_by_area() -> None:
    points = sample_surface(PAD.rest_position_m, PAD.triangles, 40_000, np.random.default_rng(0))
    assert np.allclose(points[:, 2], 0.004)
    edges = [[-0.01, 0.01], [-0.01, 0.01]]
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=4, range=edges)
    # Of a binomial distribution of 1/16 of 40,000 the standard deviation is 48.
    assert counts.sum() == 40_000
    assert np.abs(counts - 2_500).max() < 5 * 48

    position = np.array([[0.0, 0, 0], [3, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
    triangles = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)
    points = sample_surface(position, triangles, 20_000, np.random.default_rng(1))
    # Areas are as 3 to 1; the standard deviation of the share is 0.003.
    assert np.mean(points[:, 2] < 0.5) == pytest.approx(0.75, abs=0.015)
    for spoilt in (0.0 * position, np.full_like(position, np.nan)):
        with pytest.raises(ValueError, match="cannot be sampled"):
            sample_surface(spoilt, triangles, 10, np.random.default_rng(1))


@pytest.mark.parametrize("shift", [0.0, 1e-6])
def test_a_shift_across_a_plane_is_every_distance(shift: float) -> None:
    cloud = sampled(PAD, 0)
    # Closer than any two samples: the nearest of each point is its own image.
    found = cloud_distances(cloud, cloud[::-1] + np.array([0.0, 0.0, shift]))
    for distance in (found.chamfer_m, found.significant_chamfer_m, found.earth_mover_m):
        assert distance == pytest.approx(shift, rel=1e-6, abs=1e-12)
    assert found.f_score == 1.0


def test_earth_mover_finds_the_best_of_all_assignments() -> None:
    # The mean displacement bounds every assignment from below, and a translation attains it.
    cloud = sampled(DOME, 3)
    moved = earth_mover_distance(cloud, cloud + np.array([0.003, 0.0, 0.004]))
    assert moved == pytest.approx(0.005)
    line, other = np.zeros((2, 50, 3))
    line[:, 0], other[:, 0] = (np.random.default_rng(seed).random(50) for seed in (0, 1))
    # On a line the best assignment is in order.
    expected = np.abs(np.sort(line[:, 0]) - np.sort(other[:, 0])).mean()
    assert earth_mover_distance(line, other) == pytest.approx(expected, rel=1e-9)


def test_significant_chamfer_sees_a_dent_and_f_score_counts_points_within_a_millimetre() -> None:
    cloud = np.zeros((1000, 3))
    cloud[:, 0] = np.arange(1000.0)
    dented = cloud.copy()
    dented[500:510, 2] = 0.4
    distances = cloud_distances(cloud, dented)
    assert distances.significant_chamfer_m == pytest.approx(0.4)
    assert distances.chamfer_m == pytest.approx(0.004)
    moved = cloud[:100] + np.where(np.arange(100) < 40, 0.9e-3, 1.1e-3)[:, None] * [0.0, 0.0, 1.0]
    assert cloud_distances(cloud[:100], moved).f_score == pytest.approx(0.4)
    assert cloud_distances(cloud[:100], moved + np.array([0.0, 0.0, 0.5])).f_score == 0.0


def test_two_samples_of_the_dome_are_four_tenths_of_a_millimetre_apart() -> None:
    # Points of density n on a plane have their nearest neighbour at 1 / (2 sqrt(n)).
    expected = 0.5 * np.sqrt(2.0 * np.pi * 0.01575**2 / SAMPLE_COUNT)
    distances = cloud_distances(sampled(DOME, 0), sampled(DOME, 1))
    assert distances.chamfer_m == pytest.approx(expected, rel=0.05)


@settings(max_examples=10, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    shift=st.tuples(*[st.floats(-0.01, 0.01, allow_nan=False) for _ in range(3)]),
)
def test_distances_are_symmetric_and_never_negative(
    seed: int, shift: tuple[float, float, float]
) -> None:
    random = np.random.default_rng(seed)
    first = 0.01 * random.random((40, 3))
    second = 0.01 * random.random((40, 3)) + shift
    there, back = cloud_distances(first, second), cloud_distances(second, first)
    assert list(vars(there).values()) == pytest.approx(list(vars(back).values()))
    assert 0.0 <= there.chamfer_m <= there.significant_chamfer_m
    # The best assignment is one of nearest neighbours at best.
    assert there.chamfer_m <= there.earth_mover_m + 1e-12


def test_distance_to_a_surface_is_to_its_nearest_point() -> None:
    random = np.random.default_rng(0)
    across, height = random.uniform(-0.009, 0.009, (200, 2)), random.uniform(-2e-3, 2e-3, 200)
    points = np.column_stack([across, 0.004 + height])
    distance = surface_distance(points, PAD.rest_position_m, PAD.triangles)
    assert distance == pytest.approx(np.abs(height), abs=1e-8)
    beyond = surface_distance(np.array([[0.013, 0.0, 0.008]]), PAD.rest_position_m, PAD.triangles)
    assert beyond[0] == pytest.approx(0.005, abs=1e-8)
    # A vertex of the grown dome lies over a vertex of the other one.
    grown = DOME.rest_position_m * (0.01675 / 0.01575)
    above = grown[grown[:, 2] > 0.002]
    distance = surface_distance(above, DOME.rest_position_m, DOME.triangles)
    assert distance == pytest.approx(np.full(len(above), 1e-3), abs=2e-8)


def test_means_weigh_area_direction_and_size() -> None:
    assert weighted_rms(np.array([3.0, 4.0]), np.array([1.0, 1.0])) == pytest.approx(12.5**0.5)
    assert weighted_rms(np.array([3.0, 4.0]), np.array([0.0, 2.0])) == 4.0
    with pytest.raises(ValueError, match="the weights sum to zero, expected a positive sum"):
        weighted_rms(np.ones(3), np.zeros(3))
    normal = np.array([[0.0, 0.6, 0.8]])
    along = np.array([[5.0, 0.0, 0.0]])
    assert along_surface(2.0 * normal + along, normal) == pytest.approx(along, abs=1e-12)
    measured = np.array([[1.0, 2.0, -2.0], [0.0, 0.0, 4.0]])
    assert relative_rms(0.1 * measured, measured) == pytest.approx(0.1)
    assert relative_rms(measured, np.zeros_like(measured)) is None
