# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor from photographs of a ball: what the folder must hold, and the whole way to its file."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.calibration.calibrate import report_folder
from dotsim_ros.calibration.guided.fit import (
    GuidedRequest,
    calibrate_guided,
    network_width_px,
    scale_of,
)
from dotsim_ros.calibration.guided.photographs import LEAST_PRESSES, read_guided_photographs
from dotsim_ros.calibration.guided.report import (
    CIRCLES,
    FIGURES,
    PAGE,
    summary_lines,
    write_guided_report,
)
from dotsim_ros.cli.main import main
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.learning.neighbourhood import NeighbourhoodRecipe
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import load_sensor
from dotsim_ros.twin.ball_presses import flat_camera

SIZE = (120, 160)
BALL_DIAMETER_M = 4.0e-3
RADIUS_PX = 17.0
PIXELS_PER_METRE = 10.0e3


def photograph(*balls: tuple[float, float], shift: float = 0.0) -> NDArray[np.uint8]:
    """Return a lit gel with the colours of a ball's slopes at places, x and y in pixels."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float64)
    level = np.stack([110.0 + 0.2 * x, 130.0 - 0.1 * y, 120.0 + 0.1 * x], axis=-1)
    for centre in balls:
        across = np.stack([x - centre[0], y - centre[1]], axis=-1) / RADIUS_PX
        distance = np.linalg.norm(across, axis=-1, keepdims=True)
        slope = across * np.where(
            distance < 1.0, 1.0, np.exp(3.0 - 3.0 * distance) / np.maximum(distance, 1.0)
        )
        level += slope @ np.array([[60.0, -20.0, -40.0], [10.0, 50.0, -50.0]])
    return np.clip(level + shift, 0.0, 255.0).astype(np.uint8)


def write(path: Path, image: NDArray[np.uint8]) -> None:
    """Write a photograph."""
    assert cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


@pytest.fixture
def folder(tmp_path):
    """Photographs of one ball at many places, the idle one among them without a telling name."""
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    write(photographs / "frame_99.png", photograph())
    random = np.random.default_rng(0)
    for number in range(LEAST_PRESSES):
        place = random.uniform([30.0, 30.0], [130.0, 90.0])
        write(photographs / f"frame_{number:02d}.png", photograph(tuple(place), shift=number % 3))
    return photographs


@pytest.mark.fault("calibrate", "a photograph that shows no single ball")
def test_bad_photographs_are_left_out_with_their_reasons(folder, answered):
    write(folder / "none.png", photograph(shift=2.0))
    write(folder / "two.png", photograph((35.0, 40.0), (120.0, 80.0)))
    write(folder / "edge.png", photograph((8.0, 60.0)))
    write(folder / "small.png", photograph((60.0, 60.0))[:-8])
    (folder / "broken.png").write_bytes(b"no image")
    (folder / "notes.txt").write_text("of the afternoon")
    write(folder / "known.png", photograph((70.0, 55.0)))
    found = read_guided_photographs(folder)
    assert found.idle_name == "frame_99.png"
    assert len(found.presses) == LEAST_PRESSES + 1
    press = next(p for p in found.presses if p.name == "known.png")
    assert press.centre_px == pytest.approx([70.0, 55.0], abs=1.5)
    assert press.radius_px == pytest.approx(RADIUS_PX, rel=0.1)
    # The scale is given, or bounded by the ball.
    assumed = scale_of(found, 0.5 * BALL_DIAMETER_M, None)
    assert not assumed.measured
    assert assumed.bounds[0] < assumed.pixels_per_metre < assumed.bounds[1]
    assert scale_of(found, 0.5 * BALL_DIAMETER_M, PIXELS_PER_METRE).measured
    with pytest.raises(ValueError, match=r"more than the ball of 4\.00 mm; check"):
        scale_of(found, 0.5 * BALL_DIAMETER_M, 0.5 * PIXELS_PER_METRE)
    words = {
        "none.png": "shows no ball",
        "two.png": "shows two contacts",
        "edge.png": "at the frame's edge",
        "small.png": "is 160x112, expected 160x120",
        "broken.png": "is no image",
    }
    assert set(found.left_out) == set(words)
    for name, expected in words.items():
        assert expected in found.left_out[name]
        answered(found.left_out[name], what=f"the photograph {name}")


def test_too_few_photographs_say_what_was_wrong(folder):
    write(folder / "frame_03.png", photograph())
    with pytest.raises(ValueError, match=r"(?s)12 photographs show one ball .*frame_03.*no ball"):
        read_guided_photographs(folder)
    with pytest.raises(FileNotFoundError, match="no folder"):
        read_guided_photographs(folder / "elsewhere")


def test_from_photographs_to_a_sensor_that_runs(folder, tmp_path):
    out = tmp_path / "mine.yaml"
    told: list[str] = []
    request = GuidedRequest(
        folder,
        out,
        BALL_DIAMETER_M,
        PIXELS_PER_METRE,
        recipe=NeighbourhoodRecipe(steps=150, batch=2048),
    )
    found = calibrate_guided(request, told.append)
    write_guided_report(report_folder(out), found)
    assert any("frame_99.png" in line for line in told)
    # What is left is less than half of what the idle photograph leaves.
    assert found.psnr_db["contact"] > found.idle_psnr_db["contact"] + 6.0
    assert "not told by photographs: stiffness" in summary_lines(found)[1]
    page = (report_folder(out) / PAGE).read_text()
    assert "Young's modulus" in page
    assert cv2.imread(str(report_folder(out) / CIRCLES)) is not None
    specification = load_sensor(out)
    sensor = TactileSensor(specification, indenter=sphere(0.5 * BALL_DIAMETER_M))
    idle = sensor.step(None).image
    assert np.array_equal(idle, photograph())
    top = specification.gel.pad_size_m[2]
    pressed = sensor.step(Pose(np.array([0.0, 0.0, top - 0.8e-3]))).image
    assert np.abs(pressed.astype(float) - idle).max() > 20.0


def test_a_large_ball_and_a_thin_pad_give_a_sensor(folder, tmp_path):
    out = tmp_path / "mine.yaml"
    told: list[str] = []
    request = GuidedRequest(
        folder,
        out,
        8.0e-3,
        PIXELS_PER_METRE,
        pad_size_m=(18.0e-3, 14.0e-3, 1.8e-3),
        recipe=NeighbourhoodRecipe(steps=20, batch=1024),
    )
    found = calibrate_guided(request, told.append)
    write_guided_report(report_folder(out), found)
    # A pad so thin is pressed to a part of the circles that were photographed, which is told.
    assert len(found.too_wide) == LEAST_PRESSES
    assert any("check the pad's thickness, or press less deep" in line for line in told)
    figures = json.loads((report_folder(out) / FIGURES).read_text())
    assert figures["too_wide"] == list(found.too_wide)
    assert "wider than the pad can be pressed to" in (report_folder(out) / PAGE).read_text()
    assert load_sensor(out).solver.grid_spacing_m == 0.9e-3


@pytest.mark.parametrize(
    ("size", "width"), [((200, 160), 160), ((640, 480), 320), ((240, 320), 240)]
)
def test_photographs_of_any_size_give_a_network_its_images(size, width):
    assert network_width_px(flat_camera(*size, 4.0e-3, PIXELS_PER_METRE)) == width
    with pytest.raises(ValueError, match=r"are 60x60, .* crop them all alike to a width"):
        network_width_px(flat_camera(60, 60, 4.0e-3, PIXELS_PER_METRE))


def test_the_command_refuses_what_it_cannot_use(folder, tmp_path, capsys):
    out = tmp_path / "mine.yaml"
    assert main(["calibrate", "--out", str(out)]) != 0
    assert "name a data set with --data" in capsys.readouterr().err
    line = ["calibrate", "--guided", str(folder), "--out", str(out)]
    assert main(line) != 0
    assert "--ball-diameter-mm" in capsys.readouterr().err
    assert main([*line, "--ball-diameter-mm", "0.004"]) != 0
    assert "give it in millimetres" in capsys.readouterr().err
    shutil.rmtree(folder)
    assert main([*line, "--ball-diameter-mm", "4"]) != 0
    assert "no folder" in capsys.readouterr().err
    assert not out.exists()
