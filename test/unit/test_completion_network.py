# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A trained network at run time: what torch computes, without torch, for its own sensor alone."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from optical_presses import RADIUS_M, dented

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.io.files import PACKAGE_ROOT, given_path, parameter_path
from dotsim_ros.optics.idle import lit_region, read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.network.card import (
    FINENESS,
    FORMAT,
    NetworkCard,
    camera_hash,
    read_network,
)
from dotsim_ros.optics.network.carded_weights import (
    CARD_KEY,
    GRAPH,
    WEIGHTS,
    weights_hash,
    write_weights,
)
from dotsim_ros.optics.network.completion import CompletionNetwork
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import load_sensor

SENSOR = load_sensor("densetact2")
SIZE = (320, 240)
SINGLE_PRECISION_LEVELS = 0.01
"""Grey levels by which two single-precision computations of one network may differ."""


@pytest.fixture(scope="module")
def camera():
    return Camera.from_specification(SENSOR.camera)


@pytest.fixture(scope="module")
def dome():
    return dome_skin(RADIUS_M, 1.0e-3)


@pytest.fixture(scope="module")
def idle(camera):
    return read_idle_frame(parameter_path(f"{SENSOR.camera.idle_image}"), camera).image


@pytest.fixture(scope="module")
def renderer(camera, dome):
    return SkinRenderer(camera, dome)


@pytest.fixture(scope="module")
def pressed(renderer, dome):
    axis = np.array([0.3, 0.2, 0.9]) / np.linalg.norm([0.3, 0.2, 0.9])
    return renderer.render(dented(dome, axis, 0.003, 0.004))


def random_network(kind):
    torch = pytest.importorskip("torch", reason="making a network needs the extra 'learning'")
    pytest.importorskip("torchvision", reason="making a network needs the extra 'learning'")
    from dotsim_ros.learning.networks import make_network

    torch.manual_seed(1)
    network = make_network(kind).eval()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.03 * torch.randn_like(parameter)
    return network


def write(directory, network, kind, camera, *, size=SIZE, sensor=SENSOR.name):
    from dotsim_ros.learning.export import write_network

    card = NetworkCard(FORMAT, kind, sensor, camera_hash(camera), *size, "", "")
    write_network(directory, network, card)


@pytest.fixture(scope="module")
def made(tmp_path_factory, camera):
    directory = tmp_path_factory.mktemp("network")
    network = random_network("ours")
    write(directory, network, "ours", camera)
    return directory, network


UNET_SIZE = (64, 48)


@pytest.fixture(scope="module")
def made_unet(tmp_path_factory, camera):
    directory = tmp_path_factory.mktemp("unet")
    network = random_network("unet")
    write(directory, network, "unet", camera, size=UNET_SIZE)
    return directory, network


@pytest.fixture
def folder(made, tmp_path):
    """A copy of the network's folder, to be spoiled."""
    for file in made[0].iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def open_network(directory, camera, sensor=SENSOR.name):
    return CompletionNetwork(directory, sensor=sensor, camera=camera)


@pytest.mark.parametrize("kind", ["ours", "unet"])
def test_results_are_those_of_torch(kind, camera, made, made_unet):
    torch = pytest.importorskip("torch")
    size = {"ours": SIZE, "unet": UNET_SIZE}[kind]
    directory, network = made_unet if kind == "unet" else made
    random = np.random.default_rng(0)
    width, height = size[0] // FINENESS[kind], size[1] // FINENESS[kind]
    frame = random.random((7, height, width), dtype=np.float32)
    rest = random.random((10, height, width), dtype=np.float32)
    image = random.random((3, size[1], size[0]), dtype=np.float32)
    added = open_network(directory, camera).added(frame, rest, image)
    with torch.inference_mode():
        arrays = (torch.from_numpy(array[None]) for array in (frame, rest, image))
        expected = network(*arrays)[0].numpy()
    assert added.shape == (3, size[1], size[0])
    assert 255.0 * np.abs(expected).max() > 5.0
    assert 255.0 * np.abs(added - expected).max() < SINGLE_PRECISION_LEVELS


def test_weights_are_stored_once_and_no_folder_of_the_machine(made):
    directory, network = made
    weights = sum(value.numel() * 4 for value in network.state_dict().values())
    assert (directory / WEIGHTS).stat().st_size < weights + 20_000
    assert (directory / GRAPH).stat().st_size < 0.25 * weights
    assert str(PACKAGE_ROOT).encode() not in (directory / GRAPH).read_bytes()


