"""The optical effects: each against its closed form, and none of them at its none-values."""

import cv2
import numpy as np
import pytest

from dotsim_ros.effects.effect import IMAGE, Active, SeenImage, image_filters
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.optical_terms import sampled
from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.measured.presses import Press
from dotsim_ros.measured.recording import Phase, Recording

HEIGHT, WIDTH = 48, 64
CENTRE = np.array([33.0, 22.0])
FOCAL = 16.0
EFFECTS = {name: effect for name, effect in load_effects().items() if effect.image is not None}
STATIC = (
    "ambient_light",
    "camera_extrinsics",
    "camera_intrinsics",
    "gamma",
    "led_imbalance_blue",
    "led_imbalance_green",
    "led_imbalance_red",
    "saturation",
    "vignetting",
    "worn_coat",
)
MOVING = ("motion_blur", "rolling_shutter")


def seen_image(**changes):
    """Return a smooth image that fills the scale."""
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


def test_the_optical_half_of_the_library_is_complete():
    assert set(EFFECTS) == {*STATIC, *MOVING, "auto_exposure", "led_dimming"}
    for effect in EFFECTS.values():
        assert effect.channels == (IMAGE,)
        assert not effect.needs_solve
        assert effect.parameters[0].none is not None


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_an_effect_of_no_size_changes_nothing(name):
    nothing = {p.name: p.none for p in EFFECTS[name].parameters if p.none is not None}
    image = seen_image()
    # What is resampled is so in single precision.
    np.testing.assert_allclose(seen_with(name, image, **nothing), image.pixels, rtol=1e-6)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_every_probe_lies_in_range_and_stays_on_the_scale(name):
    effect = EFFECTS[name]
    image = seen_image(pixels=np.linspace(0.0, 255.0, HEIGHT * WIDTH * 3).reshape(HEIGHT, WIDTH, 3))
    for parameter in effect.parameters:
        assert parameter.probes
        for probe in parameter.probes:
            assert parameter.low <= probe <= parameter.high
            seen = seen_with(name, image, **{parameter.name: probe})
            assert seen.shape == image.pixels.shape
            assert seen.min() >= 0.0
            assert seen.max() <= 255.0


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_a_filter_changes_no_input_and_repeats_itself(name):
    effect = EFFECTS[name]
    image = seen_image(idle=np.full((HEIGHT, WIDTH, 3), 80.0))
    before = image.pixels.copy()
    one = effect.image(effect.checked({}))
    first, second = one(image), one(image)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(effect.image(effect.checked({}))(image), first)
    np.testing.assert_array_equal(image.pixels, before)
    assert np.abs(first - before).max() > 0.0 or name == "saturation"


@pytest.mark.parametrize("shift", [0.04, 0.12, 0.25, 0.5, 0.7, -0.12, 1.3])
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


def test_a_centre_that_moves_by_whole_pixels_shifts_the_image():
    image = seen_image()
    seen = seen_with(
        "camera_intrinsics",
        image,
        focal_ratio=1.0,
        shift_x_rad=2.0 / FOCAL,
        shift_y_rad=-3.0 / FOCAL,
    )
    np.testing.assert_allclose(seen[:-3, 2:], image.pixels[3:, :-2], rtol=1e-6)


def test_a_longer_lens_enlarges_about_the_optical_axis():
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    cone = np.repeat(np.hypot(x - CENTRE[0], y - CENTRE[1])[..., None], 3, axis=2)
    seen = seen_with("camera_intrinsics", seen_image(pixels=cone), focal_ratio=1.05)
    inner = (slice(5, 40), slice(5, 55))
    far = cone[inner] > 3.0
    np.testing.assert_allclose(seen[inner][far], cone[inner][far] / 1.05, atol=0.1)


