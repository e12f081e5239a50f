# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Cameras: there and back, against OpenCV, beyond 90 degrees, and from a sensor's file."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.camera import Camera, FisheyeCamera, PinholeCamera
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import load_sensor

HALF = np.sqrt(0.5)


def make_camera(distortion=(0.0, 0.0, 0.0, 0.0), pose=None):
    return FisheyeCamera(64, 48, 16.0, (31.0, 24.5), distortion, pose or Pose())


@settings(deadline=None)
@given(
    x=st.floats(-0.5, 63.5),
    y=st.floats(-0.5, 47.5),
    k1=st.floats(-0.01, 0.05),
    k2=st.floats(-0.0002, 0.01),
)
def test_unprojected_pixels_project_to_themselves(x, y, k1, k2):
    camera = make_camera((k1, k2, 0.0, 0.0))
    direction = camera.unproject([x, y])
    assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-12)
    assert camera.project_optical(direction * 0.03) == pytest.approx([x, y], abs=1e-9)


def test_a_distortion_too_small_to_matter_changes_nothing():
    plain, tiny = make_camera(), make_camera((0.0, 5e-324, 0.0, 0.0))
    assert tiny.unproject([3.0, 4.0]) == pytest.approx(plain.unproject([3.0, 4.0]), abs=1e-15)


FISHEYE = make_camera((0.03, -0.01, 0.002, -0.0005))
PINHOLE = PinholeCamera(64, 48, 40.0, (31.0, 24.5), (-0.25, 0.08, 0.004, -0.006))


@pytest.mark.parametrize("aspect", [1.0, 1.08])
@pytest.mark.parametrize(
    ("camera", "project"),
    [(FISHEYE, cv2.fisheye.projectPoints), (PINHOLE, cv2.projectPoints)],
    ids=["fisheye", "pinhole"],
)
def test_agrees_with_opencv_in_front_of_the_camera(camera, project, aspect):
    camera = replace(camera, pixel_aspect=aspect)
    random = np.random.default_rng(1)
    points = random.uniform([-0.7, -0.6, 0.9], [0.7, 0.6, 1.1], (200, 3))
    if isinstance(camera, FisheyeCamera):
        points = random.normal(size=(200, 3))
        points[:, 2] = np.abs(points[:, 2]) + 0.05
    matrix = np.diag([aspect * camera.focal_px, camera.focal_px, 1.0])
    matrix[:2, 2] = camera.principal_point_px
    expected, _ = project(points[:, None], np.zeros(3), np.zeros(3), matrix, camera.distortion)
    assert camera.project_optical(points) == pytest.approx(expected[:, 0, :], abs=1e-9)
    ahead = camera.unproject(expected[:, 0, :])
    assert ahead == pytest.approx(points / np.linalg.norm(points, axis=1)[:, None], abs=1e-9)


@pytest.mark.parametrize("projection", ["equidistant", "pinhole"])
def test_the_focal_lengths_of_a_calibrated_camera_come_back(projection):
    """By the formulas of docs/api/sensor_fields.md."""
    focal_x, focal_y, height = 412.0, 388.0, 480
    half = 0.5 * height / focal_y
    angle_rad = half if projection == "equidistant" else np.arctan(half)
    section = replace(
        load_sensor("densetact2").camera,
        projection=projection,
        half_height_angle_deg=float(np.degrees(angle_rad)),
        pixel_aspect=focal_x / focal_y,
    )
    camera = Camera.from_specification(section)
    assert camera.focal_xy_px == pytest.approx([focal_x, focal_y])


@pytest.mark.parametrize("name", ["densetact2", "gelsight_mini"])
def test_each_pixel_shows_the_skin_on_its_ray_where_focal_lengths_differ(name):
    sensor = load_sensor(name)
    sensor = replace(sensor, camera=replace(sensor.camera, pixel_aspect=1.1))
    camera, skin = Camera.from_specification(sensor.camera), skin_of(sensor.gel)
    assert camera.focal_xy_px[0] == pytest.approx(1.1 * camera.focal_xy_px[1])
    view = SkinRenderer(camera, skin).render(skin.rest_position_m)
    seen = np.isfinite(view.depth_m)
    y, x = np.nonzero(seen)
    assert seen.mean() > 0.4
    at = camera.project(view.material_point_m[seen])
    assert np.abs(at - np.stack([x, y], axis=1)).max() < 0.02