def test_nothing_is_added_at_rest_or_outside_the_lit_disc(
    made, camera, dome, renderer, idle, pressed
):
    untouched = renderer.render(dome.rest_position_m)
    completion = open_network(made[0], camera).at_rest(untouched, idle)
    images = ImageRenderer(camera, dome, idle, completion=completion)
    assert not completion(untouched.depth_m, untouched.normal, idle).any()
    assert np.array_equal(images.render(untouched), idle)
    warped = images.warp(pressed)
    shown = images.render(pressed)
    assert not np.array_equal(shown, warped)
    completed = completion(pressed.depth_m, pressed.normal, warped)
    added = warped + completed
    expected = np.clip(np.rint(added), 0.0, 255.0)
    assert np.abs(shown - expected).max() <= 1.0
    assert np.mean(shown != expected) < 1e-4
    assert not completed[~lit_region(idle)].any()


def test_kinds_that_replace_the_carried_image_add_up_to_their_own(
    made_unet, camera, dome, renderer, idle, pressed
):
    network = open_network(made_unet[0], camera)
    completion = network.at_rest(renderer.render(dome.rest_position_m), idle)
    warped = ImageRenderer(camera, dome, idle).warp(pressed)
    dark = np.zeros_like(warped)
    # Whatever was warped, the same image comes out: its geometry's.
    first, second = (
        completion(pressed.depth_m, pressed.normal, image) + image for image in (warped, dark)
    )
    assert np.allclose(first, second, atol=1e-3)


def test_the_camera_counts_but_not_its_resolution(made, camera):
    assert camera_hash(camera.scaled(320, 240)) == camera_hash(camera)
    open_network(made[0], camera.scaled(320, 240))
    turned = replace(camera, pose=Pose(camera.pose.position_m, np.array([0.01, 0.0, 0.0, 1.0])))
    with pytest.raises(
        ValueError, match=r"another camera of 'densetact2'.*train the network again"
    ):
        open_network(made[0], turned)


def contents(directory):
    from safetensors.numpy import load_file

    return load_file(directory / WEIGHTS), read_network(directory)


def spoil(path):
    content = bytearray(path.read_bytes())
    content[-50] ^= 0x40
    path.write_bytes(content)


def of_another_version(folder):
    weights, card = contents(folder)
    write_weights(folder / WEIGHTS, weights, replace(card, version=FORMAT + 1))


def with_other_weights(folder):
    weights, card = contents(folder)
    first = sorted(weights)[0]
    weights[first] = weights[first] + 1.0
    other = replace(card, weights_sha256=weights_hash(weights), graph_sha256="0" * 64)
    write_weights(folder / WEIGHTS, weights, other)


def with_card(folder, **changes):
    from safetensors.numpy import save_file

    weights, card = contents(folder)
    record = {CARD_KEY: json.dumps(json.loads(card.text()) | changes)} if changes else None
    save_file(weights, folder / WEIGHTS, metadata=record)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (of_another_version, f"version {FORMAT + 1}, expected {FORMAT}"),
        (lambda folder: spoil(folder / WEIGHTS), f"{WEIGHTS} is corrupt"),
        (lambda folder: spoil(folder / GRAPH), f"{GRAPH} is corrupt"),
        (with_other_weights, f"{GRAPH} is corrupt or belongs to other weights"),
        (with_card, "no card that can be read"),
        (lambda folder: with_card(folder, colour="red"), "its card has the entries"),
        (lambda folder: (folder / GRAPH).unlink(), f"no {GRAPH}; make one with dotsim_ros train"),
    ],
)
def test_what_is_no_whole_network_is_refused(folder, camera, change, reason):
    change(folder)
    with pytest.raises((ValueError, FileNotFoundError), match=reason):
        open_network(folder, camera)


