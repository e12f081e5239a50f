# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor with another idle image, and what its frames say of the skin."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from dotsim_ros.gel.make import GelFrame, skin_of
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Wrench
from dotsim_ros.geometry.skin_mesh import vertex_normals
from dotsim_ros.io.files import given_path, parameter_path
from dotsim_ros.optics.idle import LitDisc
from dotsim_ros.optics.pattern import idle_frame_of
from dotsim_ros.optics.renderer import SkinRenderer
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


@pytest.mark.parametrize(("width", "height"), [(160, 120), (1000, 750)])
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
        (np.full((240, 320, 3), 0.5, np.float32), "uint8"),
    ],
    ids=["dark", "float"],
)
def test_idle_image_that_shows_no_gel_is_refused_and_changes_nothing(sensor, image, message):
    before = sensor.idle_image.copy()
    with pytest.raises(ValueError, match=message):
        sensor.set_idle_image(image)
    assert np.array_equal(sensor.idle_image, before)


def misfit(sensor, **camera):
    """Return why the idle image of a sensor's file does not fit its camera, with changes of it."""
    changed = replace(sensor, camera=replace(sensor.camera, **camera))
    seen_by, skin = Camera.from_specification(changed.camera), skin_of(sensor.gel)
    sees_gel = SkinRenderer(seen_by, skin).render(skin.rest_position_m).mask
    idle = idle_frame_of(changed, seen_by)
    return idle.misfit(sees_gel, changed.camera.half_height_angle_deg)


def shipped():
    return [load_sensor(path.stem) for path in sorted(parameter_path("sensors").glob("*.yaml"))]


def test_the_idle_images_of_shipped_sensors_fit_their_cameras():
    assert {sensor.name: misfit(sensor) for sensor in shipped()} == {
        sensor.name: "" for sensor in shipped()
    }
    dome = load_sensor("densetact2")
    assert misfit(dome, idle_image="images/densetact_real_idle.png") == ""


@pytest.mark.fault("sensor and YAML files", "a lens that the idle photograph was not taken through")
@pytest.mark.parametrize("angle_deg", [15.0, 35.0])
def test_a_photograph_through_another_lens_is_warned_of(angle_deg, answered):
    pad = load_sensor("gelsight_mini")
    camera = replace(pad.camera, half_height_angle_deg=angle_deg)
    with pytest.warns(
        UserWarning, match=rf"lens that sees 23\.2 degrees .* sees {angle_deg:g}"
    ) as told:
        TactileSensor.load(replace(pad, camera=camera))
    answered(f"a warning: {told[0].message}")


def test_a_photograph_of_another_view_is_told_by_where_it_is_lit(tmp_path, sensor):
    pad = load_sensor("gelsight_mini")
    bare = tmp_path / "idle.png"
    bare.write_bytes(given_path(pad.camera.idle_image).read_bytes())
    assert misfit(pad, idle_image=str(bare)) == ""
    wide = misfit(pad, idle_image=str(bare), half_height_angle_deg=35.0)
    assert wide == "in 50% of its pixels it is lit where the camera sees no gel"
    assert "lit where" in misfit(pad, quaternion_xyzw=(0.17364818, 0.0, 0.0, 0.98480775))
    assert "lit where" in misfit(pad, position_m=(0.0, 0.0, -0.03))
    assert "dark where" in misfit(pad, idle_image="images/densetact2_idle.png")
    with pytest.warns(UserWarning, match="dark where the camera sees gel"):
        sensor.set_idle_image(disc_image(320, 240, (159.5, 119.5), 80.0, (200, 100, 50)))


def test_frame_has_the_skins_normals_in_the_base_frame(sensor):
    rest_m = sensor.skin.rest_position_m
    distance_m = np.linalg.norm(rest_m - np.array([0.004, 0.002, 0.015]), axis=1)
    skin_m = rest_m - 0.002 * np.exp(-((distance_m / 0.003) ** 2))[:, None] * [0.2, 0.1, 0.97]
    frame = seen(sensor, skin_m)
    expected = vertex_normals(skin_m, sensor.skin.triangles)
    assert frame.skin_normal.dtype == np.float64
    assert np.abs(frame.skin_normal - expected).max() < 1e-5
    assert np.degrees(np.arccos(np.sum(expected * rest_m, axis=1).min() / 0.01575)) > 20.0
