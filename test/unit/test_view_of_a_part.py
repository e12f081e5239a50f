# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A part of the camera's image, or another number of its pixels, rendered rather than resized."""

import cv2
import numpy as np
import pytest

from dotsim_ros import Pose, TactileSensor
from dotsim_ros.optics.depth import DepthConversion, radius_bytes
from dotsim_ros.optics.idle import IdleFrame, part_of_idle
from dotsim_ros.optics.lighting import Vignetting


@pytest.fixture(scope="module")
def sensor():
    return TactileSensor.load("densetact2")


@pytest.fixture(scope="module")
def pressed(sensor):
    return sensor.press(Pose.above_apex(depth_m=0.001))


def seen(sensor, gel, *view):
    sensor.set_view(*view)
    try:
        return sensor.camera, sensor.see(gel, None)
    finally:
        sensor.set_view()


def test_a_part_shows_what_the_whole_shows_there(sensor, pressed):
    camera, whole = seen(sensor, pressed)
    part_camera, part = seen(sensor, pressed, (120, 40, 400, 400), (400, 400))
    assert part.image.shape == (400, 400, 3)
    change = np.abs(whole.image[40:440, 120:520].astype(float) - part.image)
    assert np.quantile(change, 0.9999) <= 1.0
    assert change.max() <= 3.0
    np.testing.assert_allclose(part.depth_m, whole.depth_m[40:440, 120:520], rtol=0, atol=1e-7)
    point = np.array([0.002, -0.001, 0.012])
    assert part_camera.project(point) == pytest.approx(camera.project(point) - [120, 40])
    assert np.array_equal(seen(sensor, pressed)[1].image, whole.image)


def test_another_size_is_rendered_at_its_own_rays(sensor, pressed):
    with pytest.raises(ValueError, match="aspect ratio"):
        sensor.set_view(None, (320, 180))
    assert (sensor.camera.width, sensor.camera.height) == (640, 480)
    whole = seen(sensor, pressed)[1]
    small = seen(sensor, pressed, None, (320, 240))[1]
    resized = cv2.resize(whole.image, (320, 240), interpolation=cv2.INTER_AREA).astype(float)
    assert np.abs(resized - small.image).mean() < 1.0
    # The middle of four pixels of the larger image.
    four = (whole.depth_m[0::2, 0::2] + whole.depth_m[1::2, 1::2]) / 2.0
    assert np.nanmax(np.abs(four - small.depth_m)[60:180, 80:240]) < 2e-5


def test_the_vignetting_of_a_part_is_that_of_the_whole(sensor):
    vignetting = Vignetting((-0.3, 0.05))
    camera = sensor.camera
    cut = vignetting.brightness(camera)[40:440, 120:520]
    part = camera.part(120, 40, 400, 400)
    found = vignetting.of_part(400 / 480).brightness(part)
    np.testing.assert_allclose(found, cut, rtol=0, atol=1e-6)


def test_samples_between_the_pixels_go_along():
    random = np.random.default_rng(1)
    fine = cv2.resize(
        random.integers(60, 200, (24, 24, 3), np.uint8), (239, 239), interpolation=cv2.INTER_CUBIC
    )
    idle = IdleFrame(np.ascontiguousarray(fine[::2, ::2]), fine=fine)
    part = part_of_idle(idle, (20, 30, 60, 60), (60, 60))
    assert np.array_equal(part.fine[::2, ::2], part.image)
    assert np.abs(part.image.astype(float) - idle.image[30:90, 20:80])[5:-5, 5:-5].max() <= 1.0


def test_a_range_is_a_depth_along_the_axis_and_a_radius_of_the_dome(sensor):
    sensor.reset()
    camera, untouched = seen(sensor, sensor.press(None))
    conversion = DepthConversion(camera)
    rays, _ = camera.rays()
    axial_m = conversion.axial_m(untouched.depth_m)
    ahead = rays[..., 2] > 0.0
    assert np.isnan(axial_m[~ahead]).all()
    assert np.isfinite(untouched.depth_m[~ahead]).any()
    points_m = untouched.depth_m[..., None] * rays
    np.testing.assert_allclose(axial_m[ahead], points_m[..., 2][ahead], rtol=0, atol=1e-7)
    on_dome = np.isfinite(untouched.depth_m)
    radius_m = conversion.radius_m(untouched.depth_m)
    assert np.abs(radius_m[on_dome] - 0.01575).max() < 2e-5
    steps = radius_bytes(radius_m, (0.01223, 0.01688))
    assert set(np.unique(steps[~on_dome])) == {0}
    # As a reader of the driver's imgDepth takes it.
    read_mm = steps[on_dome] / 256.0 * (16.88 - 12.23) + 12.23
    assert np.abs(read_mm - 15.75).max() < 0.03
