# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Path-traced images: light and lens against what is known of them, and what is hidden there."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

pytest.importorskip("mitsuba")

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.trajectory import PoseChannel, SkinChannel, Trajectory, WrenchChannel
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.specification import load_sensor
from studies.hidden.path_traced import (
    MAP_SIZE,
    Eye,
    Inside,
    InsideRenderer,
    led_places,
    llvm_library,
    map_directions,
    map_places,
    open_mitsuba,
)
from studies.hidden.rendered_laws import LAWS
from studies.hidden.rendered_unit import IDLE_COUNT, Studio

SKIN = skin_of(load_sensor("sensor_a").gel)
REST_M, TRIANGLES = SKIN.rest_position_m, SKIN.triangles
RADIUS_M = float(np.linalg.norm(REST_M, axis=1).max())
GREY = np.full((MAP_SIZE, MAP_SIZE), 0.5)
DARKNESS = np.zeros(9)


@pytest.fixture(scope="module")
def mitsuba():
    return open_mitsuba("scalar_rgb")


@pytest.fixture(scope="module")
def renderer_of(mitsuba):
    def made(inside, *, size=(24, 18), samples=16, edges=5):
        return InsideRenderer(
            REST_M,
            TRIANGLES,
            inside,
            width=size[0],
            height=size[1],
            sample_count=samples,
            most_edges=edges,
            mitsuba=mitsuba,
        )

    return made


def pressed_skins():
    """Return the skins (3, V, 3) of a press at the apex."""
    beside = np.linalg.norm(REST_M - [0.0, 0.0, RADIUS_M], axis=1)
    dent = 2.0e-3 * np.exp(-0.5 * (beside / 3.0e-3) ** 2)[:, None] * [0.0, 0.0, -1.0]
    return np.stack([REST_M + share * dent for share in (0.0, 0.5, 1.0)]).astype(np.float32)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A data set of one press at the apex."""
    folder = tmp_path_factory.mktemp("source")
    data_set = DataSetWriter(folder, SKIN)
    stamp = np.array([1_000_000_000, 3_000_000_000, 5_000_000_000])
    trajectory = Trajectory(
        pose=PoseChannel(stamp, np.full((3, 3), RADIUS_M), np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))),
        wrench=WrenchChannel(stamp, np.zeros((3, 3)), np.zeros((3, 3))),
        skin=SkinChannel(stamp, pressed_skins()),
        name="press",
    )
    indenter = replace(load_indenter("sphere_4mm"), name="sphere_4mm")
    data_set.add(trajectory, indenter, {"images": False})
    return read_data_set(folder)


@pytest.fixture(scope="module")
def studio(source, mitsuba):
    """A studio of that press."""
    return Studio(source, mitsuba, width=32, height=24, sample_count=9)


def spot(direction, width_rad):
    """Return a map of the coat (N, N) that is 1 around a direction from the dome's centre."""
    return (map_directions() @ direction > np.cos(width_rad)).astype(np.float64)


def centre_of(image):
    """Return x and y of where the light of an image (H, W, 3) is, px."""
    light = image.mean(axis=2)
    y, x = np.mgrid[0 : light.shape[0], 0 : light.shape[1]]
    return np.array([np.average(x, weights=light), np.average(y, weights=light)])


def test_a_glowing_dome_lights_itself_as_the_cavity_s_form_factor_says(renderer_of):
    # A sphere's part sends any of its points the same light; of a hemisphere that is one half.
    inside = Inside(GREY, DARKNESS, glow=np.ones_like(GREY), led_radius_m=1e-5)
    radiance = renderer_of(inside).radiance(REST_M, Eye(), seed=1)
    middle = radiance[6:12, 8:16]
    expected = sum((0.5 * 0.5) ** bounce for bounce in range(5))
    assert middle.mean() == pytest.approx(expected, rel=0.02)
    direct = renderer_of(inside, edges=1).radiance(REST_M, Eye(), seed=1)
    np.testing.assert_allclose(direct[6:12, 8:16], 1.0, rtol=1e-5)


def test_an_led_lights_the_apex_as_its_distance_and_angles_say(renderer_of):
    places, ways = led_places()
    inside = Inside(GREY, led_power=np.eye(9)[4] * 3.0, led_radius_m=0.2e-3)
    narrow = Eye(half_height_angle_rad=0.01)
    radiance = renderer_of(inside, size=(4, 4), samples=36, edges=2).radiance(
        REST_M, narrow, seed=2
    )
    to_apex = np.array([0.0, 0.0, RADIUS_M]) - places[4]
    distance = np.linalg.norm(to_apex)
    cosines = (to_apex @ ways[4] / distance) * (to_apex[2] / distance)
    irradiance = 3.0 * np.pi * 0.2e-3**2 * cosines / distance**2
    assert radiance[..., 1].mean() == pytest.approx(0.5 / np.pi * irradiance, rel=0.05)
    np.testing.assert_allclose(radiance[..., [0, 2]], 0.0)


