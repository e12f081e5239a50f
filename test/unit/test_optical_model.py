# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The twin's images: made from its own idle frame, with what effects need to know of them."""

import numpy as np
import pytest
from optical_presses import dented

from dotsim_ros.gap.images.model import TwinCamera, resized
from dotsim_ros.gel.make import skin_of
from dotsim_ros.specification import load_sensor

WIDTH, HEIGHT = 80, 60
STAMP_S = np.array([1.0, 1.1, 1.3])


@pytest.fixture(scope="module")
def sensor():
    return load_sensor("sensor_a")


@pytest.fixture(scope="module")
def model(sensor):
    return TwinCamera(sensor, width=WIDTH, height=HEIGHT)


@pytest.fixture(scope="module")
def film(model, sensor):
    """A skin that stands still, is dented, and is then turned about its axis by 3 degrees."""
    skin = skin_of(sensor.gel)
    dent = dented(skin, np.array([0.0, 0.0, 1.0]), 1.0e-3, 3.0e-3)
    angle = np.radians(3.0)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    return model.film(np.stack([skin.rest_position_m, dent, dent @ turn.T]), STAMP_S, 20.0)


def test_a_skin_at_rest_shows_the_twin_s_own_idle_frame(model, film):
    assert film.pixels.shape == (3, HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(film.pixels[0], model.idle, atol=0.5)
    np.testing.assert_array_equal(film.idle, model.idle)
    np.testing.assert_array_equal(model.idle_film().pixels[0], model.idle)


def test_a_contact_changes_the_image_where_it_is(film):
    change = np.abs(film.pixels[1] - film.pixels[0]).max(axis=2)
    x, y = np.rint(film.centre_px).astype(int)
    assert change[y - 5 : y + 6, x - 5 : x + 6].max() > 5.0
    assert film.pixels.min() >= 0.0
    assert film.pixels.max() <= 255.0
    # Not rounded: the network adds shares of a level.
    assert np.any(film.pixels[1] % 1.0 != 0.0)


def test_a_film_knows_how_far_the_skin_is_and_where_it_faces(model, film):
    x, y = np.rint(film.centre_px).astype(int)
    depth_m = film.depth_m[:, y, x]
    assert depth_m[0] - depth_m[1] == pytest.approx(1.0e-3, rel=0.1)
    # At the apex the skin faces the camera.
    np.testing.assert_allclose(film.normal[0, y, x], [0.0, 0.0, -1.0], atol=0.05)
    np.testing.assert_array_equal(model.idle_film().depth_m[0], film.depth_m[0])
    half = resized(film, WIDTH // 2, HEIGHT // 2)
    assert half.depth_m[0, y // 2, x // 2] == pytest.approx(depth_m[0], rel=0.02)
    length = np.linalg.norm(half.normal, axis=-1)
    assert np.isnan(length[0, 0, 0])
    np.testing.assert_allclose(length[np.isfinite(length)], 1.0, rtol=1e-5)


def test_the_flow_is_that_of_the_skin(film):
    assert not film.flow_px_s[0].any()
    # A turn about an axis nearly that of the camera: pixels move across the radius, by the angle.
    flow = film.flow_px_s[2]
    offset_x, offset_y = 10.0, 0.0
    x, y = np.rint(film.centre_px + np.array([offset_x, offset_y])).astype(int)
    speed = np.radians(3.0) * offset_x / (STAMP_S[2] - STAMP_S[1])
    assert flow[y, x, 1] == pytest.approx(speed, rel=0.2)
    assert abs(flow[y, x, 0]) < 0.2 * speed
    assert not flow[0, 0].any()


def test_a_film_keeps_its_view_at_another_size(film):
    half = resized(film, WIDTH // 2, HEIGHT // 2)
    assert half.pixels.shape == (3, HEIGHT // 2, WIDTH // 2, 3)
    assert half.focal_px == pytest.approx(0.5 * film.focal_px)
    assert half.centre_px == pytest.approx(0.5 * film.centre_px - 0.25)
    np.testing.assert_allclose(half.pixels.mean(), film.pixels.mean(), rtol=1e-3)
    np.testing.assert_allclose(
        np.abs(half.flow_px_s[2]).sum(), np.abs(film.flow_px_s[2]).sum() / 8.0, rtol=0.1
    )
    assert resized(film, WIDTH, HEIGHT) is film


def test_a_image_of_another_shape_is_refused(sensor):
    with pytest.raises(ValueError, match="aspect ratio"):
        TwinCamera(sensor, width=80, height=80)