def test_a_sensor_loads_the_network_that_its_file_names(made):
    with_network = replace(
        SENSOR,
        camera=replace(SENSOR.camera, residual=str(made[0])),
        solver=replace(SENSOR.solver, refined=False, grid_spacing_m=3.6e-3),
    )
    sensor = TactileSensor(with_network, indenter=load_indenter("sphere_4mm"))
    assert np.array_equal(sensor.step(None, 0.04).image, sensor.idle_image)
    tip = Pose(np.array([0.0, 0.0, RADIUS_M - 0.001]), np.array([0.0, 0.0, 0.0, 1.0]))
    frame = sensor.step(tip, 0.04)
    idle = read_idle_frame(parameter_path(SENSOR.camera.idle_image), sensor.camera)
    plain = ImageRenderer(sensor.camera, sensor.skin, idle.image, lighting=idle.lighting)
    view = SkinRenderer(sensor.camera, sensor.skin).render(frame.skin_position_m)
    assert not np.array_equal(frame.image, plain.warp(view))
    # Another idle image keeps the network.
    darker = (sensor.idle_image * 0.8).astype(np.uint8)
    sensor.set_idle_image(darker)
    assert np.array_equal(sensor.step(None, 0.04).image, darker)
    plain = ImageRenderer(sensor.camera, sensor.skin, darker, lighting=idle.lighting)
    assert not np.array_equal(sensor.step(tip, 0.04).image, plain.warp(view))


def test_a_sensor_refuses_a_network_that_is_not_its_own(made):
    camera = replace(SENSOR.camera, residual=str(made[0]))
    indenter = load_indenter("sphere_4mm")
    with pytest.raises(ValueError, match="not for 'other'"):
        TactileSensor(replace(SENSOR, name="other", camera=camera), indenter=indenter)
    absent = replace(SENSOR, camera=replace(SENSOR.camera, residual="networks/none"))
    with pytest.raises(FileNotFoundError, match="networks/none"):
        TactileSensor(absent, indenter=indenter)


def test_the_stand_in_sensor_ships_with_its_network():
    shipped = load_sensor("sensor_a")
    camera = Camera.from_specification(shipped.camera)
    network = CompletionNetwork(
        given_path(shipped.camera.residual), sensor=shipped.name, camera=camera
    )
    metrics = network.card.metrics
    assert metrics["predicted_all_psnr_db"] > metrics["carried_all_psnr_db"]
    folder = given_path(shipped.camera.residual)
    assert sum(file.stat().st_size for file in folder.iterdir()) < 10e6

    skin = dome_skin(shipped.gel.outer_radius_m, 1.0e-3)
    renderer = SkinRenderer(camera, skin)
    idle = read_idle_frame(given_path(shipped.camera.idle_image), camera)
    untouched = renderer.render(skin.rest_position_m)
    completion = network.at_rest(untouched, idle.image)
    images = ImageRenderer(camera, skin, idle.image, lighting=idle.lighting, completion=completion)
    assert np.array_equal(images.render(untouched), idle.image)
    pressed = renderer.render(dented(skin, np.array([0.0, 0.0, 1.0]), 0.002, 0.004))
    added = completion(pressed.depth_m, pressed.normal, images.warp(pressed))
    assert 1.0 < np.abs(added).max() < 100.0


def test_two_threads_add_what_one_adds_to_the_last_bit():
    shipped = load_sensor("sensor_a")
    camera = Camera.from_specification(shipped.camera)
    dome = dome_skin(RADIUS_M, 0.5e-3)
    renderer = SkinRenderer(camera, dome)
    idle = read_idle_frame(given_path(shipped.camera.idle_image), camera).image
    untouched = renderer.render(dome.rest_position_m)
    axis = np.array([0.3, 0.2, 0.9]) / np.linalg.norm([0.3, 0.2, 0.9])
    view = renderer.render(dented(dome, axis, 0.003, 0.004))
    warped = ImageRenderer(camera, dome, idle).warp(view)
    one, two, by_default = (
        CompletionNetwork(
            given_path(shipped.camera.residual),
            sensor=shipped.name,
            camera=camera,
            thread_count=thread_count,
        ).at_rest(untouched, idle)(view.depth_m, view.normal, warped)
        for thread_count in (1, 2, None)
    )
    assert np.abs(one).max() > 1.0
    assert np.array_equal(one, two)
    assert np.array_equal(one, by_default)


def test_running_a_network_loads_no_torch(made):
    program = (
        "import sys; from pathlib import Path; import dotsim_ros.sensor; "
        "assert 'onnxruntime' not in sys.modules; "
        "from dotsim_ros.optics.network.completion import CompletionNetwork; "
        "from dotsim_ros.specification import load_sensor; "
        "from dotsim_ros.geometry.camera import Camera; "
        "camera = Camera.from_specification(load_sensor('densetact2').camera); "
        f"CompletionNetwork(Path({str(made[0])!r}), sensor='densetact2', camera=camera); "
        "assert 'torch' not in sys.modules and 'onnx' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=Path(__file__).parents[2])