@pytest.mark.parametrize("azimuth_deg", [130.0])
def test_a_spot_lands_at_its_equidistant_pixel(renderer_of, azimuth_deg):
    azimuth = np.radians(azimuth_deg)
    way = np.array([np.sin(0.7) * np.cos(azimuth), np.sin(0.7) * np.sin(azimuth), np.cos(0.7)])
    inside = Inside(np.zeros_like(GREY), DARKNESS, glow=spot(way, 0.08))
    eye = Eye()
    image = renderer_of(inside, size=(64, 48), samples=4, edges=1).radiance(REST_M, eye, seed=4)
    seen = RADIUS_M * way - eye.position_m
    angle = np.arctan2(np.hypot(seen[0], seen[1]), seen[2])
    focal = 24.0 / eye.half_height_angle_rad
    # x grows to the right along +x, y downwards along +y; the first pixel's centre is (0, 0).
    expected = focal * angle * np.array([np.cos(azimuth), np.sin(azimuth)]) + [31.5, 23.5]
    np.testing.assert_allclose(centre_of(image), expected, atol=0.25)


def test_a_camera_that_turns_or_moves_sees_a_spot_elsewhere(renderer_of):
    inside = Inside(np.zeros_like(GREY), DARKNESS, glow=spot(np.array([0.0, 0.0, 1.0]), 0.1))
    renderer = renderer_of(inside, size=(64, 48), samples=9, edges=1)
    focal = 24.0 / Eye().half_height_angle_rad

    def seen(eye):
        return centre_of(renderer.radiance(REST_M, eye, seed=5))

    straight = seen(Eye())
    # Turned about y, which points down: x swings to the right, so what is seen goes left.
    turned = seen(Eye(turn_rad=(0.0, 0.1, 0.0)))
    np.testing.assert_allclose(turned - straight, [-0.1 * focal, 0.0], atol=0.15)
    moved = seen(Eye(position_m=(0.0, 1.0e-3, 2.5e-3)))
    angle = np.arctan(1.0e-3 / (RADIUS_M - 2.5e-3))
    np.testing.assert_allclose(moved - straight, [0.0, -angle * focal], atol=0.15)


def test_vignetting_takes_its_share_at_half_the_height():
    random = np.random.default_rng(0)
    _, direction, weight = Eye(edge_loss=0.2).rays(41, 41, 4, random)
    angle = np.arccos(direction[:, 2])
    edge = np.abs(angle - np.radians(86.0)) < 0.02
    assert weight[edge].mean() == pytest.approx(0.8, abs=0.01)
    assert weight[angle < 0.05].min() > 0.999
    assert np.all(Eye().rays(8, 6, 4, random)[2] == 1.0)


def test_a_wide_pupil_blurs_what_is_out_of_its_focus_alone(renderer_of):
    inside = Inside(np.zeros_like(GREY), DARKNESS, glow=spot(np.array([0.0, 0.0, 1.0]), 0.05))
    renderer = renderer_of(inside, size=(48, 36), samples=16, edges=1)

    def width(pupil_m, focus_m):
        eye = Eye(half_height_angle_rad=0.5, pupil_m=pupil_m, focus_m=focus_m)
        light = renderer.radiance(REST_M, eye, seed=6).mean(axis=(0, 2))
        x = np.arange(len(light))
        return np.sqrt(np.average((x - np.average(x, weights=light)) ** 2, weights=light))

    far = RADIUS_M - 2.5e-3
    sharp = width(0.0, far)
    assert width(1.0e-3, far) == pytest.approx(sharp, rel=0.05)
    # A disc's deviation along one axis is half its radius.
    blur = 0.5 * 1.0e-3 * (1.0 / 5.0e-3 - 1.0 / far) * (18.0 / 0.5)
    assert width(1.0e-3, 5.0e-3) == pytest.approx(np.hypot(sharp, blur), rel=0.05)


def test_a_map_of_the_coat_is_looked_up_where_it_was_drawn():
    directions = REST_M / np.linalg.norm(REST_M, axis=1, keepdims=True)
    column, row = (map_places(REST_M) * MAP_SIZE).astype(int).T
    found = map_directions()[row, column]
    # A texel is 0.4 degrees.
    assert np.min(np.sum(found * directions, axis=1)) > np.cos(0.006)


@pytest.fixture(scope="module")
def pressed_light(studio):
    """Skin and light (H, W, 3) of a press with nothing wrong: the same at any time."""
    skin = studio.smooth_skins(pressed_skins())[-1]
    return skin, studio.light(studio.unit, skin, 0.0, seed=7)


@pytest.fixture
def difference_of(studio, pressed_light):
    """What the largest size of a law does to the light of a press (H, W, 3), of white."""
    skin, light = pressed_light

    def difference(name, session_s=0.0):
        size = LAWS[name].sizes[-1]
        unit = LAWS[name].change(studio.unit, size, studio.white)
        return studio.light(unit, skin, session_s, seed=7) - light, light, size

    return difference