def test_a_tilted_camera_sees_each_ray_where_a_turned_camera_does():
    camera = FisheyeCamera(WIDTH, HEIGHT, FOCAL, CENTRE)
    rays, _ = camera.rays()
    # An image that is a smooth function of the ray: turning it has a closed form.
    angle = 0.05
    turn = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, np.cos(angle), -np.sin(angle)],
            [0.0, np.sin(angle), np.cos(angle)],
        ]
    )
    pixels = 100.0 + 60.0 * rays
    seen = seen_with("camera_extrinsics", seen_image(pixels=pixels), tilt_x_rad=angle)
    expected = 100.0 + 60.0 * rays @ turn.T
    inner = (slice(5, 40), slice(10, 55))
    np.testing.assert_allclose(seen[inner], expected[inner], atol=0.3)
    assert np.abs(seen[inner] - pixels[inner]).max() > 2.0


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


@pytest.mark.parametrize(("colour", "channel"), [("red", 0), ("green", 1), ("blue", 2)])
def test_leds_out_of_balance_change_their_colour_alone(colour, channel):
    seen = seen_with(f"led_imbalance_{colour}", seen_image(), loss_share=0.1)
    ratio = seen / seen_image().pixels
    for other in range(3):
        np.testing.assert_allclose(ratio[..., other], 0.9 if other == channel else 1.0)


def test_auto_exposure_brings_the_mean_back_to_that_of_the_idle_frame():
    image = seen_image(pixels=0.8 * seen_image().pixels)
    full = seen_with("auto_exposure", image, strength=1.0)
    assert full.mean() == pytest.approx(image.idle.mean())
    half = seen_with("auto_exposure", image, strength=0.5)
    np.testing.assert_allclose(half, image.pixels / np.sqrt(0.8))
    still = seen_image()
    np.testing.assert_allclose(seen_with("auto_exposure", still, strength=1.0), still.pixels)


def test_a_black_image_does_not_drive_the_exposure_without_bound():
    black = seen_image(pixels=np.zeros((HEIGHT, WIDTH, 3)))
    np.testing.assert_array_equal(seen_with("auto_exposure", black, strength=1.0), black.pixels)


def test_gamma_keeps_black_and_white():
    pixels = np.zeros((HEIGHT, WIDTH, 3))
    pixels[0], pixels[1], pixels[2] = 255.0, 63.75, 0.0
    seen = seen_with("gamma", seen_image(pixels=pixels), exponent=0.9)
    np.testing.assert_allclose(seen[0], 255.0)
    np.testing.assert_allclose(seen[1], 255.0 * 0.25**0.9)
    np.testing.assert_allclose(seen[2], 0.0)


def test_ambient_light_adds_the_same_everywhere():
    seen = seen_with("ambient_light", seen_image(), added_share=0.03)
    np.testing.assert_allclose(seen - seen_image().pixels, 0.03 * 255.0)


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


@pytest.mark.parametrize("name", MOVING)
def test_what_stands_still_is_neither_blurred_nor_skewed(name):
    still = seen_image(flow_px_s=np.zeros((HEIGHT, WIDTH, 2)))
    np.testing.assert_array_equal(seen_with(name, still), still.pixels)


def test_saturation_clips_what_is_above_its_level_alone():
    seen = seen_with("saturation", seen_image(), clip_share=0.5)
    np.testing.assert_array_equal(seen, np.minimum(seen_image().pixels, 127.5))


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
    for name in STATIC:
        assert EFFECTS[name].excited_by(hold)
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


def test_effects_follow_one_another():
    actives = [
        Active(EFFECTS["led_imbalance_red"], {"loss_share": 0.5}),
        Active(EFFECTS["ambient_light"], {"added_share": 0.1}),
    ]
    seen = image_filters(actives)(seen_image())
    np.testing.assert_allclose(seen[..., 0], 0.5 * seen_image().pixels[..., 0] + 25.5)
    back = image_filters(actives[::-1])(seen_image())
    np.testing.assert_allclose(back[..., 0], 0.5 * (seen_image().pixels[..., 0] + 25.5))
