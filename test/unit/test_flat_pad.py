# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A flat pad from its YAML file alone: pressed, drawn and lit; and idle images that are drawn."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.camera import Camera, FisheyeCamera
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.files import parameter_path
from dotsim_ros.optics.idle import lights_of, lit_region, read_description, stated_lights
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting
from dotsim_ros.optics.pattern import idle_frame_of, main, render_idle_image
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.sensor import Frame, TactileSensor
from dotsim_ros.specification import (
    GelSpecification,
    LightingSpecification,
    PatternSpecification,
    SensorSpecification,
    load_sensor,
    sensor_from,
)

PLACE_M = np.array([0.003, -0.002])
DEPTHS_M = (0.0005, 0.001, 0.0015)
PENETRATION_M = 30.0e-6
"""Of the skin's markers into the indenter."""
FACETS_M = 8.0e-6
"""How far a ball of 4 mm goes through triangles of 0.5 mm, s^2 / (8 R)."""


@pytest.fixture(scope="module")
def pad() -> TactileSensor:
    return TactileSensor(load_sensor("flat_pad"), indenter=load_indenter("sphere_4mm"))


@pytest.fixture(scope="module")
def presses(pad: TactileSensor) -> list[Frame]:
    """Return the untouched pad, then frames of a press ever deeper."""
    pad.reset()
    return [pad.step(None, 0.04), *(pad.step(tip(pad, depth), 0.04) for depth in DEPTHS_M)]


def tip(pad: TactileSensor, depth_m: float, shift_m: float = 0.0) -> Pose:
    x, y = PLACE_M
    return Pose(np.array([x + shift_m, y, pad.specification.gel.pad_size_m[2] - depth_m]))


def pixels_around(pad: TactileSensor, near_m: float, far_m: float) -> np.ndarray:
    """Return (H, W) which pixels of the untouched pad show points so far from the press."""
    view = SkinRenderer(pad.camera, pad.skin).render(pad.skin.rest_position_m)
    distance = np.linalg.norm(view.material_point_m[..., :2] - PLACE_M, axis=2)
    return (distance >= near_m) & (distance < far_m)


def variant(text: str) -> SensorSpecification:
    return sensor_from(yaml.safe_load(text), "variant.yaml", name="variant")


def test_untouched_pad_shows_its_idle_image_and_lies_where_it_is(
    pad: TactileSensor, presses: list[Frame]
) -> None:
    frame = presses[0]
    assert np.array_equal(frame.image, pad.idle_image)
    seen = np.isfinite(frame.depth_m)
    rays = pad.camera.rays()[0]
    height_m = pad.camera.pose.position_m[2] + (frame.depth_m * rays[..., 2])[seen]
    assert np.abs(height_m - pad.specification.gel.pad_size_m[2]).max() < 1e-6
    assert np.allclose(frame.normal[seen], [0.0, 0.0, -1.0], atol=1e-6)


def test_a_press_moves_the_skin_and_its_depth_image_as_far_as_the_indenter(
    pad: TactileSensor, presses: list[Frame]
) -> None:
    for depth_m, frame in zip(DEPTHS_M, presses[1:], strict=True):
        assert frame.converged
        x, y = np.rint(pad.camera.project(tip(pad, depth_m).position_m)).astype(int)
        height_m = (
            pad.camera.pose.position_m[2] + frame.depth_m[y, x] * pad.camera.rays()[0][y, x, 2]
        )
        sunk_m = pad.specification.gel.pad_size_m[2] - height_m
        assert depth_m - PENETRATION_M - FACETS_M < sunk_m < depth_m + 5e-6
        assert 0.0 < frame.max_penetration_m < PENETRATION_M


