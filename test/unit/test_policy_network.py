# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Policies as files: written by torch, run without it, refused where they are broken."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from dotsim_ros.control.policy.images import CHANNEL_COUNT, PolicyInput
from dotsim_ros.control.policy.network import FORMAT, POLICY, PolicyCard, load_policy
from dotsim_ros.control.policy.paths import PATHS as PATH_NAMES
from dotsim_ros.control.policy.resnet import save_policy
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.files import parameter_path
from dotsim_ros.optics.idle import read_idle_frame
from dotsim_ros.optics.network.carded_weights import CARD, GRAPH, WEIGHTS, card_from
from dotsim_ros.optics.network.session import open_session
from dotsim_ros.specification import load_sensor

torch = pytest.importorskip("torch", reason="writing a policy needs the extra learning")

PATHS = ("line", "press")
DRAWN = PolicyCard(
    version=FORMAT,
    name="drawn",
    sensor="densetact2",
    indenter="sphere_4mm",
    paths=PATHS,
    rate_hz=25.0,
    image_height=480,
    image_width=640,
    share=0.7,
    side_px=64,
    largest_distance=3.0,
)
RANDOM = np.random.default_rng(3)
IDLE = RANDOM.integers(30, 220, (480, 640, 3), dtype=np.uint8)
IMAGE = RANDOM.integers(30, 220, (480, 640, 3), dtype=np.uint8)