def test_a_pinhole_unprojects_what_it_images_and_nothing_else():
    directions, valid = PINHOLE.rays()
    assert valid.all()
    y, x = np.mgrid[0:48, 0:64]
    assert PINHOLE.project_optical(directions) == pytest.approx(np.stack([x, y], -1), abs=1e-8)
    assert np.isnan(PINHOLE.project_optical([0.1, 0.0, -1.0])).all()
    # r - 0.3 r^3 turns where r is 1.054, and reaches 0.703 there: 28.1 px.
    turning = replace(PINHOLE, distortion=(-0.3, 0.0, 0.0, 0.0))
    assert np.isfinite(turning.unproject([31.0 + 28.0, 24.5])).all()
    assert np.isnan(turning.unproject([31.0 + 28.3, 24.5])).all()
    assert np.isnan(turning.project_optical([1.1, 0.0, 1.0])).all()


@pytest.mark.parametrize("angle_deg", [0.0, 45.0, 150.0])
def test_image_radius_is_focal_length_times_angle(angle_deg):
    camera = make_camera()
    angle = np.radians(angle_deg)
    pixel = camera.project_optical([np.sin(angle), 0.0, np.cos(angle)])
    assert pixel == pytest.approx([31.0 + 16.0 * angle, 24.5], abs=1e-12)


def test_directions_without_an_image_are_nan():
    # theta - 0.1 theta^3 turns at 1.826 rad, where theta_d is 1.217: 19.5 px.
    camera = make_camera((-0.1, 0.0, 0.0, 0.0))
    directions, valid = camera.rays()
    x, y = np.meshgrid(np.arange(64), np.arange(48))
    radius = np.hypot(x - 31.0, y - 24.5)
    assert camera.widest_angle_rad == pytest.approx(np.sqrt(10.0 / 3.0))
    assert np.array_equal(valid, radius <= 16.0 * np.sqrt(10.0 / 3.0) * 2.0 / 3.0)
    assert np.all(np.isnan(directions[~valid]))
    assert np.all(np.isnan(camera.project_optical([0.1, 0.0, -1.0])))


def test_pose_turns_the_optical_frame_into_the_base_frame():
    # Turned by 90 degrees about x, the optical z axis is the base frame's -y, its y axis +z.
    pose = Pose(np.array([0.0, 0.0, 0.0025]), np.array([HALF, 0.0, 0.0, HALF]))
    camera = make_camera(pose=pose)
    assert camera.project([0.0, -0.01, 0.0025]) == pytest.approx([31.0, 24.5], abs=1e-9)
    lower = camera.project([0.0, -0.01, -0.0075])
    assert lower == pytest.approx([31.0, 24.5 - 16.0 * np.pi / 4.0], abs=1e-9)


def test_scaling_keeps_the_view():
    camera = make_camera((0.02, 0.0, 0.0, 0.0))
    large = camera.scaled(640, 480)
    corner = camera.unproject([-0.5, -0.5])
    assert large.project_optical(corner) == pytest.approx([-0.5, -0.5], abs=1e-9)
    centre = camera.unproject([31.5, 23.5])
    assert large.project_optical(centre) == pytest.approx([319.5, 239.5], abs=1e-9)
    with pytest.raises(ValueError, match="640x480"):
        camera.scaled(640, 500)


@pytest.mark.parametrize(("projection", "angle_deg"), [("equidistant", 86.0), ("pinhole", 30.0)])
def test_sensor_file_sets_the_angle_at_half_the_height(projection, angle_deg):
    section = replace(
        load_sensor("densetact2").camera, projection=projection, half_height_angle_deg=angle_deg
    )
    camera = Camera.from_specification(section)
    direction = camera.unproject([319.5, 239.5 + 240.0])
    assert np.degrees(np.arctan2(direction[1], direction[2])) == pytest.approx(angle_deg)
    assert np.degrees(camera.half_height_angle_rad) == pytest.approx(angle_deg)
    assert camera.pose.position_m == pytest.approx([0.0, 0.0, 0.0025])


def test_a_pinhole_of_a_file_is_no_fisheye():
    with pytest.raises(ValueError, match="at most 80 deg"):
        replace(load_sensor("densetact2").camera, projection="pinhole", half_height_angle_deg=85.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"focal_px": 0.0}, "focal_px"),
        ({"focal_px": float("nan")}, "focal_px"),
        ({"width": 0}, "image size"),
        ({"distortion": (0.0, 0.0)}, "distortion"),
        ({"principal_point_px": (1.0, float("inf"))}, "principal_point_px"),
    ],
)
def test_bad_constants_are_refused(change, message):
    values = {"width": 64, "height": 48, "focal_px": 16.0, "principal_point_px": (31.0, 24.5)}
    with pytest.raises(ValueError, match=message):
        FisheyeCamera(**{**values, **change})