def test_the_pad_pushes_the_indenter_out_ever_harder(presses: list[Frame]) -> None:
    force_n = [frame.wrench.force_n for frame in presses]
    assert not force_n[0].any()
    outward = [force[2] for force in force_n]
    assert all(before < after for before, after in pairwise(outward))
    # Off the middle, but far from the edges: hardly any force along the pad.
    assert all(np.abs(force[:2]).max() < 0.02 * force[2] for force in force_n[1:])
    # A bonded layer is stiffer than Hertz's half-space, 4/3 E / (1 - nu^2) sqrt(R d^3).
    hertz_n = [4 / 3 * 3.0e5 / (1 - 0.48**2) * np.sqrt(0.004 * depth**3) for depth in DEPTHS_M]
    assert all(1.0 < found / by < 4.0 for found, by in zip(outward[1:], hertz_n, strict=True))


def test_the_image_changes_where_the_pad_is_pressed(
    pad: TactileSensor, presses: list[Frame]
) -> None:
    change = np.abs(presses[-1].image.astype(float) - presses[0].image).max(axis=2)
    contact, around = pixels_around(pad, 0.0, 0.0025), pixels_around(pad, 0.008, 0.012)
    assert change[contact].mean() > 20.0
    assert change[around].mean() < 0.2 * change[contact].mean()


def test_walls_of_the_dent_turn_to_the_leds_that_they_face(
    pad: TactileSensor, presses: list[Frame]
) -> None:
    # The wall on the dent's left looks right, as seen from behind; green LEDs stand on the left.
    gain = presses[-1].image.astype(float) - presses[0].image
    x, y = (int(v) for v in pad.camera.project([*PLACE_M, 0.004]))
    left, right = gain[y - 8 : y + 9, x - 45 : x - 25], gain[y - 8 : y + 9, x + 25 : x + 45]
    greener = [part[..., 1].mean() - part[..., [0, 2]].mean() for part in (left, right)]
    assert greener[0] > 20.0
    assert greener[1] < -5.0


def test_the_pattern_goes_along_with_the_skin(pad: TactileSensor) -> None:
    pad.reset()
    pad.step(tip(pad, 0.0015), 0.04)
    before = pad.see(pad.press(tip(pad, 0.0015), 0.04), tip(pad, 0.0015))
    for shift_m in (0.0002, 0.0004):
        after = pad.step(tip(pad, 0.0015, shift_m), 0.04)
    x, y = (int(v) for v in pad.camera.project([*PLACE_M, 0.0025]))
    patch = [
        frame.image[y - 24 : y + 24, x - 24 : x + 24].mean(axis=2).astype(np.float64)
        for frame in (before, after)
    ]
    (moved_x, moved_y), _ = cv2.phaseCorrelate(
        *patch, cv2.createHanningWindow((48, 48), cv2.CV_64F)
    )
    geometric = pad.image_motion_px(before.skin_position_m, after.skin_position_m)[y, x]
    assert moved_x > 4.0
    assert abs(moved_x - geometric[0]) < 1.0
    assert abs(moved_y - geometric[1]) < 1.0


def test_the_shipped_idle_image_is_what_its_command_draws(pad: TactileSensor) -> None:
    sensor = pad.specification
    drawn = idle_frame_of(replace(sensor, camera=replace(sensor.camera, idle_image="")), pad.camera)
    # Another processor may round a few pixels elsewhere.
    assert np.abs(drawn.image.astype(int) - pad.idle_image).mean() < 0.01
    assert stated_lights(sensor) == (sensor.lighting, sensor.vignetting)
    assert (drawn.lighting, drawn.vignetting) == lights_of(sensor)


