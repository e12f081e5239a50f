# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The coat's gloss: what it mirrors, where it is read from, and what is refused."""

import numpy as np
import pytest
import warp as wp
import yaml

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.optics import kernels
from dotsim_ros.optics.idle import read_description
from dotsim_ros.optics.image import direct_light, leds_of
from dotsim_ros.optics.lighting import Lighting, PointLight
from dotsim_ros.specification import load_sensor

LED = PointLight((0.009, 0.0, 0.0005), (1.0, 0.5, 0.0))


@pytest.fixture(scope="module")
def camera():
    return Camera.from_specification(load_sensor("densetact2").camera)


def light_on(camera, points_m, normals, lighting):
    def upload(array):
        return wp.array(np.asarray(array, dtype=np.float32), dtype=wp.vec3, device="cpu")

    leds = leds_of(lighting, camera, wp.get_device("cpu"))
    position = upload(camera.to_optical(points_m))
    outward = upload(np.asarray(normals) @ camera.pose.rotation())
    return direct_light(position, outward, leds, lighting).numpy()


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_light_is_the_cosine_and_the_lobe_over_the_squared_distance(camera):
    random = np.random.default_rng(0)
    points = 0.01575 * unit(random.normal(loc=(0.0, 0.0, 1.5), size=(300, 3)))
    normals = unit(points / 0.01575 + 0.4 * random.standard_normal((300, 3)))
    away = points - np.array(LED.position_m)
    square = np.sum(away**2, axis=1)
    halfway = unit(unit(away) + unit(points - camera.pose.position_m))
    cosine = np.sum(normals * halfway, axis=1)
    lambert = np.maximum(np.sum(normals * unit(away), axis=1), 0.0)
    for gloss, exponent in ((0.0, 80.0), (3.0, 80.0), (1.0, 12.0)):
        lobe = np.where(cosine > 0.0, np.exp(exponent * (cosine - 1.0)), 0.0)
        expected = ((lambert + gloss * lobe) / square)[:, None] * np.array(LED.intensity)
        lighting = Lighting((LED,), gloss=gloss, gloss_exponent=exponent)
        found = light_on(camera, points, normals, lighting)
        # A lobe below a ten thousandth is left out.
        assert np.abs(found - expected).max() < 2e-4 * (1.0 + gloss) / square.min()


@pytest.mark.parametrize("gloss", [0.0, 3.0])
def test_points_are_lit_together_as_one_by_one(camera, gloss):
    random = np.random.default_rng(0)
    # The last eight are not whole, and one point lies in the camera.
    points = 0.01575 * random.standard_normal((301, 3))
    points[3] = 0.0
    lighting = Lighting((LED, PointLight((-0.004, 0.002, 0.001), (0.2, 1.0, 0.4))), gloss=gloss)
    leds = leds_of(lighting, camera, wp.get_device("cpu"))
    position, outward = (
        wp.array(array.astype(np.float32), dtype=wp.vec3, device="cpu")
        for array in (points, unit(random.standard_normal(points.shape)))
    )
    one_by_one = wp.empty_like(position)
    wp.launch(
        kernels.irradiate,
        dim=len(points),
        inputs=[position, outward, leds, lighting.gloss, lighting.gloss_exponent],
        outputs=[one_by_one],
        device="cpu",
    )
    together = direct_light(position, outward, leds, lighting)
    assert np.array_equal(together.numpy(), one_by_one.numpy())
    assert np.count_nonzero(together.numpy()) > 300


def test_coat_that_turns_an_led_into_the_camera_is_brightest(camera):
    point = np.array([0.0, 0.0, 0.012])
    halfway = unit(unit(point - LED.position_m) + unit(point - camera.pose.position_m))
    lighting = Lighting((LED,), gloss=3.0)
    tilts = np.radians(np.arange(-60, 61, 2))
    across = unit(np.cross(halfway, np.cross([1.0, 0.0, 0.0], halfway)))
    normals = np.cos(tilts)[:, None] * halfway + np.sin(tilts)[:, None] * across
    brightness = light_on(camera, np.tile(point, (len(tilts), 1)), normals, lighting)[:, 0]
    assert abs(np.degrees(tilts[np.argmax(brightness)])) <= 2.0


@pytest.mark.parametrize(
    ("values", "message"),
    [({"gloss": -0.1}, "gloss is -0.1"), ({"gloss_exponent": 0.0}, "gloss_exponent is 0.0")],
)
def test_lights_that_cannot_be_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        Lighting((LED,), **values)


def test_gloss_is_read_from_beside_the_idle_image(tmp_path):
    path = tmp_path / "idle.yaml"
    path.write_text(yaml.safe_dump({"lighting": {"radius_m": 0.009, "gloss": 2, "exponent": 0.4}}))
    lighting, _ = read_description(path).lights()
    assert (lighting.gloss, lighting.gloss_exponent, lighting.exponent) == (2.0, 80.0, 0.4)
