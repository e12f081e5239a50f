# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the camera saw of measured presses: read, checked, and laid next to what the gel says."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
import yaml

from dotsim_ros.data.trajectory import ImageChannel, PoseChannel, Trajectory, write_trajectory
from dotsim_ros.optics.idle import lights_of
from dotsim_ros.optics.idle_check import (
    check_untouched,
    difference,
    mean_idle_image,
    read_idle_images,
)
from dotsim_ros.specification import load_sensor
from dotsim_ros.twin.footage import (
    camera_for,
    read_filmed_data,
    render_filmed,
    with_measured_skin,
)

HEIGHT, WIDTH = 60, 80
RADIUS_M = 0.01575
DEPTHS_M = (-0.2e-3, 0.2e-3, 0.5e-3, 0.8e-3, 1.0e-3)
SENSOR_A = Path(__file__).parents[3] / "shared" / "measured" / "sensor_a"


def pattern(seed=0, touched=False):
    """Return an idle image (H, W, 3): a textured disc, and noise of a camera."""
    random = np.random.default_rng(7)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    texture = cv2.GaussianBlur(random.standard_normal((HEIGHT, WIDTH)), (0, 0), 1.5)
    if touched:
        shift = 4.0 * np.exp(-((rows - 25.0) ** 2 + (columns - 40.0) ** 2) / 100.0)
        texture = cv2.remap(
            texture.astype(np.float32),
            (columns + shift).astype(np.float32),
            rows.astype(np.float32),
            cv2.INTER_LINEAR,
        )
    level = 120.0 + 40.0 * np.sign(texture)
    level = np.where(np.hypot(columns - 39.5, rows - 29.5) < 28.0, level, 0.0)
    noise = np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH, 3))
    return np.clip(np.rint(level[..., None] + noise), 0, 255).astype(np.uint8)


def write_png(path, image):
    assert cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


def write_press(directory, name, images, *, image_offset_s=0.0, with_pose=True):
    stamp_ns = (1_000_000_000 + 40_000_000 * np.arange(len(DEPTHS_M))).astype(np.int64)
    position = np.array([[0.0, 0.0, RADIUS_M - depth] for depth in DEPTHS_M])
    pose = PoseChannel(stamp_ns, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(position), 1)))
    channel = None
    if images is not None:
        offset = np.int64(1e9 * image_offset_s)
        channel = ImageChannel(stamp_ns[: len(images)] + offset, np.stack(images))
    write_trajectory(
        directory / "bags" / name, Trajectory(pose=pose if with_pose else None, image=channel)
    )


@pytest.fixture
def data_set(tmp_path):
    """A data set of three presses of a ball, whose images do not move: only reading is tested."""
    directory = tmp_path / "data"
    (directory / "indenters").mkdir(parents=True)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.004)
    ball.apply_translation([0.0, 0.0, 0.004])
    ball.export(directory / "indenters" / "ball.stl")
    for number in range(3):
        write_png(directory / f"idle_{number}.png", pattern(number))
    records = []
    for number in range(3):
        images = [pattern(10 * number + frame) for frame in range(len(DEPTHS_M))]
        write_press(directory, f"ball_{number}", images)
        records.append({"bag": f"bags/ball_{number}", "indenter": "ball", "images": True})
    write_index(directory, records)
    return directory


def write_index(directory, records):
    (directory / "dataset.yaml").write_text(yaml.safe_dump({"trajectories": records}))


