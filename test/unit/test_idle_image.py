# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor with another idle image, and what its frames say of the skin."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from dotsim_ros.gel.make import GelFrame
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Wrench
from dotsim_ros.geometry.skin_mesh import vertex_normals
from dotsim_ros.optics.idle import LitDisc
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import load_sensor


@pytest.fixture(scope="module")
def sensor():
    # Half the pixels; the explicit gel has no tables to compute.
    sensor = load_sensor("densetact2")
    camera = replace(sensor.camera, width=320, height=240, principal_point_px=(159.5, 119.5))
    solver = replace(sensor.solver, method="explicit")
    return TactileSensor(
        replace(sensor, camera=camera, solver=solver), indenter=load_indenter("sphere_4mm")
    )


def gel_at(skin_m):
    return GelFrame(skin_m, Wrench(np.zeros(3), np.zeros(3)), 0.0, True, {})


def seen(sensor, skin_m):
    return sensor.see(gel_at(skin_m), None)


def disc_image(width, height, centre, radius, colour):
    rows, columns = np.mgrid[0:height, 0:width]
    lit = np.hypot(columns - centre[0], rows - centre[1]) < radius
    return (lit[..., None] * np.array(colour)).astype(np.uint8)


def test_idle_image_of_the_cameras_size_is_taken_as_it_is(sensor):
    image = disc_image(320, 240, (159.5, 119.5), 110.0, (200, 100, 50))
    given = image.copy()
    sensor.set_idle_image(given)
    given[:] = 0
    assert np.array_equal(sensor.idle_image, image)
    assert np.array_equal(seen(sensor, sensor.skin.rest_position_m).image, image)


@pytest.mark.parametrize(("width", "height"), [(640, 480), (160, 120), (1000, 750)])
def test_idle_image_of_another_resolution_is_brought_to_the_camera(sensor, width, height):
    scale = width / 320.0
    centre = (0.5 * (width - 1), 0.5 * (height - 1))
    image = disc_image(width, height, centre, 110.0 * scale, (200, 100, 50))
    sensor.set_idle_image(image)
    shown = seen(sensor, sensor.skin.rest_position_m).image
    assert shown.shape == (240, 320, 3)
    expected = disc_image(320, 240, (159.5, 119.5), 110.0, (200, 100, 50))
    eroded = cv2.erode(expected, np.ones((9, 9), np.uint8)) > 0
    assert np.array_equal(shown[eroded], expected[eroded])
    assert not shown[cv2.dilate(expected, np.ones((9, 9), np.uint8)) == 0].any()


def test_idle_image_of_another_view_needs_its_disc(sensor):
    square = disc_image(200, 200, (104.0, 96.0), 80.0, (90, 180, 60))
    before = sensor.idle_image.copy()
    with pytest.raises(ValueError, match=r"200x200 .* say where its lit disc lies"):
        sensor.set_idle_image(square)
    assert np.array_equal(sensor.idle_image, before)
    sensor.set_idle_image(square, disc=LitDisc((104.0, 96.0), 80.0, 86.0))
    rows, columns = np.mgrid[0:240, 0:320]
    inner = np.hypot(columns - 159.5, rows - 119.5) < 110.0
    assert np.all(sensor.idle_image[inner] == [90, 180, 60])


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((240, 320, 3), np.uint8), "grey level"),
        (np.full((240, 320), 90, np.uint8), "uint8"),
        (np.full((240, 320, 3), 0.5, np.float32), "uint8"),
    ],
    ids=["dark", "grey", "float"],
)
def test_idle_image_that_shows_no_gel_is_refused_and_changes_nothing(sensor, image, message):
    before = sensor.idle_image.copy()
    with pytest.raises(ValueError, match=message):
        sensor.set_idle_image(image)
    assert np.array_equal(sensor.idle_image, before)


def test_frame_has_the_skins_normals_in_the_base_frame(sensor):
    rest_m = sensor.skin.rest_position_m
    distance_m = np.linalg.norm(rest_m - np.array([0.004, 0.002, 0.015]), axis=1)
    skin_m = rest_m - 0.002 * np.exp(-((distance_m / 0.003) ** 2))[:, None] * [0.2, 0.1, 0.97]
    frame = seen(sensor, skin_m)
    expected = vertex_normals(skin_m, sensor.skin.triangles)
    assert frame.skin_normal.dtype == np.float64
    assert np.abs(frame.skin_normal - expected).max() < 1e-5
    assert np.degrees(np.arccos(np.sum(expected * rest_m, axis=1).min() / 0.01575)) > 20.0