def drawn_network():
    """Return a network of random weights, its running statistics too."""
    from dotsim_ros.control.policy.resnet import PolicyResNet

    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = PolicyResNet(len(PATHS))
        for module in network.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                module.running_mean.uniform_(-0.1, 0.1)
                module.running_var.uniform_(0.5, 2.0)
    return network.eval()


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A network of random weights, and the folder of its policy."""
    from dotsim_ros.control.policy.resnet import without_normalisation

    network = drawn_network()
    folder = tmp_path_factory.mktemp("policy") / "drawn"
    mean, root = np.zeros(96, dtype=np.float32), np.eye(96, dtype=np.float32)
    card = save_policy(
        folder, without_normalisation(network), DRAWN, usual_mean=mean, usual_root=root
    )
    assert replace(card, weights_sha256="", graph_sha256="") == DRAWN
    return network, folder


def test_a_loaded_policy_answers_as_the_network(written):
    network, folder = written
    given = PolicyInput(DRAWN.view.crop(IDLE))(DRAWN.view.crop(IMAGE))
    with torch.inference_mode():
        expected = network(torch.from_numpy(given)[None])[0].numpy()
    for row, name in enumerate(PATHS):
        command = load_policy(folder, name)(IMAGE, IDLE)
        assert command.shape == (6,)
        assert command.dtype == np.float64
        # Half precision keeps three digits of each weight.
        scale = np.abs(expected[row]).max()
        np.testing.assert_allclose(command, expected[row], atol=0.02 * scale)


def test_weights_are_stored_once_in_half_precision(written):
    folder = written[1]
    weight_count = sum(parameter.numel() for parameter in written[0].parameters())
    assert (folder / GRAPH).stat().st_size < 60_000
    assert 2.0 * weight_count < (folder / WEIGHTS).stat().st_size < 2.01 * weight_count + 60_000
    inputs = open_session(folder / GRAPH, 1, "policy").get_inputs()
    assert [(entry.name, entry.shape) for entry in inputs] == [
        ("picture", [1, CHANNEL_COUNT, 64, 64])
    ]


def test_a_new_idle_image_is_noticed_even_in_the_same_array(written):
    policy = load_policy(written[1])
    idle = IDLE.copy()
    first = policy(IMAGE, idle)
    idle[:] = idle[::-1]
    second = policy(IMAGE, idle)
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(second, load_policy(written[1])(IMAGE, idle))


def test_the_distance_is_of_the_crop_from_the_usual(written):
    policy = load_policy(written[1])
    lit_alone = policy.image_distance(IDLE, IDLE)
    assert lit_alone == pytest.approx(np.sqrt(0.5))
    assert policy.image_distance(np.ascontiguousarray(IMAGE[::-1]), IDLE) > lit_alone


@pytest.mark.parametrize(
    ("image", "idle", "message"),
    [
        (IMAGE[:, :480], IDLE, "480x480, expected 640x480"),
        (IMAGE, IDLE[::2, ::2], "one size"),
        (IMAGE.astype(float), IDLE, "float64"),
        (IMAGE[..., 0], IDLE, "shape"),
    ],
    ids=["square", "sizes", "float", "grey"],
)
def test_wrong_images_are_refused(written, image, idle, message):
    policy = load_policy(written[1])
    with pytest.raises(ValueError, match=message):
        policy(image, idle)
    with pytest.raises(ValueError, match=message):
        policy.image_distance(image, idle)


def test_broken_files_are_refused(written, tmp_path):
    with pytest.raises(ValueError, match="line, press"):
        load_policy(written[1], "spiral")
    with pytest.raises(FileNotFoundError, match="train-policy"):
        load_policy(tmp_path)
    folder = tmp_path / "broken"
    shutil.copytree(written[1], folder)
    weights = (folder / WEIGHTS).read_bytes()
    (folder / WEIGHTS).write_bytes(weights[:-100])
    with pytest.raises(ValueError, match="corrupt"):
        load_policy(folder)
    middle = len(weights) // 2
    flipped = bytes([weights[middle] ^ 1])
    (folder / WEIGHTS).write_bytes(weights[:middle] + flipped + weights[middle + 1 :])
    with pytest.raises(ValueError, match="corrupt"):
        load_policy(folder)
    (folder / WEIGHTS).write_bytes(weights)
    (folder / GRAPH).write_bytes((folder / GRAPH).read_bytes() + b" ")
    with pytest.raises(ValueError, match="belongs to other weights"):
        load_policy(folder)


def test_another_version_is_refused(written, tmp_path):
    record = json.loads((written[1] / CARD).read_text())
    with pytest.raises(ValueError, match="version 99"):
        card_from(json.dumps({**record, "version": 99}), tmp_path, POLICY)
    del record["paths"]
    with pytest.raises(ValueError, match="entries"):
        card_from(json.dumps(record), tmp_path, POLICY)
    with pytest.raises(ValueError, match="no card"):
        card_from("null", tmp_path, POLICY)


def test_weights_too_large_for_half_precision_are_refused():
    onnx = pytest.importorskip("onnx")
    from dotsim_ros.control.policy.resnet import halve_weights

    weights = onnx.numpy_helper.from_array(np.full(100, 1e6, dtype=np.float32), "weights")
    model = onnx.helper.make_model(onnx.helper.make_graph([], "graph", [], [], [weights]))
    with pytest.raises(ValueError, match="half precision"):
        halve_weights(model)


def test_running_a_policy_loads_no_torch(written):
    program = (
        "import sys; from pathlib import Path; import numpy as np; "
        "from dotsim_ros.control.policy.network import load_policy; "
        f"policy = load_policy(Path({str(written[1])!r}), 'press'); "
        "image = np.full((480, 640, 3), 90, dtype=np.uint8); "
        "assert np.all(np.isfinite(policy(image, image))); "
        "assert 'torch' not in sys.modules and 'onnx' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=Path(__file__).parents[2])


def test_the_shipped_policy_knows_the_sensors_images_from_others():
    folder = parameter_path("policies/densetact2_sphere")
    policy = load_policy(folder, "figure_eight")
    assert set(policy.paths) == set(PATH_NAMES)
    assert sum(file.stat().st_size for file in folder.iterdir()) < 25e6
    own = load_sensor("densetact2")
    camera = Camera.from_specification(own.camera)
    idle = read_idle_frame(parameter_path(own.camera.idle_image), camera).image
    dimmed = (0.97 * idle).astype(np.uint8)
    for usual in (idle, dimmed):
        assert policy.image_distance(usual, idle) < policy.largest_distance
    strange = {
        "black": np.zeros_like(idle),
        "upside down": np.ascontiguousarray(idle[::-1, ::-1]),
        "blue for red": np.ascontiguousarray(idle[..., ::-1]),
        "moved": np.roll(idle, 10, axis=1),
        "noise": IMAGE,
    }
    for name, image in strange.items():
        assert policy.image_distance(image, idle) > policy.largest_distance, name
    narrow = cv2.resize(idle[72:408, 96:544], (640, 480))
    assert policy.image_distance(narrow, narrow) > policy.largest_distance