def add_press(directory, name, images, **options):
    write_press(directory, name, images, **options)
    index = yaml.safe_load((directory / "dataset.yaml").read_text())
    record = {"bag": f"bags/{name}", "indenter": "ball", "images": True}
    write_index(directory, [*index["trajectories"], record])


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A folder of skins that the tests share: all press alike."""
    return tmp_path_factory.mktemp("skins")


@pytest.fixture(scope="module")
def sensor():
    # A coarse gel has no tables to compute.
    sensor = load_sensor("densetact2")
    return replace(
        sensor,
        gel=replace(sensor.gel, skin_spacing_m=1.5e-3),
        solver=replace(sensor.solver, grid_spacing_m=4.8e-3, refined=False),
    )


def test_model_lies_beside_what_was_measured(data_set, sensor, cache):
    filmed = read(data_set, sensor, cache)
    with pytest.raises(FileNotFoundError):
        with_measured_skin(filmed, data_set)
    lighting, vignetting = lights_of(sensor)
    data = render_filmed(
        filmed,
        camera_for(sensor, filmed.idle, str(data_set)),
        lighting=lighting,
        vignetting=vignetting,
    )
    assert [press.name for press in data.presses] == ["ball_0", "ball_1", "ball_2"]
    assert (data.camera.width, data.camera.height) == (WIDTH, HEIGHT)
    press, count = data.presses[0], len(DEPTHS_M)
    assert press.indenter == "ball"
    assert press.tip_depth_m == pytest.approx(DEPTHS_M, abs=0.1e-3)
    assert press.measured.shape == press.warped.shape == (count, HEIGHT, WIDTH, 3)
    assert press.depth_m.shape == (count, HEIGHT, WIDTH)
    assert press.normal.shape == (count, HEIGHT, WIDTH, 3)
    seen = np.isfinite(data.rest.depth_m)
    assert np.array_equal(np.isfinite(data.rest.normal[..., 0]), seen)
    assert np.array_equal(press.warped[0], data.rest.idle)
    # The ball comes towards the camera in the middle of the image, and nothing moves at its rim.
    nearer = data.rest.depth_m - press.depth_m[-1]
    assert np.nanmax(nearer) > 0.5e-3
    y, x = np.unravel_index(np.nanargmax(nearer), nearer.shape)
    assert abs(y - 29.5) < 4.0
    assert abs(x - 39.5) < 4.0


def test_skins_are_found_again_until_the_gel_changes(data_set, sensor, tmp_path):
    said = []

    def read_again(sensor):
        return read_filmed_data(
            data_set,
            sensor,
            presses=["ball_0", "ball_1"],
            cache=tmp_path / "cache",
            progress=said.append,
        )

    first = read_again(sensor)
    stored = sorted((tmp_path / "cache").iterdir())
    again = read_again(replace(sensor, camera=replace(sensor.camera, half_height_angle_deg=80.0)))
    assert len(said) == len(stored) == 2
    for one, other in zip(first.presses, again.presses, strict=True):
        assert np.array_equal(one.skin_position_m, other.skin_position_m)
    stored[0].write_bytes(stored[0].read_bytes()[:500])
    mended = read_again(sensor)
    assert len(said) == 3
    assert np.array_equal(mended.presses[0].skin_position_m, first.presses[0].skin_position_m)
    read_again(replace(sensor, material=replace(sensor.material, youngs_modulus_pa=1.2e4)))
    assert len(said) == 5


def test_image_between_two_poses_gets_the_pose_between(data_set, sensor, cache):
    images = [pattern(number) for number in range(len(DEPTHS_M))]
    add_press(data_set, "late", images, image_offset_s=0.02)
    names = ["ball_0", "ball_1", "late"]
    filmed = read_filmed_data(data_set, sensor, presses=names, cache=cache)
    late = filmed.presses[2]
    # The last image was taken after the last pose.
    assert len(late.measured) == len(DEPTHS_M) - 1
    between = 0.5 * (np.array(DEPTHS_M[1:]) + np.array(DEPTHS_M[:-1]))
    assert late.tip_depth_m == pytest.approx(between, abs=0.1e-3)


def read(directory, sensor, cache, presses=None):
    return read_filmed_data(directory, sensor, presses=presses, cache=cache)


@pytest.mark.parametrize(
    ("presses", "reason"),
    [
        (["ball_1"], "5 frames with images in ball_1, expected 10 at least"),
        (["ball_0", "cube_0"], "no trajectory cube_0; it has ball_0, ball_1, ball_2"),
        (["ball_0", "blind"], "blind holds no image on /tactile/image_raw/compressed"),
        (["ball_0", "loose"], "loose: no message on /indenter/pose"),
        (["ball_0", "large"], "its images are 160x120, but the idle images 80x60"),
        (["ball_0", "late"], "late: no image was taken while poses were recorded"),
        (["ball_0", "ball_1", "early"], r"early, frame 0 differs .*check that the pose"),
    ],
)
def test_presses_without_what_they_show_are_refused(data_set, sensor, cache, presses, reason):
    options = {
        "blind": {"images": None},
        "loose": {"images": [pattern(3)], "with_pose": False},
        "large": {"images": [np.zeros((2 * HEIGHT, 2 * WIDTH, 3), np.uint8)]},
        "late": {"images": [pattern(3)] * 5, "image_offset_s": 100.0},
        "early": {"images": [pattern(n, touched=True) for n in range(len(DEPTHS_M))]},
    }
    if presses[-1] in options:
        add_press(data_set, presses[-1], **options[presses[-1]])
    with pytest.raises(ValueError, match=reason):
        read(data_set, sensor, cache, presses)


def test_data_set_without_images_is_refused(data_set, sensor, cache):
    write_index(data_set, [{"bag": "bags/ball_0", "indenter": "ball", "images": False}])
    with pytest.raises(ValueError, match="none of its trajectories holds images"):
        read(data_set, sensor, cache)


def test_images_that_do_not_fit_the_camera_are_refused(sensor):
    wide = replace(sensor, camera=replace(sensor.camera, width=640, height=640))
    with pytest.raises(ValueError, match=r"do not fit the camera: .*aspect ratio"):
        camera_for(wide, pattern(), "measured/unit")


def test_idle_images_with_a_contact_are_refused(data_set, sensor, cache):
    write_png(data_set / "idle_1.png", pattern(1, touched=True))
    with pytest.raises(ValueError, match=r"idle_1\.png differs .*something touched the gel"):
        read(data_set, sensor, cache)
    for number in range(3):
        write_png(data_set / f"idle_{number}.png", pattern(number, touched=True))
    with pytest.raises(ValueError, match=r"another gel than 3 of 3 frames .*something in contact"):
        read(data_set, sensor, cache)


def test_idle_images_must_be_there_and_in_colour(data_set, sensor, cache):
    grey = np.zeros((HEIGHT, WIDTH), np.uint16)
    assert cv2.imwrite(str(data_set / "idle_1.png"), grey)
    with pytest.raises(ValueError, match="expected a colour image of 8 bits"):
        read(data_set, sensor, cache)
    (data_set / "idle_1.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match="no image that OpenCV can read"):
        read(data_set, sensor, cache)
    write_png(data_set / "idle_1.png", np.zeros((HEIGHT, 2 * WIDTH, 3), np.uint8))
    with pytest.raises(ValueError, match="record all with one camera"):
        read(data_set, sensor, cache)
    for path in data_set.glob("idle_*.png"):
        path.unlink()
    with pytest.raises(ValueError, match="no idle image: record"):
        read(data_set, sensor, cache)


def test_noise_is_no_contact_and_the_dark_no_image(tmp_path):
    images = np.zeros((2, HEIGHT, WIDTH, 3), np.uint8)
    with pytest.raises(ValueError, match="dark"):
        mean_idle_image(images, [tmp_path / "idle_0.png", tmp_path / "idle_1.png"])
    lit = np.ones((HEIGHT, WIDTH), dtype=bool)
    base = np.full((HEIGHT, WIDTH, 3), 100.0, np.float32)
    for deviation in (1.0, 3.0, 8.0):
        noise = np.random.default_rng(1).standard_normal(base.shape) * deviation
        assert difference(base + noise.astype(np.float32), base, lit).is_noise


@pytest.mark.skipif(not SENSOR_A.is_dir(), reason="needs the measured data of the stand-in sensor")
def test_idle_images_of_the_stand_in_sensor_are_untouched_and_its_presses_are_not():
    from dotsim_ros.data.data_set import read_data_set

    data = read_data_set(SENSOR_A)
    paths = data.idle_images()
    idle = mean_idle_image(read_idle_images(paths), paths)
    images = {
        entry.name: entry.read().image.pixels
        for entry in data.entries
        if entry.name in ("1_sphere_2", "2_cone_0", "6_round_punch_0")
    }
    check_untouched(idle, [(name, pixels[0]) for name, pixels in images.items()])
    for name, pixels in images.items():
        for frame in range(2, len(pixels)):
            with pytest.raises(ValueError, match=f"{name}, {frame}"):
                check_untouched(idle, [(f"{name}, {frame}", pixels[frame])])
    with pytest.raises(ValueError, match="something touched the gel"):
        mean_idle_image(
            np.stack([*read_idle_images(paths)[:4], images["1_sphere_2"][2]]), list(paths)
        )
