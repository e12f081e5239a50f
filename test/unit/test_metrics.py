# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The metrics against closed forms: shifted planes and spheres, and what samples alone give."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dotsim_ros.geometry.skin_mesh import SkinMesh, dome_skin, flat_pad_skin
from dotsim_ros.twin.surface_metrics import (
    SAMPLE_COUNT,
    along_surface,
    cloud_distances,
    earth_mover_distance,
    relative_rms,
    sample_surface,
    surface_distance,
    weighted_rms,
)

FloatArray = NDArray[np.float64]

PAD = flat_pad_skin((0.02, 0.02), 0.004, 0.001)
DOME = dome_skin(0.01575, 0.0009)


def sampled(skin: SkinMesh, seed: int, position_m: FloatArray | None = None) -> FloatArray:
    """Return a sample of a skin, at rest or where it is."""
    position = skin.rest_position_m if position_m is None else position_m
    return sample_surface(position, skin.triangles, SAMPLE_COUNT, np.random.default_rng(seed))


def test_samples_lie_on_the_surface_and_fill_it_evenly() -> None:
    points = sample_surface(PAD.rest_position_m, PAD.triangles, 40_000, np.random.default_rng(0))
    assert np.allclose(points[:, 2], 0.004)
    counts, _, _ = np.histogram2d(
        points[:, 0], points[:, 1], bins=4, range=[[-0.01, 0.01], [-0.01, 0.01]]
    )
    # Of a binomial distribution of 1/16 of 40,000 the standard deviation is 48.
    assert counts.sum() == 40_000
    assert np.abs(counts - 2_500).max() < 5 * 48


