# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real presses of a ball on a flat gel: reading, shapes, and the camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.data.contact_circle import BallPress
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import (
    GelSpecification,
    SensorSpecification,
    SolverSpecification,
)
from dotsim_ros.twin.ball_presses import (
    LEAST_PAD_M,
    FlatScene,
    PressProfiles,
    flat_camera,
    flat_scene,
    gel_presses,
    press_profiles,
)
from studies.optics.ball_recordings import (
    FOTS,
    RECORDINGS,
    BallRecording,
    read_ball_recording,
)
from studies.optics.gelsight import (
    SENSOR,
    BallStudy,
    cap_presses,
    with_gains_of,
)

BALL_RADIUS_M = RECORDINGS[FOTS].ball_radius_m
PIXELS_PER_METRE = RECORDINGS[FOTS].pixels_per_metre
SIZE = (80, 60)
COARSE = replace(
    SENSOR,
    gel=GelSpecification(shape="flat_pad", pad_size_m=(0.012, 0.012, 0.004), skin_spacing_m=0.4e-3),
    solver=SolverSpecification(grid_spacing_m=2.0e-3, refined=False),
)


def image(level: int = 120) -> NDArray[np.uint8]:
    """Return an image of one grey."""
    return np.full((*SIZE, 3), level, dtype=np.uint8)


def ball_press(centre: tuple[float, float] = (30.0, 45.0), radius: float = 30.0) -> BallPress:
    """Return a press with a circle of contact."""
    return BallPress("0001.png", np.array(centre), radius, image(130))


def scene() -> FlatScene:
    """Return a camera over a pad that fills it."""
    return flat_scene(image(), COARSE, PIXELS_PER_METRE)


@pytest.fixture(scope="module")
def profiles() -> PressProfiles:
    """What a ball does to a coarse pad."""
    return press_profiles(COARSE, BALL_RADIUS_M)


def photograph(*discs: tuple[int, int], size: tuple[int, int] = (160, 120)) -> NDArray[np.uint8]:
    """Return what a ball of 16 pixels does to an even grey: a bright ring with a dim middle."""
    level = np.full((*size, 3), 120.0)
    y, x = np.mgrid[: size[0], : size[1]]
    for centre in discs:
        distance = np.hypot(x - centre[0], y - centre[1]) / 16.0
        slope = np.where(distance < 1.0, distance, np.exp(-3.0 * (distance - 1.0)))
        level += slope[..., None] * np.array([60.0, -30.0, 20.0])
    return np.asarray(level, dtype=np.uint8)


def write_recording(folder: Path, table: str, pressed: NDArray[np.uint8]) -> None:
    """Write an idle image, one of a press, and the table of circles."""
    cv2.imwrite(str(folder / "idle.png"), photograph())
    cv2.imwrite(str(folder / "0001.png"), cv2.cvtColor(pressed, cv2.COLOR_RGB2BGR))
    (folder / "contact_circles.csv").write_text("img_names,center_x,center_y,radius\n" + table)


def test_a_recording_is_read(tmp_path: Path) -> None:
    write_recording(tmp_path, "0001.png,50,70,16\n", photograph((50, 70)))
    recording = read_ball_recording(tmp_path, FOTS)
    (press,) = recording.presses
    assert (press.name, press.centre_px.tolist(), press.radius_px) == ("0001.png", [50, 70], 16)
    assert np.array_equal(press.image, photograph((50, 70)))
    assert recording.idle.shape == (160, 120, 3)


@pytest.mark.parametrize(
    ("table", "pressed", "words"),
    [
        (
            "0001.png,50,wide,16\n",
            photograph((50, 70)),
            r"line 2, column center_y: 'wide' is not a",
        ),
        ("0009.png,50,70,16\n", photograph((50, 70)), r"no image .*0009\.png"),
        ("0001.png,50,70,16\n", photograph(), "shows no ball"),
        ("0001.png,30,30,16\n", photograph((30, 30), (85, 120)), "shows two contacts"),
        ("0001.png,30,30,16\n", photograph((85, 120)), "is at pixel .* mark the circle again"),
    ],
)
def test_bad_recordings_are_refused(
    tmp_path: Path, table: str, pressed: NDArray[np.uint8], words: str
) -> None:
    write_recording(tmp_path, table, pressed)
    with pytest.raises((ValueError, FileNotFoundError), match=words):
        read_ball_recording(tmp_path, FOTS)


def test_the_published_recordings_are_read() -> None:
    real = Path(__file__).parents[3] / "shared" / "real"
    if not real.is_dir():
        pytest.skip("the recordings are not here")
    recording = read_ball_recording(real / "gelsight_taxim", "taxim_gelsight_mini")
    assert len(recording.presses) == 18
    assert recording.idle.shape == (480, 640, 3)


def test_an_image_takes_the_gains_of_a_photograph() -> None:
    press = replace(ball_press(radius=10.0), image=image(150))
    assert np.array_equal(with_gains_of(image(100), press), image(150))


def test_a_millimetre_has_its_pixels_everywhere() -> None:
    camera = flat_camera(240, 320, 0.004, PIXELS_PER_METRE)
    face = np.array([[x, y, 0.004] for x in (-5e-3, 0.0, 5e-3) for y in (-7e-3, 0.0, 7e-3)])
    pixels = camera.project(face)
    expected = face[:, :2] * PIXELS_PER_METRE + camera.principal_point_px
    assert pixels == pytest.approx(expected, abs=1e-3)


