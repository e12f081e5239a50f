# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Markers that are printed on the skin: their places, their motion, and that the image agrees."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.markers import MarkerMotion, PrintedMarkers, grid_m
from dotsim_ros.geometry.pose import ApexPose
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import (
    MarkerSpecification,
    SensorSpecification,
    load_sensor,
    sensor_from,
)
from dotsim_ros.view.sensors import pressed_images, with_arrows

GRID = {"columns": 5, "rows": 3, "spacing_m": [0.003, 0.004], "radius_m": 0.0005, "darkness": 1.0}
PAD = {
    "name": "dotted",
    "gel": {"shape": "flat_pad", "pad_size_m": [0.018, 0.018, 0.004], "skin_spacing_m": 0.0008},
    "solver": {"grid_spacing_m": 0.002, "refined": False},
    "camera": {
        "projection": "pinhole",
        "width": 240,
        "height": 240,
        "principal_point_px": [119.5, 119.5],
        "position_m": [0.0, 0.0, -0.012],
        "half_height_angle_deg": 28.0,
        "distortion": [-0.1, 0.0, 0.0, 0.0],
        "idle_image": "",
    },
    "pattern": {"contrast": 0.0, "grain": 0.0, "noise_levels": 0.0},
    "markers": GRID,
}


@pytest.fixture(scope="module")
def pad() -> TactileSensor:
    return TactileSensor(sensor_from(PAD, "pad"), indenter=load_indenter("sphere_4mm"))


def dots_px(image: np.ndarray) -> np.ndarray:
    """Return the middles (N, 2) of the dark dots of an image."""
    dark = (image.max(axis=2) < 25).astype(np.uint8)
    dark[:20] = dark[-20:] = 0
    _, _, sizes, middles = cv2.connectedComponentsWithStats(dark)
    return middles[1:][sizes[1:, cv2.CC_STAT_AREA] > 20]


def test_the_drawn_dots_are_where_the_markers_are_at_rest_and_pressed(pad: TactileSensor) -> None:
    frame = pad.step(ApexPose(0.0012), 0.04)
    # Next to the middle one: the gel is drawn towards the contact.
    motion = pad.marker_motion(frame.skin_position_m)
    assert motion.rest_m[:, :2] == pytest.approx(grid_m(pad.specification.markers), abs=1e-12)
    assert motion.rest_m[:, 2] == pytest.approx(0.004)
    for image, expected in ((pad.idle_image, motion.rest_px), (frame.image, motion.position_px)):
        found = dots_px(image)
        assert len(found) == 15
        apart = np.linalg.norm(found[:, None] - expected[None], axis=2)
        assert sorted(apart.argmin(axis=1)) == list(range(15))
        assert apart.min(axis=1).max() < 1.0
    moved = np.linalg.norm(motion.position_m - motion.rest_m, axis=1)
    assert moved.argmax() == 7
    assert moved[7] == pytest.approx(0.0012, rel=0.05)


def yellow(image: np.ndarray) -> np.ndarray:
    """Return where (H, W) an image is as yellow as an arrow."""
    return (image[..., :2].min(axis=2) > 180) & (image[..., 2] < 80)


def test_pictures_show_the_motion_of_markers(tmp_path: Path) -> None:
    file = tmp_path / "dotted.yaml"
    file.write_text(yaml.safe_dump(PAD))
    idle, pressed = pressed_images(str(file))
    assert len(dots_px(idle)) == 15
    assert yellow(pressed).sum() > yellow(idle).sum() + 20
    apart = np.array([[4.0, 0.0], [np.nan, 0.0]])
    motion = MarkerMotion(np.zeros((2, 3)), np.zeros((2, 3)), 20.0 + 0.0 * apart, 20.0 + apart)
    y, x = np.nonzero(yellow(with_arrows(np.zeros((40, 60, 3), np.uint8), motion)))
    # Three times as long as the motion, along it.
    assert x.min() in (20, 21)
    assert x.max() == 32
    assert y.mean() == pytest.approx(20.0, abs=0.2)


def test_markers_go_along_with_any_smooth_motion_of_the_skin() -> None:
    skin = dome_skin(0.01575, 0.5e-3)
    grid = MarkerSpecification(columns=7, rows=7, spacing_m=(2e-3, 2e-3))
    markers = PrintedMarkers(grid, skin)
    assert len(markers.rest_m) == 49
    # Triangles cut the corners of the dome by s^2 / (8 R).
    assert np.linalg.norm(markers.rest_m, axis=1) == pytest.approx(0.01575, abs=4e-6)
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 0.9]])
    camera = Camera.from_specification(load_sensor("densetact2").camera)
    motion = markers.motion(skin.rest_position_m @ turn.T, camera)
    assert motion.position_m == pytest.approx(motion.rest_m @ turn.T, abs=1e-12)
    assert motion.position_px == pytest.approx(camera.project(motion.position_m))


def test_a_sensor_without_markers_says_so(
    pad: TactileSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pad, "markers", None)
    with pytest.raises(
        ValueError, match="'dotted' has no printed markers; give its file a section"
    ):
        pad.marker_motion(pad.skin.rest_position_m)


@pytest.mark.parametrize(
    ("markers", "message"),
    [
        ({"columns": 5}, "markers.columns is 5 and markers.rows is 0, expected both above 0"),
        ({"columns": 8, "rows": 3, "spacing_m": [0.003, 0.003]}, "reach 0.0105 m along x"),
    ],
)
def test_a_grid_that_no_skin_has_is_refused(markers: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sensor_from({**PAD, "markers": markers}, "pad")
    with pytest.raises(ValueError, match="beyond the skin"):
        SensorSpecification(markers=MarkerSpecification(13, 13, (2e-3, 2e-3)))
