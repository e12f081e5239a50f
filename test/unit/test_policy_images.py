# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a policy sees of an image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from dotsim_ros.control.policy.examples import moved_crop, moved_position
from dotsim_ros.control.policy.images import (
    CHANNEL_COUNT,
    PolicyInput,
    PolicyView,
    fingerprint,
)

RANDOM = np.random.default_rng(5)
COARSE = RANDOM.integers(40, 200, (24, 32, 3), dtype=np.uint8)
IDLE = cv2.resize(COARSE, (640, 480), interpolation=cv2.INTER_CUBIC)


def spotted(x: int, y: int) -> np.ndarray:
    """Return the idle image with a bright spot."""
    image = IDLE.copy()
    cv2.circle(image, (x, y), 20, (255, 255, 255), cv2.FILLED)
    return image


def test_the_crop_is_the_middle_square():
    view = PolicyView((480, 640), share=0.7, side_px=112)
    image = np.zeros((480, 640, 3), dtype=np.uint8)
    # The square reaches from row 72 to 408 and from column 152 to 488.
    image[72:408, 152:488] = 200
    assert np.all(view.crop(image) == 200)
    image[73:407, 153:487] = 0
    edge = view.crop(image)
    assert np.all(edge[1:-1, 1:-1] == 0)
    assert edge[0].min() > 50


def test_images_of_another_size_but_the_same_view_show_the_same():
    view = PolicyView((480, 640), side_px=96)
    half = cv2.resize(IDLE, (320, 240), interpolation=cv2.INTER_AREA)
    difference = view.crop(IDLE).astype(int) - view.crop(half)
    assert np.abs(difference).mean() < 2.0


def test_numbers_out_of_range_are_refused():
    for wrong in ({"share": 1.5}, {"side_px": 8}, {"image_shape": (1, 1)}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            PolicyView(**wrong)


def test_the_change_of_an_untouched_sensor_is_zero_and_does_not_depend_on_the_light():
    view = PolicyView(side_px=96)
    bright = PolicyInput(view.crop(IDLE))
    assert bright(view.crop(IDLE)).shape == (CHANNEL_COUNT, 96, 96)
    assert np.all(bright(view.crop(IDLE))[:3] == 0.0)
    dim = (0.6 * IDLE).astype(np.uint8)
    dim_spot = (0.6 * spotted(320, 240)).astype(np.uint8)
    change = bright(view.crop(spotted(320, 240)))[:3]
    dimmed = PolicyInput(view.crop(dim))(view.crop(dim_spot))[:3]
    assert np.abs(change).max() > 1.0
    assert np.abs(change - dimmed).max() < 0.15 * np.abs(change).max()


def test_a_turned_or_mirrored_crop_shows_the_place_turned_or_mirrored():
    view = PolicyView((480, 480), share=1.0, side_px=96)
    idle = IDLE[:, 80:560]
    spot = idle.copy()
    place = np.array([100.0, 40.0])
    centre = 239.5
    cv2.circle(spot, (int(centre + place[0]), int(centre + place[1])), 12, (255, 255, 255), -1)
    for symmetry in range(8):
        before = moved_crop(view.crop(idle), symmetry).astype(int)
        now = moved_crop(view.crop(spot), symmetry).astype(int)
        weight = np.abs(now - before).sum(axis=2)
        rows, columns = np.mgrid[0:96, 0:96]
        found = 5.0 * np.array(
            [
                np.average(columns, weights=weight) - 47.5,
                np.average(rows, weights=weight) - 47.5,
            ]
        )
        expected = moved_position(np.array([*place, 7.0]), symmetry)
        assert expected[2] == 7.0
        np.testing.assert_allclose(found, expected[:2], atol=3.0)


def test_a_fingerprint_tells_contact_from_another_sensor():
    rest = fingerprint(IDLE, IDLE)
    assert rest.shape == (96,)
    touched = fingerprint(spotted(320, 240), IDLE)
    other = fingerprint(np.rot90(IDLE, 2).copy(), IDLE)
    lit, change = slice(0, 48), slice(48, 96)
    np.testing.assert_array_equal(rest[change], 0.0)
    np.testing.assert_array_equal(touched[lit], rest[lit])
    assert np.count_nonzero(touched[change] > 0.3) < 8
    assert np.count_nonzero(other[change] > 0.3) > 40
