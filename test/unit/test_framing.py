# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Crop, size and colour order, and the camera that has that image."""

import cv2
import numpy as np
import pytest

from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.nodes.tactile_sim.framing import Framing, encoded_pixels

CAMERA = FisheyeCamera(640, 480, 160.0, np.array([310.0, 250.0]))
WHOLE = {"crop_px": (0, 0, 0, 0), "image_size_px": (0, 0)}


def test_zeros_mean_the_whole_image_without_a_copy():
    framing = Framing.of_camera(CAMERA, **WHOLE)
    image = np.zeros((480, 640, 3), np.uint8)
    assert np.shares_memory(framing.apply(image), image)
    camera = framing.camera(CAMERA)
    assert camera.focal_px == pytest.approx(CAMERA.focal_px)
    assert camera.principal_point_px == pytest.approx(CAMERA.principal_point_px)


def test_the_framed_camera_projects_a_point_to_where_its_pixel_went():
    framing = Framing.of_camera(CAMERA, crop_px=(80, 0, 480, 480), image_size_px=(240, 240))
    point = np.array([0.004, -0.003, 0.01])
    x, y = np.rint(CAMERA.project(point)).astype(int)
    image = np.zeros((480, 640), np.float32)
    image[y - 4 : y + 5, x - 4 : x + 5] = 1.0
    framed = framing.apply(image)
    rows, columns = np.nonzero(framed > 0.5)
    assert framed.shape == (240, 240)
    assert framing.camera(CAMERA).project(point) == pytest.approx(
        [columns.mean(), rows.mean()], abs=0.6
    )


def test_a_stretched_image_has_focal_lengths_of_both_axes():
    framing = Framing.of_camera(
        CAMERA, crop_px=(0, 0, 0, 0), image_size_px=(320, 180), image_aspect="stretch"
    )
    assert framing.rendered_px == (320, 240)
    found = framing.intrinsics(CAMERA)
    assert found.focal_px == pytest.approx([80.0, 60.0])
    assert found.principal_point_px == pytest.approx([154.75, 93.4375])
    row = np.zeros((240, 320), np.float32)
    row[120:124] = 1.0
    assert np.nonzero(framing.fit(row)[:, 0] > 0.5)[0].tolist() == [90, 91, 92]


def test_depth_is_never_averaged_with_nothing():
    depth = np.full((480, 640), np.nan, np.float32)
    depth[:, 320:] = 0.01
    framing = Framing.of_camera(CAMERA, crop_px=(0, 0, 0, 0), image_size_px=(320, 240))
    framed = framing.apply(depth, interpolation=cv2.INTER_NEAREST)
    assert np.isnan(framed[:, :160]).all()
    assert (framed[:, 160:] == np.float32(0.01)).all()


@pytest.mark.parametrize(
    ("crop_px", "image_size_px", "reason"),
    [
        ((600, 0, 100, 100), (0, 0), "reaches beyond"),
        ((0, 0, 480, 480), (640, 480), "aspect ratio.*image_aspect to stretch"),
        ((0, 0, 8, 6), (640, 480), "at least 16 each way"),
    ],
)
def test_a_frame_that_no_camera_has_is_refused(crop_px, image_size_px, reason):
    with pytest.raises(ValueError, match=reason):
        Framing.of_camera(CAMERA, crop_px=crop_px, image_size_px=image_size_px)


def test_encodings_hold_the_same_colour():
    rgb = np.full((2, 2, 3), (200, 100, 50), np.uint8)
    assert encoded_pixels(rgb, "rgb8") is rgb
    assert encoded_pixels(rgb, "bgr8")[0, 0].tolist() == [50, 100, 200]
    assert encoded_pixels(rgb, "mono8")[0, 0] == pytest.approx(
        0.299 * 200 + 0.587 * 100 + 0.114 * 50, abs=1.0
    )


@pytest.mark.fault("node parameters", "`image_size_px` is `[16384, 16384]`")
def test_an_image_that_takes_gigabytes_is_refused(answered):
    square = FisheyeCamera(480, 480, 160.0, np.array([240.0, 240.0]))
    with pytest.raises(ValueError, match="GB of memory") as caught:
        Framing.of_camera(square, crop_px=(0, 0, 0, 0), image_size_px=(16384, 16384))
    answered(caught.value)
    largest = Framing.of_camera(square, crop_px=(0, 0, 0, 0), image_size_px=(2880, 2880))
    assert largest.apply(np.zeros((480, 480, 3), np.uint8)).shape == (2880, 2880, 3)
