# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The tiles of images: what they compare, with sign and place, and their noise."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from dotsim_ros.gap.images.tiles import NAMES, SHARPNESS, SHIFTS, TileMeter, tile_grid

HEIGHT, WIDTH = 120, 160
LIT = np.hypot(*np.meshgrid(np.arange(WIDTH) - 80.0, np.arange(HEIGHT) - 60.0)) < 58.0


def pattern(*, shift_x=0.0, shift_y=0.0):
    """Return a random pattern (H, W, 3), moved by a few pixels."""
    random = np.random.default_rng(3)
    wide = cv2.GaussianBlur(random.standard_normal((HEIGHT + 16, WIDTH + 16)), (0, 0), 2.0)
    moved = ndimage.shift(wide, (shift_y, shift_x), order=5)[8:-8, 8:-8]
    grey = 110.0 + 150.0 * moved
    return np.stack([grey, 0.8 * grey, 0.6 * grey], axis=-1)


@pytest.fixture(scope="module")
def meter():
    return TileMeter(tile_grid(LIT), pattern())


def test_tiles_lie_inside_the_lit_disc_and_know_their_place():
    grid = tile_grid(LIT)
    assert 20 <= len(grid) < 48
    assert not np.any(grid.tile[~LIT] >= 0)
    np.testing.assert_array_equal(
        grid.count, np.bincount(grid.tile[grid.tile >= 0], minlength=len(grid))
    )
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    for number in (0, len(grid) - 1):
        inside = grid.tile == number
        np.testing.assert_allclose(grid.centre_px[number], [x[inside].mean(), y[inside].mean()])
    # Row by row from the top left.
    assert grid.centre_px[0, 1] < grid.centre_px[-1, 1]


def test_a_gain_shows_in_colour_and_contrast_and_not_as_motion(meter):
    reference = pattern()[None]
    found = meter.difference(1.1 * reference, reference)
    np.testing.assert_allclose(found[..., :3], 0.1 * meter.colour(reference))
    np.testing.assert_allclose(found[..., SHARPNESS], 0.1)
    np.testing.assert_allclose(found[..., SHIFTS], 0.0, atol=1e-9)


@pytest.mark.parametrize(("shift_x", "shift_y"), [(0.4, 0.0), (0.0, -0.4), (0.3, 0.2)])
def test_a_pattern_that_moves_is_seen_to_move_where_it_does(meter, shift_x, shift_y):
    moved = pattern(shift_x=shift_x, shift_y=shift_y)[None]
    found = meter.difference(moved, pattern()[None])[0, :, SHIFTS]
    np.testing.assert_allclose(np.median(found, axis=0), [shift_x, shift_y], atol=0.03)
    np.testing.assert_allclose(found, np.tile([shift_x, shift_y], (len(found), 1)), atol=0.1)


def test_a_change_in_one_tile_shows_there_alone(meter):
    inside = meter.grid.tile == 7
    changed = pattern()
    changed[inside] += 5.0
    found = meter.difference(changed[None], pattern()[None])[0]
    expected = np.zeros(len(meter.grid))
    expected[7] = 5.0
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-9)


def test_several_films_are_compared_as_one_by_one(meter):
    films = [np.stack([pattern(shift_x=x), 0.9 * pattern(shift_x=x)]) for x in (0.2, 0.5)]
    reference = np.stack([pattern(), pattern(shift_y=0.5)])
    several = meter.differences(films, meter.references(reference))
    for found, film in zip(several, films, strict=True):
        np.testing.assert_array_equal(found, meter.difference(film, reference))


def test_bytes_are_compared_without_wrapping_around(meter):
    low = np.full((1, HEIGHT, WIDTH, 3), 10, dtype=np.uint8)
    high = np.full((1, HEIGHT, WIDTH, 3), 250, dtype=np.uint8)
    np.testing.assert_allclose(meter.difference(low, high)[..., :3], -240.0)


def test_a_tile_without_texture_stays_finite():
    flat = np.full((HEIGHT, WIDTH, 3), 90.0)
    meter = TileMeter(tile_grid(LIT), flat)
    found = meter.difference((flat + 1.0)[None], flat[None])
    assert np.all(np.isfinite(found))
    np.testing.assert_allclose(found[..., SHIFTS], 0.0, atol=1e-6)


def test_noise_is_that_of_single_images(meter):
    random = np.random.default_rng(0)
    clean = pattern()
    deviation = 2.0
    many = clean + deviation * random.standard_normal((400, HEIGHT, WIDTH, 3))
    expected = meter.difference(many, np.broadcast_to(clean, many.shape)).std(axis=0)
    # White noise in the colours has a closed form too.
    np.testing.assert_allclose(expected[:, 0], deviation / np.sqrt(meter.grid.count), rtol=0.15)
    found = meter.noise(many[:5])
    np.testing.assert_allclose(found.mean(axis=0), expected.mean(axis=0), rtol=0.3)
    assert found.shape == (len(meter.grid), len(NAMES))