def test_leds_that_fade_do_so_with_time(studio, pressed_light, difference_of):
    skin, light = pressed_light
    np.testing.assert_array_equal(studio.light(studio.unit, skin, 4.0, seed=7), light)
    change, light, size = difference_of("fading_leds")
    np.testing.assert_array_equal(change, 0.0)
    change, light, size = difference_of("fading_leds", session_s=4.0)
    np.testing.assert_allclose(change, -0.5 * size * light, rtol=1e-4, atol=1e-9)


def test_a_weak_colour_is_missed_most_in_its_own_channel(difference_of):
    change, light, size = difference_of("weak_green")
    lost = -change.sum(axis=(0, 1)) / light.sum(axis=(0, 1))
    assert 0.8 * size < lost[1] < size
    assert max(lost[0], lost[2]) < 0.15 * size
    change, light, size = difference_of("one_weak_blue")
    lost = -change.sum(axis=(0, 1)) / light.sum(axis=(0, 1))
    assert 0.2 * size < lost[2] < 0.45 * size


def test_a_worn_spot_is_darker_there(difference_of):
    change, light, size = difference_of("worn_spot")
    lost = -change.mean(axis=2) / np.maximum(light.mean(axis=2), 0.02)
    row, column = np.unravel_index(np.argmax(lost), lost.shape)
    assert lost.max() > 0.5 * size
    assert np.median(np.abs(lost)) < 0.02
    # It was put to the left of the axis and below.
    assert column < 16
    assert row > 11


@pytest.mark.parametrize("name", ["turned_camera", "out_of_focus", "dusty"])
def test_what_is_wrong_with_the_camera_changes_the_image(difference_of, name):
    change, light, _ = difference_of(name)
    assert np.sqrt(np.mean(change**2)) > 0.01 * np.sqrt(np.mean(light**2))
    if name == "dusty":
        assert change.sum() < 0.0


def test_an_exposure_that_follows_keeps_the_metered_mean(studio):
    unit = LAWS["metering"].change(studio.unit, 1.0, studio.white)
    bright = replace(unit, inside=replace(unit.inside, led_power=np.full(9, 2.0)))
    as_it_was = studio.photograph(studio.unit, None, 0.0, np.random.default_rng(0)).astype(float)
    followed = studio.photograph(bright, None, 0.0, np.random.default_rng(0)).astype(float)
    assert np.abs(followed - as_it_was).mean() < 1.0


def test_a_data_set_of_a_unit_is_whole_and_its_noise_the_seed_s(source, mitsuba, tmp_path):
    studio = Studio(source, mitsuba, width=16, height=12, sample_count=4)
    for name, seed in (("one", 1), ("same", 1), ("other", 2)):
        studio.measure(tmp_path / name, ["press"], studio.unit, frames=2, seed=seed)
    data_set = read_data_set(tmp_path / "one")
    (entry,) = data_set.entries
    assert entry.has_images
    assert len(data_set.idle_images()) == IDLE_COUNT
    assert data_set.indenter_file(entry.indenter).is_file()
    found = [read_data_set(tmp_path / n).entries[0].read() for n in ("one", "same", "other")]
    assert found[0].image is not None
    assert found[0].image.pixels.shape == (2, 12, 16, 3)
    np.testing.assert_array_equal(found[0].image.stamp_ns, [1_000_000_000, 5_000_000_000])
    np.testing.assert_array_equal(found[0].image.pixels, found[1].image.pixels)
    assert np.any(found[0].image.pixels != found[2].image.pixels)
    idles = [cv2.imread(str(path)) for path in data_set.idle_images()]
    assert not np.array_equal(idles[0], idles[1])
    with pytest.raises(FileExistsError, match="name a folder"):
        studio.measure(tmp_path / "one", ["press"], studio.unit, frames=2, seed=1)


def test_smoothing_takes_noise_and_leaves_dents(studio):
    skins = pressed_skins().astype(np.float64)
    noisy = skins + 0.04e-3 * np.random.default_rng(0).standard_normal(skins.shape)
    smooth = studio.smooth_skins(noisy)
    assert (smooth[0] - REST_M).std() < 0.012e-3
    assert np.abs(smooth[2] - skins[2]).max() < 0.15e-3


def test_only_an_llvm_that_works_is_chosen(tmp_path, monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    for name in ("libLLVM-14.so.1", "libLLVM-15.so"):
        (tmp_path / name).touch()
    assert llvm_library([str(tmp_path)]) is None
    (tmp_path / "libLLVM.so.19.1").touch()
    (tmp_path / "libLLVM-17.so.1").touch()
    assert llvm_library([str(tmp_path)]) == tmp_path / "libLLVM.so.19.1"
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-14.so.1"))
    assert llvm_library([str(tmp_path)]) == tmp_path / "libLLVM.so.19.1"
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM-17.so.1"))
    assert llvm_library([str(tmp_path)]) == tmp_path / "libLLVM-17.so.1"