def test_a_cap_is_the_ball() -> None:
    flat = scene()
    press = ball_press()
    given = gel_presses([press], flat, still())
    (capped,) = cap_presses([press], given, flat, BALL_RADIUS_M)
    row, column = 45, 30
    contact = 30.0 / PIXELS_PER_METRE
    deepest = BALL_RADIUS_M - np.sqrt(BALL_RADIUS_M**2 - contact**2)
    sunk = flat.rest.depth_m - capped.depth_m[0]
    assert sunk[row, column] == pytest.approx(deepest, abs=2e-7)
    assert sunk[5, 55] == 0.0
    assert capped.normal[0, row, column] == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)
    across = 20.0 / PIXELS_PER_METRE / BALL_RADIUS_M
    expected = [across, 0.0, -np.sqrt(1.0 - across**2)]
    assert capped.normal[0, row, column + 20] == pytest.approx(expected, abs=1e-6)
    assert np.linalg.norm(capped.normal[0], axis=-1) == pytest.approx(np.ones(SIZE), abs=1e-5)


def still() -> PressProfiles:
    """Return profiles of a pad that nothing moves."""
    return PressProfiles(np.array([0.0, 1.0]), np.array([0.0, 1.0]), *np.zeros((2, 2, 2)))


def test_a_pad_that_does_not_move_shows_the_idle_image() -> None:
    flat = scene()
    (press,) = gel_presses([ball_press()], flat, still())
    assert np.array_equal(press.warped[0], flat.rest.idle)
    assert press.depth_m[0] == pytest.approx(flat.rest.depth_m)
    assert np.array_equal(press.measured[0], image(130))


def test_a_profile_is_laid_around_its_axis() -> None:
    flat = scene()
    distance = np.linspace(0.0, 3e-3, 31)
    down = -np.clip(1e-3 - distance, 0.0, None)
    one = PressProfiles(np.array([1e-3, 2e-3]), distance, np.zeros((2, 31)), np.stack([down] * 2))
    axis = np.array([1e-3, -2e-3])
    moved = one.displace(flat.skin, axis, 1.5e-3) - flat.skin.rest_position_m
    near = np.linalg.norm(flat.skin.rest_position_m[:, :2] - axis, axis=1)
    assert moved[:, 2] == pytest.approx(-np.clip(1e-3 - near, 0.0, None), abs=1e-9)
    assert np.all(moved[:, :2] == 0.0)


def test_deeper_presses_touch_more(profiles: PressProfiles) -> None:
    assert np.all(np.diff(profiles.contact_radius_m) > 0.0)
    assert profiles.contact_radius_m[-1] < BALL_RADIUS_M
    middle = profiles.upward_m[:, 0]
    assert np.all(np.diff(middle) < 0.0)
    assert middle[-1] < -1.9e-3
    assert np.abs(profiles.upward_m[:, -1]).max() < 0.3e-3


def test_a_large_ball_is_pressed_as_deep_as_the_pad_takes_it_or_as_is_asked() -> None:
    found = press_profiles(COARSE, 4.0e-3)
    # A clearance of 1.5 mm is left of the pad's 4 mm, and a margin.
    assert found.upward_m[-1].min() == pytest.approx(-2.4e-3, abs=0.1e-3)
    assert found.contact_radius_m[-1] > 2.8e-3
    asked_m = 1.2e-3
    found = press_profiles(COARSE, 10.0e-3, asked_m)
    assert found.contact_radius_m[0] < asked_m < 1.5 * asked_m < found.contact_radius_m[-1]


def test_a_thin_pad_is_pressed_and_one_that_is_too_thin_says_so() -> None:
    def of_thickness(thickness_m: float) -> SensorSpecification:
        return replace(
            COARSE,
            gel=replace(COARSE.gel, pad_size_m=(0.012, 0.012, thickness_m)),
            solver=replace(COARSE.solver, grid_spacing_m=0.8e-3),
            camera=replace(COARSE.camera, position_m=(0.0, 0.0, -0.02)),
        )

    found = press_profiles(of_thickness(LEAST_PAD_M), BALL_RADIUS_M)
    assert found.upward_m[-1].min() < -0.05e-3
    with pytest.raises(ValueError, match=r"is 1\.6 mm thick, expected 1\.7 or more"):
        press_profiles(of_thickness(1.6e-3), BALL_RADIUS_M)


def test_the_gel_shows_the_circle_that_was_marked(profiles: PressProfiles) -> None:
    flat = scene()
    press = ball_press(centre=(30.0, 45.0), radius=34.0)
    position = profiles.displace(flat.skin, flat.axis_m(press), 34.0 / PIXELS_PER_METRE)
    view = SkinRenderer(flat.camera, flat.skin).render(position)
    row, column = np.unravel_index(np.nanargmin(view.depth_m), view.depth_m.shape)
    assert (column, row) == (pytest.approx(30, abs=6), pytest.approx(45, abs=6))


def test_a_training_is_kept_for_its_gel_and_its_presses() -> None:
    presses = (ball_press(), ball_press((35.0, 40.0)))
    recording = BallRecording(
        "balls",
        image(),
        presses,
        pixels_per_metre=PIXELS_PER_METRE,
        scale_known=True,
        ball_radius_m=BALL_RADIUS_M,
    )
    study = BallStudy.of(recording, sensor=COARSE)
    thicker = replace(COARSE.gel, pad_size_m=(0.012, 0.012, 0.0041))
    other = BallStudy.of(recording, sensor=replace(COARSE, gel=thicker))
    assert len({study.training_key([0]), study.training_key([1]), other.training_key([0])}) == 3
