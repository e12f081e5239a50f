# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The samples between an idle image's pixels: learned from presses, kept in a file, warped."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.io.files import write_image
from dotsim_ros.learning.pattern import with_learned_pattern
from dotsim_ros.optics.idle import check_fine, fine_path, lit_region, read_idle_frame
from dotsim_ros.optics.image import ImageRenderer, double_resolution
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import load_sensor
from dotsim_ros.twin.footage import FilmedData, FilmedPress, render_filmed

RADIUS_M = 0.01575
NOISE_LEVELS = 3.0
LIGHTING = Lighting()
VIGNETTING = Vignetting((-0.2,))


@pytest.fixture(scope="module")
def camera():
    return Camera.from_specification(load_sensor("densetact2").camera).scaled(160, 120)


@pytest.fixture(scope="module")
def dome():
    return dome_skin(RADIUS_M, 0.8e-3)


@pytest.fixture(scope="module")
def fine(camera):
    """Return a disc of blotches that are no larger than a pixel, sampled twice a pixel."""
    random = np.random.default_rng(0)
    height, width = 2 * camera.height - 1, 2 * camera.width - 1
    spots = cv2.GaussianBlur(random.standard_normal((height, width, 1)), (0, 0), 0.8)
    pattern = 120.0 + 60.0 * np.sign(spots)[..., None] * np.array([1.0, 0.8, 0.6])
    bright = double_resolution(VIGNETTING.brightness(camera))
    image = np.rint(pattern * bright[..., None]).astype(np.uint8)
    rows, columns = np.mgrid[0:height, 0:width]
    outside = np.hypot(columns - width / 2, rows - height / 2) > 0.9 * height / 2
    image[outside] = 0
    return image


def press(mesh, azimuth_rad, depth_m):
    """Return the skin (4, V, 3), untouched first, pressed ever deeper to the side."""
    axis = np.array([0.4 * np.cos(azimuth_rad), 0.4 * np.sin(azimuth_rad), 0.9])
    axis /= np.linalg.norm(axis)
    distance = np.linalg.norm(mesh.rest_position_m - RADIUS_M * axis, axis=1)
    dent = np.exp(-((distance / 0.006) ** 2))[:, None]
    way = -axis + 0.5 * np.array([axis[1], -axis[0], 0.0])
    shares = np.linspace(0.0, 1.0, 4)[:, None, None]
    return (mesh.rest_position_m + shares * depth_m * dent * way).astype(np.float32)


@pytest.fixture(scope="module")
def filmed(camera, dome, fine):
    """Return presses as a camera with noise takes them, the last to judge on."""
    random = np.random.default_rng(1)
    renderer = SkinRenderer(camera, dome)
    idle = np.ascontiguousarray(fine[::2, ::2])
    scene = ImageRenderer(camera, dome, idle, lighting=LIGHTING, vignetting=VIGNETTING, fine=fine)

    def noisy(image):
        level = image + NOISE_LEVELS * random.standard_normal(image.shape)
        return np.clip(np.rint(level), 0, 255).astype(np.uint8) * (idle > 0)

    presses = []
    for number in range(9):
        skin = press(dome, 0.7 * number, 0.002 + 1e-4 * number)
        images = np.stack([noisy(scene.warp(renderer.render(s))) for s in skin])
        depth_m = 1e-3 * np.arange(4.0)
        presses.append(
            FilmedPress(f"press_{number}", "ball", depth_m, images, skin, np.arange(4.0))
        )
    return FilmedData(dome, noisy(idle), tuple(presses))


@pytest.fixture(scope="module")
def learned(filmed, camera):
    names = [p.name for p in filmed.presses[:-1]]
    return with_learned_pattern(
        filmed, camera, lighting=LIGHTING, vignetting=VIGNETTING, presses=names
    )


def judged_psnr_db(data, camera):
    """Return the PSNR of the last frame of the press that nothing was learned from."""
    data = replace(data, presses=data.presses[-1:])
    (seen,) = render_filmed(data, camera, lighting=LIGHTING, vignetting=VIGNETTING).presses
    error = seen.warped[-1].astype(float) - seen.measured[-1]
    return 10.0 * np.log10(255.0**2 / np.mean(error**2))


def test_another_press_is_met_better_by_what_was_learned(filmed, learned, camera):
    assert judged_psnr_db(learned, camera) > judged_psnr_db(filmed, camera) + 1.5


def test_presses_that_are_judged_play_no_part(filmed, learned, camera):
    others = replace(filmed, presses=filmed.presses[:-1])
    alone = with_learned_pattern(others, camera, lighting=LIGHTING, vignetting=VIGNETTING)
    assert np.array_equal(alone.fine, learned.fine)


def test_the_image_at_rest_is_the_learned_idle_image(learned, camera, dome):
    image = ImageRenderer(
        camera, dome, learned.idle, lighting=LIGHTING, vignetting=VIGNETTING, fine=learned.fine
    )
    at_rest = image.warp(SkinRenderer(camera, dome).render(dome.rest_position_m))
    assert np.array_equal(at_rest, learned.idle)


def test_samples_of_another_idle_image_are_refused(filmed, learned):
    with pytest.raises(ValueError, match="belong to another idle image"):
        check_fine(learned.fine, np.clip(learned.idle, 0, 254) + np.uint8(1))
    with pytest.raises(ValueError, match=r"expected \(239, 319, 3\) uint8"):
        check_fine(learned.idle, learned.idle)


@pytest.fixture
def stored(learned, tmp_path):
    write_image(tmp_path / "idle.png", learned.idle)
    write_image(fine_path(tmp_path / "idle.png"), learned.fine)
    return tmp_path / "idle.png"


def test_samples_beside_an_idle_image_are_read_with_it(stored, learned, camera):
    frame = read_idle_frame(stored, camera)
    assert np.array_equal(frame.image, learned.idle)
    assert np.array_equal(frame.fine, learned.fine)


def test_a_larger_camera_gets_a_sharper_image_that_is_whole_at_rest(stored, camera, dome, fine):
    width = 200
    larger = camera.scaled(width, width * 3 // 4)
    frame = read_idle_frame(stored, larger)
    image = ImageRenderer(larger, dome, frame.image, fine=frame.fine)
    view = SkinRenderer(larger, dome).render(dome.rest_position_m)
    assert np.array_equal(image.warp(view), frame.image)
    fine_path(stored).unlink()
    enlarged = read_idle_frame(stored, larger).image
    # Where a pixel of the camera lies in the true samples.
    at = (np.arange(width) + 0.5) * 160 / width * 2.0 - 1.0
    down = (np.arange(width * 3 // 4) + 0.5) * 160 / width * 2.0 - 1.0
    x, y = np.meshgrid(at.astype(np.float32), down.astype(np.float32))
    true = cv2.remap(fine, x, y, cv2.INTER_CUBIC)
    moved = np.hypot(x - 159.0, y - 119.0) < 60.0
    error = [np.std((i.astype(float) - true)[moved]) for i in (frame.image, enlarged)]
    assert error[0] < 0.8 * error[1]


def test_a_smaller_camera_does_without(stored, camera):
    frame = read_idle_frame(stored, camera.scaled(80, 60))
    assert frame.fine is None
    assert lit_region(frame.image).any()


def test_a_file_of_samples_that_does_not_belong_is_refused(stored, learned, camera):
    write_image(stored, np.flip(learned.idle, axis=1))
    with pytest.raises(ValueError, match=r"idle\.png: the samples between .* another idle image"):
        read_idle_frame(stored, camera)