@pytest.mark.parametrize(
    "text",
    [
        "gel: {shape: flat_pad, pad_size_m: [0.03, 0.012, 0.006]}\n"
        "camera: {width: 320, height: 240, principal_point_px: [159.5, 119.5], idle_image: '',\n"
        "  position_m: [0.001, 0, -0.02], half_height_angle_deg: 30}\n"
        "lighting: {radius_m: 0.02, height_m: -0.005}",
        # The view ends with the dome, not with the camera's mount.
        "gel: {shape: dome, outer_radius_m: 0.02}\n"
        "camera: {width: 320, height: 240, principal_point_px: [159.5, 119.5], idle_image: ''}\n"
        "pattern: {rim_angle_deg: 180, blotch_m: 1.0e-3}",
        "gel: {shape: dome, outer_radius_m: 0.012, core_radius_m: 0.0}\n"
        "camera: {width: 320, height: 240, principal_point_px: [159.5, 119.5], idle_image: '',\n"
        "  position_m: [0, 0, -0.01], half_height_angle_deg: 60}\n"
        "lighting: {height_m: -0.002}",
    ],
    ids=["pad", "dome", "dome from below"],
)
def test_a_sensor_without_an_image_is_drawn_where_its_skin_is_seen(text: str) -> None:
    sensor = variant(text)
    camera, skin = Camera.from_specification(sensor.camera), skin_of(sensor.gel)
    idle = idle_frame_of(sensor, camera)
    view = SkinRenderer(camera, skin).render(skin.rest_position_m)
    assert np.mean(lit_region(idle.image) == view.mask) > 0.98
    assert np.mean(view.mask) > 0.2
    images = ImageRenderer(camera, skin, idle.image, lighting=idle.lighting)
    assert np.array_equal(images.render(view), idle.image)


def test_a_small_pad_far_away_is_not_blown_out() -> None:
    sensor = variant(
        "gel: {shape: flat_pad, pad_size_m: [0.005, 0.005, 0.005]}\n"
        "camera: {idle_image: '', position_m: [0, 0, -0.03], half_height_angle_deg: 80}\n"
    )
    idle = idle_frame_of(sensor, Camera.from_specification(sensor.camera)).image
    lit = lit_region(idle)
    assert 0.0 < lit.mean() < 0.01
    assert 60.0 < idle[lit].mean() < 200.0


def test_lights_of_an_image_come_from_the_file_beside_it_or_from_the_sensor(
    tmp_path: Path,
) -> None:
    own = load_sensor("flat_pad")
    image: ImageArray = cv2.imread(str(parameter_path("images/flat_pad_idle.png")))
    cv2.imwrite(str(tmp_path / "mine.png"), image)
    stated = LightingSpecification(gloss=2.0)
    camera = replace(own.camera, idle_image=str(tmp_path / "mine.png"))
    sensor = replace(own, camera=camera, lighting=stated)
    seen = Camera.from_specification(camera)
    assert stated_lights(sensor) == (stated, own.vignetting)
    assert idle_frame_of(sensor, seen).lighting == Lighting.from_specification(stated)
    (tmp_path / "mine.yaml").write_text("lighting: {gloss: 3}")
    assert stated_lights(sensor)[0] == LightingSpecification(gloss=3.0)
    assert idle_frame_of(sensor, seen).lighting.gloss == 3.0
    (tmp_path / "mine.yaml").write_text("lighting: {gloss: -3}")
    with pytest.raises(ValueError, match=r"mine\.yaml .*lighting\.gloss is -3, expected a number"):
        idle_frame_of(sensor, seen)


def test_the_command_draws_a_sensor_and_keeps_what_describes_its_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "small.yaml").write_text(
        "gel: {shape: flat_pad, pad_size_m: [0.02, 0.02, 0.005]}\n"
        "camera: {width: 160, height: 120, principal_point_px: [79.5, 59.5], idle_image: '',\n"
        "  position_m: [0, 0, -0.012], half_height_angle_deg: 35}\n"
        "lighting: {height_m: -0.003, gloss: 1}\n"
    )
    out = tmp_path / "out" / "idle.png"
    command = ["pattern", str(out), "--sensor", str(tmp_path / "small.yaml")]
    monkeypatch.setattr(sys, "argv", command)
    main()
    first = cv2.imread(str(out))
    lighting, _ = read_description(out.with_suffix(".yaml")).lights()
    sensor = load_sensor(tmp_path / "small.yaml")
    drawn = idle_frame_of(sensor, Camera.from_specification(sensor.camera))
    assert np.array_equal(first[..., ::-1], drawn.image)
    assert lighting == drawn.lighting
    out.with_suffix(".yaml").write_text("lighting: {height_m: -0.003, azimuth_deg: [0, 120, 240]}")
    main()
    assert "120" in out.with_suffix(".yaml").read_text()
    assert not np.array_equal(cv2.imread(str(out)), first)


