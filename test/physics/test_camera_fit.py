# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The fit of camera and lights recovers those that made the images."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from dotsim_ros.calibration.camera import fit as fit_module
from dotsim_ros.calibration.camera.fit import fit_camera, rim_circle
from dotsim_ros.calibration.camera.model import (
    LENS,
    LIGHTS,
    CameraModel,
    camera_section,
    describe_lights,
    moved,
)
from dotsim_ros.calibration.camera.score import score_frames, summarize_frames
from dotsim_ros.cli.main import main
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.optics.idle import read_description
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.optics.pattern import render_idle_image
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import (
    GelSpecification,
    LightingSpecification,
    PatternSpecification,
    load_sensor,
)
from dotsim_ros.twin import footage
from dotsim_ros.twin.footage import FilmedData, FilmedPress

RADIUS_M = 0.01575
STATED_LIGHTS = LightingSpecification(
    radius_m=0.009, spread_deg=16.0, crosstalk=0.03, ambient_fraction=0.5, exponent=0.7
)
LENS_OFFSET = np.array([6.0, -4.0, 1.0, -2.0, 2.5, -1.5, 0.0])
"""Of the camera that takes the images from the stated one, in steps of LENS."""
NOISE_LEVELS = 1.2


def dented(skin, axis, depth_m):
    """Return the skin pressed in along a direction, what lies next to pushed outwards."""
    axis = np.asarray(axis) / np.linalg.norm(axis)
    square = np.sum((skin.rest_position_m - RADIUS_M * axis) ** 2, axis=1) / 0.004**2
    dent = depth_m * (1.0 - 0.5 * square) * np.exp(-square)
    return skin.rest_position_m - dent[:, None] * axis


@pytest.fixture(scope="module")
def stated():
    camera = Camera.from_specification(load_sensor("densetact2").camera)
    return CameraModel(camera.scaled(240, 180), STATED_LIGHTS)


@pytest.fixture(scope="module")
def true(stated):
    model = moved(stated, LENS, LENS_OFFSET)
    return replace(model, lights=replace(STATED_LIGHTS, spread_deg=36.0, gloss=2.0))


@pytest.fixture(scope="module")
def filmed(true):
    random = np.random.default_rng(0)
    skin = dome_skin(RADIUS_M, 0.8e-3)
    idle = render_idle_image(
        true.camera,
        GelSpecification(outer_radius_m=RADIUS_M),
        lighting=Lighting.from_specification(true.lights),
        vignetting=Vignetting(),
        pattern=PatternSpecification(noise_levels=0.0),
    )
    renderer = SkinRenderer(true.camera, skin)
    images = true.images(FilmedData(skin, idle, ()))
    presses = []
    for number, (x, y) in enumerate([(0.0, 0.0), (0.7, 0.2), (-0.5, 0.6), (0.1, -0.8)]):
        depth_m = np.array([-0.1e-3, 3.0e-3])
        position = np.stack([dented(skin, (x, y, 1.0), max(d, 0.0)) for d in depth_m])
        measured = np.stack([images.warp(renderer.render(p)) for p in position])
        noisy = measured + NOISE_LEVELS * random.standard_normal(measured.shape)
        presses.append(
            FilmedPress(
                f"press_{number}",
                "dent",
                depth_m,
                np.clip(np.rint(noisy), 0, 255).astype(np.uint8),
                position.astype(np.float32),
                np.arange(2.0),
            )
        )
    return FilmedData(skin, idle, tuple(presses))


@pytest.fixture(scope="module")
def fit(filmed, stated):
    with pytest.MonkeyPatch.context() as patch:
        # No later evaluation moves the lens by a hundredth of its deviation.
        patch.setattr(fit_module, "EVALUATIONS", 3)
        return fit_camera(filmed, stated, rounds=1)


def test_lens_is_found_within_its_stated_deviations(fit, true):
    found = {parameter.name: parameter for parameter in fit.parameters}
    for parameter in LENS:
        one = found[parameter.name]
        assert abs(one.after - parameter.value(true)) < 3.0 * one.deviation, one
    assert np.abs(fit.model.camera.principal_point_px - true.camera.principal_point_px).max() < 0.3
    assert fit.model.lights.gloss == pytest.approx(true.lights.gloss, rel=0.3)
    assert fit.model.lights.spread_deg == pytest.approx(true.lights.spread_deg, abs=5.0)


def test_images_are_met_to_the_noise(fit, filmed, stated):
    scores = score_frames(filmed, stated)
    before = summarize_frames([s for s in scores if s.deepest])
    after = summarize_frames([s for s in score_frames(filmed, fit.model) if s.deepest])
    # Untouched frames show what the measure itself adds.
    untouched = summarize_frames([s for s in scores if s.depth_m < 0.0])
    assert untouched["reprojection_rms_px"] < 0.05
    assert after["carried_db"] > before["carried_db"] + 5.0
    assert after["carried_db"] > 40.0
    assert after["reprojection_rms_px"] < 0.075 < before["reprojection_rms_px"]


def test_rim_of_the_lit_disc_is_round_about_the_principal_point(filmed, true):
    rim = rim_circle(filmed.idle)
    assert np.abs(rim.centre_px - true.camera.principal_point_px).max() < 0.5
    assert rim.residual_px < 0.5
    square = np.zeros((240, 320, 3), dtype=np.uint8)
    square[40:200, 60:260] = 120
    assert rim_circle(square) is None
    assert rim_circle(np.zeros((240, 320, 3), dtype=np.uint8)) is None