def test_large_triangles_get_more_samples_than_small_ones() -> None:
    position = np.array([[0.0, 0, 0], [3, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
    triangles = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)
    points = sample_surface(position, triangles, 20_000, np.random.default_rng(1))
    # Areas are as 3 to 1; the standard deviation of the share is 0.003.
    assert np.mean(points[:, 2] < 0.5) == pytest.approx(0.75, abs=0.015)


def test_same_points_have_no_distance() -> None:
    cloud = sampled(DOME, 0)
    distances = cloud_distances(cloud, cloud[::-1])
    assert distances.chamfer_m == 0.0
    assert distances.significant_chamfer_m == 0.0
    assert distances.earth_mover_m == pytest.approx(0.0, abs=1e-12)
    assert distances.f_score == 1.0


def test_a_shift_across_a_plane_is_every_distance() -> None:
    cloud = sampled(PAD, 0)
    # Closer than any two samples: the nearest of each point is its own image.
    shift = 1e-6
    distances = cloud_distances(cloud, cloud + np.array([0.0, 0.0, shift]))
    assert distances.chamfer_m == pytest.approx(shift, rel=1e-6)
    assert distances.significant_chamfer_m == pytest.approx(shift, rel=1e-6)
    assert distances.earth_mover_m == pytest.approx(shift, rel=1e-6)


def test_earth_mover_of_a_translation_is_its_length() -> None:
    # The mean displacement bounds every assignment from below, and a translation attains it.
    cloud = sampled(DOME, 3)
    assert earth_mover_distance(cloud, cloud + np.array([0.003, 0.0, 0.004])) == pytest.approx(
        0.005
    )


def test_earth_mover_finds_the_best_of_all_assignments() -> None:
    line = np.zeros((50, 3))
    line[:, 0] = np.random.default_rng(0).random(50)
    other = np.zeros((50, 3))
    other[:, 0] = np.random.default_rng(1).random(50)
    # On a line the best assignment is in order.
    expected = np.abs(np.sort(line[:, 0]) - np.sort(other[:, 0])).mean()
    assert earth_mover_distance(line, other) == pytest.approx(expected, rel=1e-9)


def test_significant_chamfer_sees_a_dent_that_the_mean_does_not() -> None:
    cloud = np.zeros((1000, 3))
    cloud[:, 0] = np.arange(1000.0)
    dented = cloud.copy()
    dented[500:510, 2] = 0.4
    distances = cloud_distances(cloud, dented)
    assert distances.significant_chamfer_m == pytest.approx(0.4)
    assert distances.chamfer_m == pytest.approx(0.004)


def test_f_score_counts_points_within_a_millimetre() -> None:
    cloud = np.zeros((100, 3))
    cloud[:, 0] = np.arange(100.0)
    moved = cloud.copy()
    moved[:40, 2] = 0.9e-3
    moved[40:, 2] = 1.1e-3
    assert cloud_distances(cloud, moved).f_score == pytest.approx(0.4)
    assert cloud_distances(cloud, cloud + np.array([0.0, 0.0, 0.5])).f_score == 0.0


def test_two_samples_of_the_dome_are_four_tenths_of_a_millimetre_apart() -> None:
    # Points of density n on a plane have their nearest neighbour at 1 / (2 sqrt(n)).
    area = 2.0 * np.pi * 0.01575**2
    expected = 0.5 * np.sqrt(area / SAMPLE_COUNT)
    distances = cloud_distances(sampled(DOME, 0), sampled(DOME, 1))
    assert distances.chamfer_m == pytest.approx(expected, rel=0.05)
    assert distances.chamfer_m == pytest.approx(0.44e-3, abs=0.02e-3)


@settings(max_examples=20, deadline=None)
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
    assert there.chamfer_m == pytest.approx(back.chamfer_m)
    assert there.significant_chamfer_m == pytest.approx(back.significant_chamfer_m)
    assert there.earth_mover_m == pytest.approx(back.earth_mover_m)
    assert there.f_score == pytest.approx(back.f_score)
    assert 0.0 <= there.chamfer_m <= there.significant_chamfer_m
    # The best assignment is one of nearest neighbours at best.
    assert there.chamfer_m <= there.earth_mover_m + 1e-12


def test_distance_to_a_plane_is_the_height_over_it() -> None:
    random = np.random.default_rng(0)
    points = np.column_stack(
        [random.uniform(-0.009, 0.009, (200, 2)), 0.004 + random.uniform(-2e-3, 2e-3, 200)]
    )
    distance = surface_distance(points, PAD.rest_position_m, PAD.triangles)
    assert distance == pytest.approx(np.abs(points[:, 2] - 0.004), abs=1e-8)


def test_distance_beyond_the_rim_is_to_the_rim() -> None:
    distance = surface_distance(np.array([[0.013, 0.0, 0.008]]), PAD.rest_position_m, PAD.triangles)
    assert distance[0] == pytest.approx(0.005, abs=1e-8)


def test_distance_between_spheres_is_the_difference_of_their_radii() -> None:
    grown = DOME.rest_position_m * (0.01675 / 0.01575)
    above = grown[grown[:, 2] > 0.002]
    distance = surface_distance(above, DOME.rest_position_m, DOME.triangles)
    # A vertex of the grown dome lies over a vertex of the other one.
    assert distance == pytest.approx(np.full(len(above), 1e-3), abs=2e-8)


def test_sliding_along_the_surface_is_no_distance_to_it() -> None:
    slid = PAD.rest_position_m + np.array([0.0004, 0.0002, 0.0])
    inner = np.all(np.abs(slid[:, :2]) < 0.009, axis=1)
    distance = surface_distance(slid[inner], PAD.rest_position_m, PAD.triangles)
    assert distance.max() < 1e-8


def test_weights_count() -> None:
    assert weighted_rms(np.array([3.0, 4.0]), np.array([1.0, 1.0])) == pytest.approx(12.5**0.5)
    assert weighted_rms(np.array([3.0, 4.0]), np.array([0.0, 2.0])) == 4.0


def test_along_surface_removes_what_is_normal() -> None:
    normal = np.array([[0.0, 0.6, 0.8]])
    assert along_surface(2.0 * normal, normal) == pytest.approx(np.zeros((1, 3)), abs=1e-12)
    assert along_surface(np.array([[5.0, 0.0, 0.0]]), normal) == pytest.approx(
        np.array([[5.0, 0.0, 0.0]])
    )


def test_relative_error_is_a_share_of_what_was_measured() -> None:
    measured = np.array([[1.0, 2.0, -2.0], [0.0, 0.0, 4.0]])
    assert relative_rms(0.1 * measured, measured) == pytest.approx(0.1)
    assert relative_rms(measured, np.zeros_like(measured)) is None


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (np.zeros((3, 3)), np.zeros((4, 3)), "3 and 4 points"),
        (np.zeros((3, 2)), np.zeros((3, 2)), r"expected \(N, 3\)"),
        (np.zeros((0, 3)), np.zeros((0, 3)), r"expected \(N, 3\)"),
        (np.full((3, 3), np.nan), np.zeros((3, 3)), "not finite"),
    ],
)
def test_bad_clouds_are_refused(first: FloatArray, second: FloatArray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cloud_distances(first, second)


def test_surface_that_cannot_be_sampled_is_refused() -> None:
    flat = np.zeros_like(PAD.rest_position_m)
    for position in (flat, np.full_like(flat, np.nan)):
        with pytest.raises(ValueError, match="cannot be sampled"):
            sampled(PAD, 0, position)


def test_weights_of_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match="the weights sum to zero, expected a positive sum"):
        weighted_rms(np.ones(3), np.zeros(3))
