# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The optical effects: each against its closed form, and none of them at its none-values."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from dotsim_ros.data.presses import Press
from dotsim_ros.data.recording import Phase, Recording
from dotsim_ros.effects.effect import IMAGE, Active, SeenImage, image_filters
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.optical_terms import sampled
from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.geometry.pose import Pose

HEIGHT, WIDTH = 48, 64
CENTRE = np.array([33.0, 22.0])
FOCAL = 16.0
EFFECTS = {name: effect for name, effect in load_effects().items() if effect.image is not None}
MOVING = ("motion_blur", "rolling_shutter")


def rays(aspect=1.0):
    """Return the directions (H, W, 3) of the pixels."""
    return FisheyeCamera(WIDTH, HEIGHT, FOCAL, CENTRE, pixel_aspect=aspect).rays()[0]


def seen_image(**changes):
    """Return a smooth image that fills the scale, of a dome around the camera."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    pixels = np.stack([100.0 + 60.0 * np.sin(0.3 * x + k) * np.cos(0.25 * y) for k in range(3)], 2)
    values = {
        "stamp_s": 1.0,
        "session_s": 60.0,
        "pixels": pixels,
        "idle": pixels,
        "centre_px": CENTRE,
        "focal_px": FOCAL,
        "flow_px_s": np.broadcast_to([40.0, -20.0], (HEIGHT, WIDTH, 2)),
        "depth_m": np.full((HEIGHT, WIDTH), 15e-3),
        "normal": -rays(),
    }
    return SeenImage(**{**values, **changes})


def seen_with(name, image, **values):
    """Return what a fresh filter of one effect makes of an image."""
    effect = EFFECTS[name]
    return image_filters([Active(effect, effect.checked(values))])(image)


def recording_of(phase, *, speed_m_s=0.0, session_s=0.0):
    position = 0.1 * speed_m_s * np.arange(3)
    press = Press(
        "press",
        "ball",
        [Pose(np.array([x, 0.0, 0.02])) for x in position],
        0.1 * np.arange(3),
    )
    return Recording(press, None, session_s, np.full(3, 1e-3), (Phase.IDLE, phase, phase))


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_an_effect_of_no_size_changes_nothing_and_no_probe_leaves_the_scale_or_its_input(name):
    effect = EFFECTS[name]
    assert effect.channels == (IMAGE,)
    nothing = {p.name: p.none for p in effect.parameters if p.none is not None}
    image = seen_image(pixels=np.linspace(0.0, 255.0, HEIGHT * WIDTH * 3).reshape(HEIGHT, WIDTH, 3))
    image = replace(image, idle=image.pixels)
    # What is resampled is so in single precision.
    np.testing.assert_allclose(
        seen_with(name, image, **nothing), image.pixels, rtol=1e-6, atol=1e-4
    )
    before = image.pixels.copy()
    for probe in effect.parameters[0].probes:
        one = effect.image(effect.checked({effect.parameters[0].name: probe}))
        seen = one(image)
        assert 0.0 <= seen.min() <= seen.max() <= 255.0
        np.testing.assert_array_equal(one(image), seen)
        np.testing.assert_array_equal(image.pixels, before)
    if name in MOVING:
        still = seen_image(flow_px_s=np.zeros((HEIGHT, WIDTH, 2)))
        np.testing.assert_array_equal(seen_with(name, still), still.pixels)


@pytest.mark.parametrize("shift", [0.12, -0.12, 1.3])
def test_a_slope_is_looked_up_at_its_place(shift):
    x, y = np.meshgrid(np.arange(20.0), np.arange(16.0))
    slope = np.repeat((3.0 * x + 2.0 * y)[..., None], 3, axis=2)
    found = sampled(slope, x + shift, y + shift)[4:12, 4:16]
    # OpenCV 4 knows 32 places between two pixels.
    near = 1e-4 if int(cv2.__version__.partition(".")[0]) >= 5 else 0.12
    np.testing.assert_allclose(found, slope[4:12, 4:16] + 5.0 * shift, atol=near)


def test_a_resampling_follows_a_image_of_another_size():
    effect = EFFECTS["camera_intrinsics"]
    one = effect.image(effect.checked({"focal_ratio": 1.02}))
    large, small = seen_image(), seen_image(pixels=seen_image().pixels[:30, :40])
    one(large)
    fresh = effect.image(effect.checked({"focal_ratio": 1.02}))(small)
    np.testing.assert_array_equal(one(small), fresh)


@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_a_centre_that_moves_by_whole_pixels_shifts_the_image(aspect):
    image = seen_image(pixel_aspect=aspect)
    seen = seen_with(
        "camera_intrinsics",
        image,
        focal_ratio=1.0,
        shift_x_rad=2.0 / (aspect * FOCAL),
        shift_y_rad=-3.0 / FOCAL,
    )
    np.testing.assert_allclose(seen[:-3, 2:], image.pixels[3:, :-2], rtol=1e-6)


@pytest.mark.parametrize("aspect", [1.0, 1.2])
def test_a_tilted_camera_sees_each_ray_where_a_turned_camera_does(aspect):
    # An image that is a smooth function of the ray: turning it has a closed form.
    angle = 0.05
    turn = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, np.cos(angle), -np.sin(angle)],
            [0.0, np.sin(angle), np.cos(angle)],
        ]
    )
    pixels = 100.0 + 60.0 * rays(aspect)
    image = seen_image(pixels=pixels, pixel_aspect=aspect)
    seen = seen_with("camera_extrinsics", image, tilt_x_rad=angle)
    expected = 100.0 + 60.0 * rays(aspect) @ turn.T
    inner = (slice(5, 40), slice(10, 55))
    np.testing.assert_allclose(seen[inner], expected[inner], atol=0.3)
    assert np.abs(seen[inner] - pixels[inner]).max() > 2.0


def on_a_plane(distance_m):
    """Return where (H, W, 3) the rays meet a plane across the optical axis, and the depth there;
    NaN where they do not."""
    cosine = np.where(rays()[..., 2] > 0.1, rays()[..., 2], np.nan)
    return rays() * (distance_m / cosine)[..., None], distance_m / cosine


def painted(point_m):
    """Return an image (H, W, 3) that is a smooth function of the place (H, W, 3)."""
    x, y = np.moveaxis(np.nan_to_num(point_m[..., :2]), -1, 0)
    return 100.0 + 50.0 * np.stack([np.sin(90.0 * x), np.cos(90.0 * y), np.sin(90.0 * (x + y))], -1)


@pytest.mark.parametrize("moved_m", [(4e-4, 0.0, 0.0), (-2e-4, 3e-4, 0.0), (0.0, 0.0, 5e-4)])
def test_a_displaced_camera_sees_each_point_from_its_new_place(moved_m):
    x_m, y_m, z_m = moved_m
    point_m, depth_m = on_a_plane(12e-3)
    image = seen_image(pixels=painted(point_m), depth_m=depth_m)
    seen = seen_with("camera_displacement", image, x_m=x_m, y_m=y_m, z_m=z_m)
    # The plane as it is seen from there.
    expected = painted(on_a_plane(12e-3 - z_m)[0] + np.array([x_m, y_m, 0.0]))
    near = np.linalg.norm(point_m[..., :2], axis=2) < 16e-3
    np.testing.assert_allclose(seen[near], expected[near], atol=0.3)
    assert np.abs(expected - image.pixels)[near].max() > 1.0


def seen_through_discs(diameter_px, pixels):
    """Return pixels of skin at 10 mm, each spread over a disc of so many pixels."""
    pupil_m = diameter_px / FOCAL / (1.0 / 10e-3 - 1.0 / 20e-3)
    image = seen_image(pixels=pixels, depth_m=np.full((HEIGHT, WIDTH), 10e-3))
    return seen_with("defocus", image, pupil_area_m2=0.25 * np.pi * pupil_m**2, focus_m=20e-3)


@pytest.mark.parametrize("diameter_px", [0.3, 2.5, 12.0])
def test_an_edge_out_of_focus_is_as_wide_as_its_disc(diameter_px):
    step = np.where(np.arange(WIDTH) < 32, 40.0, 200.0)
    pixels = np.broadcast_to(step[None, :, None], (HEIGHT, WIDTH, 3))
    edge = seen_through_discs(diameter_px, pixels)[22, :, 0]
    slope, place = np.diff(edge) / 160.0, np.arange(WIDTH - 1)
    assert slope.sum() == pytest.approx(1.0)
    variance = slope @ place**2 - (slope @ place) ** 2
    # The variance of a disc along an axis.
    assert variance == pytest.approx(diameter_px**2 / 16.0, rel=1e-6)


def test_skin_in_focus_stays_sharp_beside_skin_that_is_not():
    depth_m = np.where(np.arange(WIDTH) < 32, 20e-3, 10e-3) * np.ones((HEIGHT, 1))
    image = seen_image(depth_m=depth_m)
    seen = seen_with("defocus", image, pupil_area_m2=1e-6, focus_m=20e-3)
    np.testing.assert_array_equal(seen[:, :32], image.pixels[:, :32])
    assert np.abs(seen[:, 32:] - image.pixels[:, 32:]).max() > 0.3


def daylit(azimuth_rad, elevation_rad, diffuse_share):
    """Return (H, W) how much of the light falls on the skin that each pixel shows.

    It is that of a dome around the camera, whose outward normal is the ray.
    """
    image = seen_image()
    values = {"azimuth_rad": azimuth_rad, "elevation_rad": elevation_rad}
    seen = seen_with("daylight", image, added_share=0.08, diffuse_share=diffuse_share, **values)
    np.testing.assert_allclose(np.ptp(seen - image.pixels, axis=2), 0.0, atol=1e-12)
    return (seen - image.pixels)[..., 0] / (255.0 * 0.08)


def test_daylight_falls_on_the_side_that_faces_it():
    diffuse, direct = daylit(0.0, 0.0, 1.0), daylit(0.0, 0.0, 0.0)
    np.testing.assert_allclose(diffuse, 0.5 * (1.0 + rays()[..., 0]), atol=1e-12)
    np.testing.assert_allclose(direct, np.maximum(rays()[..., 0], 0.0), atol=1e-12)
    # A quarter of a turn off the axis, 25.1 px of it, the skin faces the light, or turns from it.
    for added, on_the_axis in ((diffuse, 0.5), (direct, 0.0)):
        assert added[22, 33] == pytest.approx(on_the_axis)
        assert added[22, 33 + 25] == pytest.approx(1.0, abs=1e-3)
        assert added[22, 33 - 25] == pytest.approx(0.0, abs=1e-3)
    assert daylit(0.5 * np.pi, 0.0, 1.0)[22 + 20, 33] > 0.9


def test_vignetting_falls_with_the_square_of_the_radius():
    seen = seen_with("vignetting", seen_image(), edge_loss=0.1)
    ratio = seen / seen_image().pixels
    assert ratio[22, 33] == pytest.approx(1.0)
    # Half the height from the axis the loss is what it is called.
    assert ratio[22 + 24, 33] == pytest.approx(0.9)
    assert ratio[22, 33 + 12] == pytest.approx(1.0 - 0.1 / 4.0)


def test_leds_dim_over_the_session_and_not_at_its_start():
    values = {"final_loss_share": 0.2, "time_s": 100.0}
    start = seen_image(session_s=0.0)
    np.testing.assert_array_equal(seen_with("led_dimming", start, **values), start.pixels)
    seen = seen_with("led_dimming", seen_image(session_s=100.0), **values)
    expected = seen_image().pixels * (1.0 - 0.2 * (1.0 - np.exp(-1.0)))
    np.testing.assert_allclose(seen, expected)


def test_auto_exposure_brings_the_mean_back_to_that_of_the_idle_frame():
    image = seen_image(pixels=0.8 * seen_image().pixels)
    full = seen_with("auto_exposure", image, strength=1.0)
    assert full.mean() == pytest.approx(image.idle.mean())
    half = seen_with("auto_exposure", image, strength=0.5)
    np.testing.assert_allclose(half, image.pixels / np.sqrt(0.8))
    black = seen_image(pixels=np.zeros((HEIGHT, WIDTH, 3)))
    np.testing.assert_array_equal(seen_with("auto_exposure", black, strength=1.0), black.pixels)


@pytest.mark.parametrize(
    ("name", "size", "expected"),
    [
        ("ambient_light", {"added_share": 0.03}, lambda pixels: pixels + 0.03 * 255.0),
        ("saturation", {"clip_share": 0.5}, lambda pixels: np.minimum(pixels, 127.5)),
        ("led_imbalance_red", {"loss_share": 0.1}, lambda pixels: pixels * [0.9, 1.0, 1.0]),
        ("led_imbalance_green", {"loss_share": 0.1}, lambda pixels: pixels * [1.0, 0.9, 1.0]),
        ("led_imbalance_blue", {"loss_share": 0.1}, lambda pixels: pixels * [1.0, 1.0, 0.9]),
    ],
)
def test_each_pixel_by_itself(name, size, expected):
    image = seen_image()
    np.testing.assert_allclose(seen_with(name, image, **size), expected(image.pixels))


def test_gamma_keeps_black_and_white():
    pixels = np.zeros((HEIGHT, WIDTH, 3))
    pixels[0], pixels[1], pixels[2] = 255.0, 63.75, 0.0
    seen = seen_with("gamma", seen_image(pixels=pixels), exponent=0.9)
    np.testing.assert_allclose(seen[0], 255.0)
    np.testing.assert_allclose(seen[1], 255.0 * 0.25**0.9)
    np.testing.assert_allclose(seen[2], 0.0)


def test_motion_blur_takes_the_mean_along_the_path():
    # A wave of length 20 px, moving along x at 50 px/s: the mean over an exposure of 0.2 s, half a
    # wave, lowers its amplitude by sinc(1/2) = 2 / pi.
    x = np.arange(WIDTH, dtype=float)
    wave = np.sin(2.0 * np.pi * x / 20.0)
    pixels = np.broadcast_to((100.0 + 50.0 * wave)[None, :, None], (HEIGHT, WIDTH, 3))
    flow = np.broadcast_to([50.0, 0.0], (HEIGHT, WIDTH, 2))
    seen = seen_with("motion_blur", seen_image(pixels=pixels, flow_px_s=flow), exposure_s=0.2)
    inner = slice(10, -10)
    expected = 100.0 + 50.0 * (2.0 / np.pi) * wave
    np.testing.assert_allclose(seen[:, inner, 0], np.tile(expected[inner], (HEIGHT, 1)), atol=0.5)


def test_a_rolling_shutter_skews_by_row():
    # A ramp along x, moving along x: a row read later by t shows what was v t to the left.
    x = np.arange(WIDTH, dtype=float)
    pixels = np.broadcast_to((3.0 * x)[None, :, None], (HEIGHT, WIDTH, 3))
    flow = np.broadcast_to([100.0, 0.0], (HEIGHT, WIDTH, 2))
    seen = seen_with("rolling_shutter", seen_image(pixels=pixels, flow_px_s=flow), readout_s=0.03)
    row = np.arange(HEIGHT) / (HEIGHT - 1) - 0.5
    expected = 3.0 * (x[None, :] - 100.0 * 0.03 * row[:, None])
    # OpenCV's cubic is no exact ramp.
    np.testing.assert_allclose(seen[:, 4:-4, 0], expected[:, 4:-4], atol=0.06 * 3.0)


def test_a_worn_spot_is_darkest_at_its_place():
    values = {"loss_share": 0.4, "x_rad": 0.5, "y_rad": -0.5, "radius_rad": 0.25}
    ratio = seen_with("worn_coat", seen_image(), **values) / seen_image().pixels
    row, column = 22 - 8, 33 + 8
    assert ratio[row, column] == pytest.approx(np.full(3, 0.6))
    assert ratio[row, column + 4] == pytest.approx(np.full(3, 1.0 - 0.4 * np.exp(-0.5)))


def test_what_excites_the_optical_effects():
    slow = recording_of(Phase.LOAD, speed_m_s=0.5e-3)
    fast = recording_of(Phase.LOAD, speed_m_s=5e-3)
    slide = recording_of(Phase.SLIDE, speed_m_s=5e-3)
    hold = recording_of(Phase.HOLD)
    assert EFFECTS["gamma"].excited_by(hold)
    for name in MOVING:
        assert [EFFECTS[name].excited_by(r) for r in (slow, fast, slide, hold)] == [
            False,
            True,
            True,
            False,
        ]
    assert EFFECTS["auto_exposure"].excited_by(slow)
    assert not EFFECTS["auto_exposure"].excited_by(hold)
    assert not EFFECTS["led_dimming"].excited_by(hold)
    assert EFFECTS["led_dimming"].excited_by(recording_of(Phase.HOLD, session_s=30.0))
