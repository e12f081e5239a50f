# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The image: the idle frame at rest, the pattern where the skin went, light where it turned."""

import cv2
import numpy as np
import pytest

from dotsim_ros.geometry.camera import Camera, FisheyeCamera
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.io.files import parameter_path
from dotsim_ros.optics import kernels
from dotsim_ros.optics.idle import fit_idle_image, read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting, PointLight, Vignetting
from dotsim_ros.optics.pattern import render_idle_image
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import GelSpecification, PatternSpecification, load_sensor

RADIUS_M = 0.01575
UNCHANGING = Lighting(ambient_fraction=1e9)


@pytest.fixture(scope="module")
def camera():
    return Camera.from_specification(load_sensor("densetact2").camera).scaled(320, 240)


@pytest.fixture(scope="module")
def dome():
    return dome_skin(RADIUS_M, 0.5e-3)


@pytest.fixture(scope="module")
def idle(camera):
    return read_idle_frame(parameter_path("images/densetact2_idle.png"), camera)


@pytest.fixture(scope="module")
def renderer(camera, dome):
    return SkinRenderer(camera, dome)


def turned(mesh, angle_deg):
    """Turn the whole skin about the optical axis, as if it slid on its sphere."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return mesh.rest_position_m @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T


def pressed(mesh):
    axis = np.array([0.3, 0.2, 0.9]) / np.linalg.norm([0.3, 0.2, 0.9])
    distance = np.linalg.norm(mesh.rest_position_m - RADIUS_M * axis, axis=1)
    return mesh.rest_position_m - 0.003 * np.exp(-((distance / 0.004) ** 2))[:, None] * axis


def psnr_db(image, expected):
    return 10.0 * np.log10(255.0**2 / np.mean((image.astype(float) - expected) ** 2))


@pytest.mark.parametrize("name", ["densetact2_idle.png", "densetact_real_idle.png"])
def test_image_at_rest_is_the_idle_frame_bit_for_bit(camera, dome, renderer, name):
    idle = read_idle_frame(parameter_path(f"images/{name}"), camera)
    images = ImageRenderer(
        camera, dome, idle.image, lighting=idle.lighting, vignetting=idle.vignetting
    )
    assert np.array_equal(images.render(renderer.render(dome.rest_position_m)), idle.image)


def test_pattern_turns_with_the_skin(camera, dome, renderer, idle):
    images = ImageRenderer(camera, dome, idle.image, lighting=UNCHANGING)
    image = images.render(renderer.render(turned(dome, 5.0)))
    x, y = (float(value) for value in camera.principal_point_px)
    # OpenCV's positive angles run against the clock on the screen; ours from x to y, with it.
    matrix = cv2.getRotationMatrix2D((x, y), -5.0, 1.0)
    expected = cv2.warpAffine(idle.image, matrix, (320, 240), flags=cv2.INTER_CUBIC)
    rows, columns = np.mgrid[0:240, 0:320]
    inner = np.hypot(columns - x, rows - y) < 105.0
    assert psnr_db(image[inner], expected[inner]) > 40.0
    assert psnr_db(idle.image[inner], expected[inner]) < 25.0


def test_vignetting_stays_with_the_camera(camera, dome, renderer):
    # A coat of one colour seen through a vignetting camera looks the same wherever it goes.
    vignetting = Vignetting((-0.5,))
    level = 200.0 * vignetting.brightness(camera)
    rows, columns = np.mgrid[0:240, 0:320]
    lit = np.hypot(columns - 159.5, rows - 119.5) < 125.0
    plain = np.where(lit, level, 0.0)[..., None].repeat(3, axis=2).round().astype(np.uint8)
    view = renderer.render(dome.rest_position_m + np.array([0.002, 0.0, 0.0]))
    kept = ImageRenderer(camera, dome, plain, lighting=UNCHANGING, vignetting=vignetting)
    warped = ImageRenderer(camera, dome, plain, lighting=UNCHANGING)
    assert np.abs(kept.render(view).astype(int) - plain).max() <= 1
    assert np.abs(warped.render(view).astype(int) - plain).max() > 5


def test_light_follows_the_inverse_square_and_the_cosine(camera, dome, renderer):
    # One white light in the middle: a dome shrunk about it gets brighter by the square.
    plain = np.full((240, 320, 3), 80, dtype=np.uint8)
    centre = Lighting(
        (PointLight((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),), ambient_fraction=1e-6, exponent=1.0
    )
    view = renderer.render(0.9 * dome.rest_position_m)
    image = ImageRenderer(camera, dome, plain, lighting=centre).render(view)
    middle = view.mask & (view.material_point_m[..., 2] > 0.002)
    assert np.abs(image[middle] - 80.0 / 0.9**2).max() < 1.0
    half = Lighting(centre.lights, ambient_fraction=1.0, exponent=0.5)
    image = ImageRenderer(camera, dome, plain, lighting=half).render(view)
    expected = 80.0 * np.sqrt((1.0 / 0.9**2 + 1.0) / 2.0)
    assert np.abs(image[middle] - expected).max() < 1.5


def test_kernels_of_a_cpu_colour_the_image_as_the_others_do(camera, dome, renderer, idle):
    # Moved beyond the rim, too: there the idle frame ends.
    position = 1.3 * pressed(dome) + np.array([0.004, 0.0, 0.0])
    view = renderer.render(position)
    images = ImageRenderer(
        camera, dome, idle.image, lighting=idle.lighting, vignetting=Vignetting((-0.3,))
    )
    image = images.render(view)
    images.pixel_kernels = kernels
    assert np.array_equal(image, images.render(view))
    assert np.count_nonzero(image != idle.image) > 100_000


def test_residual_is_added_and_clipped(camera, dome, renderer, idle):
    def brighten(depth_m, normal, warped):
        assert depth_m.shape == warped.shape[:2]
        return np.full(warped.shape, 100.4, dtype=np.float32)

    images = ImageRenderer(camera, dome, idle.image, completion=brighten)
    image = images.render(renderer.render(dome.rest_position_m))
    assert np.array_equal(image, np.minimum(idle.image.astype(int) + 100, 255))


def test_idle_image_of_another_size_or_kind_is_refused(camera, dome, idle):
    with pytest.raises(ValueError, match="fit_idle_image"):
        ImageRenderer(camera, dome, idle.image[:100])
    with pytest.raises(ValueError, match="uint8"):
        ImageRenderer(camera, dome, idle.image.astype(np.float32))
    line = FisheyeCamera(40, 1, 20.0, (19.5, 0.0))
    with pytest.raises(ValueError, match="two pixels each way"):
        ImageRenderer(line, dome, np.full((1, 40, 3), 90, dtype=np.uint8))
    with pytest.raises(ValueError, match="where its lit disc lies"):
        fit_idle_image(idle.image[:, :200], camera)
    with pytest.raises(ValueError, match="grey level"):
        fit_idle_image(np.zeros((240, 320, 3), np.uint8), camera)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lighting: {colour: 3}", "colour"),
        ("disc: {radius_px: 3}", "centre_px"),
        ("lamps: {}", "known are disc, lens, lighting, vignetting"),
        ("lens: {half_height_angle_deg: -3}", "lens is .*-3.*, expected half_height_angle_deg"),
        ("lens: {}", "lens is .*, expected half_height_angle_deg"),
        ("vignetting: {falloff: [a]}", "describes no idle image"),
        ("- 3", "describes no idle image"),
    ],
)
def test_broken_description_is_refused_by_its_name(tmp_path, camera, idle, text, message):
    cv2.imwrite(str(tmp_path / "mine.png"), idle.image)
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        read_idle_frame(tmp_path / "mine.png", camera)
    assert "mine.yaml" in str(caught.value)


def test_broken_or_missing_image_is_refused(tmp_path, camera):
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(ValueError, match="OpenCV can read"):
        read_idle_frame(tmp_path / "text.png", camera)
    with pytest.raises(FileNotFoundError):
        read_idle_frame(tmp_path / "none.png", camera)


def test_rendered_idle_image_repeats_and_looks_lit(camera):
    def render(seed):
        return render_idle_image(
            camera,
            GelSpecification(outer_radius_m=RADIUS_M),
            lighting=Lighting(),
            vignetting=Vignetting(),
            pattern=PatternSpecification(seed=seed, blotch_m=1.0e-3),
            supersampling=1,
        )

    image = render(3)
    assert np.array_equal(image, render(3))
    assert not np.array_equal(image, render(4))
    # Red right and down, green left, blue right and up.
    assert np.argmax(image[190:210, 200:220].reshape(-1, 3).mean(axis=0)) == 0
    assert np.argmax(image[110:130, 50:70].reshape(-1, 3).mean(axis=0)) == 1
    assert np.argmax(image[30:50, 200:220].reshape(-1, 3).mean(axis=0)) == 2
    assert image[0, 0].max() == 0