def test_sensor_file_gives_the_fitted_camera_back(true):
    section = camera_section(true, load_sensor("densetact2").camera, "images/densetact2_idle.png")
    camera = Camera.from_specification(section).scaled(240, 180)
    directions = np.random.default_rng(1).standard_normal((200, 3)) * [1.0, 1.0, 0.3]
    directions[:, 2] += 0.5
    points = true.camera.pose.apply(0.01 * directions)
    difference = camera.project(points) - true.camera.project(points)
    assert np.nanmax(np.abs(difference)) < 0.01
    pinhole = replace(true, camera=Camera.from_specification(load_sensor("gelsight_mini").camera))
    section = camera_section(pinhole, load_sensor("densetact2").camera, "")
    assert section.projection == pinhole.camera.projection


def test_shallow_presses_are_refused(filmed, stated):
    shallow = replace(
        filmed,
        presses=tuple(
            replace(press, tip_depth_m=0.1 * press.tip_depth_m) for press in filmed.presses
        ),
    )
    with pytest.raises(ValueError, match="press deeper"):
        fit_camera(shallow, stated)


@pytest.mark.parametrize(
    ("name", "end"),
    [
        ("crosstalk", 1.0),
        ("exponent", 10.0),
        ("radius_m", 1e-4),
    ],
)
def test_lights_at_the_end_of_what_a_file_takes_stay_there(name, end, stated, tmp_path):
    at_end = replace(stated, lights=replace(STATED_LIGHTS, **{name: end}))
    (parameter,) = (p for p in LIGHTS if p.name == name)
    described = tmp_path / "idle.yaml"
    for way in (-1.0, 1.0):
        model = parameter.moved(at_end, way * parameter.step)
        described.write_text(yaml.safe_dump(describe_lights(model)))
        read_description(described)
    ends = {parameter.value(parameter.moved(at_end, w * parameter.step)) for w in (-1.0, 1.0)}
    assert end in ends
    assert len(ends) == 2


@pytest.fixture
def command(tmp_path, filmed, monkeypatch):
    """A fit of the camera to the presses that were filmed, with bags in name alone."""
    entries = [
        {"bag": f"bags/{press.name}", "indenter": "dent", "images": True}
        for press in filmed.presses
    ]
    for entry in entries:
        (tmp_path / "data" / entry["bag"]).mkdir(parents=True)
    (tmp_path / "data" / "dataset.yaml").write_text(yaml.safe_dump({"trajectories": entries}))
    monkeypatch.setattr(footage, "read_filmed_data", lambda *_given, **_known: filmed)
    line = ["calibrate-camera", "--data", str(tmp_path / "data"), "--skin", "gel"]
    return [*line, "--out", str(tmp_path / "mine.yaml")]


def test_the_command_writes_a_sensor_that_has_the_fitted_camera(
    command, fit, tmp_path, monkeypatch
):
    monkeypatch.setattr(fit_module, "fit_camera", lambda *_given, **_known: fit)
    fine_of_before = tmp_path / "mine_idle_fine.png"
    fine_of_before.touch()
    assert main([*command, "--sensor", "densetact2"]) == 0
    assert not fine_of_before.exists()
    sensor = load_sensor(tmp_path / "mine.yaml")
    assert sensor.camera.idle_image == str(tmp_path / "mine_idle.png")
    lighting, _ = read_description(tmp_path / "mine_idle.yaml").lights()
    assert lighting.gloss == pytest.approx(fit.model.lights.gloss, abs=1e-6)
    focal_px = Camera.from_specification(sensor.camera).scaled(240, 180).focal_px
    assert focal_px == pytest.approx(fit.model.camera.focal_px, rel=1e-6)


@pytest.mark.parametrize(
    ("sensor", "given", "said"),
    [
        ("densetact2", "gelsight_mini", "projection pinhole and 640x480"),
        ("gelsight_mini", "digit", "one of the projection pinhole and 640x480"),
    ],
)
def test_a_stated_camera_of_another_kind_is_refused_before_the_fit(
    command, sensor, given, said, capsys, tmp_path, monkeypatch
):
    monkeypatch.setattr(footage, "read_filmed_data", None)
    before = sorted(tmp_path.iterdir())
    assert main([*command, "--sensor", sensor, "--stated", given]) == 1
    answer = capsys.readouterr().err
    assert f"--stated {given} has a camera of the projection" in answer
    assert said in answer
    assert "name with --stated the sensor as its maker states it" in answer
    assert sorted(tmp_path.iterdir()) == before


def test_a_fit_that_no_file_takes_leaves_what_is_there(command, fit, capsys, tmp_path, monkeypatch):
    image, described = tmp_path / "mine_idle.png", tmp_path / "mine_idle.yaml"
    for path in (image, described):
        path.write_text("of an earlier fit")
    far = replace(fit, model=replace(fit.model, falloff=(-200.0,)))
    monkeypatch.setattr(fit_module, "fit_camera", lambda *_given, **_known: far)
    assert main([*command, "--sensor", "densetact2"]) == 1
    assert "falloff is [-200.0]" in capsys.readouterr().err
    assert image.read_text() == described.read_text() == "of an earlier fit"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data", "mine_idle.png", "mine_idle.yaml"]