def draw(gel: GelSpecification, position_m: list[float], **camera: object) -> ImageArray:
    pose = Pose(np.array(position_m), np.array(camera.pop("quaternion_xyzw", [0, 0, 0, 1.0])))
    return render_idle_image(
        FisheyeCamera(64, 48, 30.0, np.array([31.5, 23.5]), pose=pose),
        gel,
        lighting=camera.pop("lighting", Lighting()),  # type: ignore[arg-type]
        vignetting=lights_of(SensorSpecification())[1],
        pattern=PatternSpecification(**camera),  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("shape", ["dome", "flat_pad"])
def test_what_cannot_be_drawn_is_refused_with_the_reason(shape: str) -> None:
    gel = GelSpecification(shape=shape)
    with pytest.raises(ValueError, match="in front of its skin"):
        draw(gel, [0.0, 0.0, 0.05])
    with pytest.raises(ValueError, match=r"pattern\.blotch_m is 1\.0e-05"):
        draw(
            GelSpecification(shape=shape, outer_radius_m=0.2, pad_size_m=(0.2, 0.2, 0.02)),
            [0.0, 0.0, 0.002],
            blotch_m=1e-5,
        )
    high = Lighting.from_specification(LightingSpecification(height_m=0.1, crosstalk=0.0))
    with pytest.raises(ValueError, match="do not light the skin from behind"):
        draw(gel, [0.0, 0.0, 0.002], lighting=high)


def test_a_camera_that_looks_away_from_a_pad_is_refused() -> None:
    with pytest.raises(ValueError, match="sees nothing of the gel; turn it"):
        draw(
            GelSpecification(shape="flat_pad"),
            [0.0, 0.0, -0.01],
            quaternion_xyzw=[1.0, 0.0, 0.0, 0.0],
            rim_angle_deg=60.0,
        )


def test_a_grey_camera_sees_three_equal_channels_that_white_rows_of_leds_shade() -> None:
    sensor = variant(
        "gel: {shape: flat_pad, pad_size_m: [0.016, 0.016, 0.004], skin_spacing_m: 0.001}\n"
        "solver: {grid_spacing_m: 0.002, refined: false}\n"
        "camera: {projection: pinhole, colour: grey, width: 96, height: 96, idle_image: '',\n"
        "  principal_point_px: [47.5, 47.5], position_m: [0, 0, -0.012],\n"
        "  half_height_angle_deg: 25}\n"
        "lighting: {radius_m: 0.011, row_length_m: 0.012, azimuth_deg: [0, 0, 0]}\n"
        "noise: {deviation_levels: 2}\n"
    )
    places = np.array([light.position_m for light in lights_of(sensor)[0].lights])
    assert places[:, 0] == pytest.approx(0.011)
    assert sorted(set(places[:, 1].round(9))) == [-0.006, 0.0, 0.006]
    grey = TactileSensor(sensor, indenter=load_indenter("sphere_4mm"))
    image = grey.step(Pose(np.array([0.0, 0.0, 0.003])), 0.04).image
    assert np.array_equal(image, np.repeat(image[..., :1], 3, axis=2))
    # Seen from behind the dent is a bump, whose right flank faces the LEDs.
    gain = image[..., 0].astype(float) - grey.idle_image[..., 0]
    assert gain[40:56, 52:62].mean() > gain[40:56, 34:44].mean() + 10.0


def test_the_pad_is_pressed_until_it_gives_a_force(pad: TactileSensor) -> None:
    pad.reset()
    gel, pose = pad.press_to_force(tip(pad, -0.0002), 0.5, 0.04)
    assert gel.wrench.force_n[2] == pytest.approx(0.5, rel=2e-3)
    assert gel.time_s == pytest.approx(0.04)
    again = pad.press(pose, 0.04)
    assert again.wrench.force_n[2] == pytest.approx(0.5, rel=0.02)
