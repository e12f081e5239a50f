# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`dotsim_ros train-optics`: from a data set to a sensor that shows learned images."""

import json
from dataclasses import replace
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest

from dotsim_ros.cli import train_optics
from dotsim_ros.cli.main import main
from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.split import hold_out_of_protocols, split_of, usual_hold_out
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.learning.pattern import refined_idle, untouched_frames
from dotsim_ros.optics.network.card import read_network
from dotsim_ros.optics.network.completion import CompletionNetwork
from dotsim_ros.specification import load_sensor
from dotsim_ros.twin.footage import FilmedData, FilmedPress

SENSOR_A = Path(__file__).parents[3] / "shared" / "measured" / "sensor_a"
needs_data = pytest.mark.skipif(not SENSOR_A.is_dir(), reason="the stand-in data set is not here")


def filmed_presses(count=6, noise_levels=4.0):
    """Return presses whose first two frames are untouched, and the scene without noise."""
    random = np.random.default_rng(0)
    skin = dome_skin(0.01575, 2.0e-3)
    scene = random.integers(60, 180, (24, 32, 3)).astype(float)

    def image():
        noisy = scene + noise_levels * random.standard_normal(scene.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    presses = []
    for number in range(count):
        skins = np.repeat(skin.rest_position_m[None], 5, axis=0).astype(np.float32)
        skins[2:4, 100] -= 1e-4
        images = np.stack([image(), image(), *(np.zeros((3, 24, 32, 3), dtype=np.uint8))])
        presses.append(
            FilmedPress(f"press_{number}", "ball", np.zeros(5), images, skins, np.arange(5.0))
        )
    return FilmedData(skin, image(), tuple(presses)), scene


def test_only_frames_before_the_gel_moved_are_untouched():
    filmed, _ = filmed_presses()
    # The last frame's gel is at rest again, but something has touched it before.
    assert untouched_frames(filmed.presses[0], filmed) == [0, 1]


def test_untouched_frames_take_noise_off_the_idle_image():
    filmed, scene = filmed_presses()

    def noise_levels(image):
        return np.sqrt(np.mean((image - scene) ** 2))

    refined = refined_idle(filmed)
    assert refined.dtype == np.uint8
    assert noise_levels(refined) < noise_levels(filmed.idle) / 3.0
    some = refined_idle(filmed, ["press_0"])
    assert noise_levels(refined) < noise_levels(some) < noise_levels(filmed.idle)
    assert np.array_equal(refined_idle(filmed, []), filmed.idle)


def test_the_command_line_knows_every_network():
    learning = pytest.importorskip("dotsim_ros.learning.networks", exc_type=ImportError)
    assert sorted(get_args(train_optics.Network)) == sorted(learning.KINDS)


@needs_data
def test_camera_and_network_are_judged_on_what_the_gel_is_judged_on():
    data_set = read_data_set(SENSOR_A)
    expected = hold_out_of_protocols([entry.name for entry in data_set.entries])
    for usual in (usual_hold_out, train_optics.usual_hold_out):
        count = usual(len(data_set.filmed()))
        assert split_of(data_set.filmed(), hold_out=count) == split_of(data_set.entries) == expected


@needs_data
def test_a_camera_is_fitted_to_the_trajectories_named():
    named = read_data_set(SENSOR_A).filmed(["4_torus_1", "2_cone_0"])
    assert split_of(named, hold_out=0) == (("2_cone_0", "4_torus_1"), ())


@needs_data
@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--trajectories", "9_none"], "no trajectory with images named 9_none"),
        (["--leave-out", "9_none"], "name some of them, not all"),
        (["--trajectories", "2_cone_0", "--hold-out", "0"], "8 frames"),
        (["--sensor-out", "sensor.txt"], "ends in .yaml"),
        (["--network", "ours", "--size", "100"], "size is 100"),
        (["--epochs", "0"], "epochs is 0, expected 1 or more"),
    ],
)
def test_bad_requests_are_refused_and_nothing_is_written(options, reason, tmp_path, capsys):
    pytest.importorskip("torch", reason="training needs the extra 'learning'")
    out = tmp_path / "optics"
    common = ["train-optics", "--data", str(SENSOR_A), "--sensor", "sensor_a", "--out", str(out)]
    if "--size" in options:
        common += ["--trajectories", "4_torus_0", "4_torus_1"]
    assert main([*common, *options]) == 1
    assert reason in capsys.readouterr().err
    assert not out.exists()


@needs_data
def test_a_trained_sensor_can_be_loaded(tmp_path, capsys):
    pytest.importorskip("torch", reason="training needs the extra 'learning'")
    out = tmp_path / "optics"
    arguments = ["train-optics", "--data", str(SENSOR_A), "--sensor", "sensor_a"]
    arguments += ["--out", str(out), "--json", str(tmp_path / "figures.json")]
    arguments += ["--trajectories", "4_torus_0", "4_torus_1", "4_torus_2", "--hold-out", "1"]
    assert main([*arguments, "--epochs", "2", "--size", "160"]) == 0
    assert "predicted_all_psnr_db" in capsys.readouterr().out

    trained = load_sensor(out / "sensor.yaml")
    stated = load_sensor("sensor_a")
    assert trained.camera.residual == str(out)
    assert replace(trained, camera=stated.camera) == stated
    idle = cv2.imread(trained.camera.idle_image)
    assert idle.shape == (240, 320, 3)
    camera = Camera.from_specification(trained.camera)
    network = CompletionNetwork(out, sensor="sensor_a", camera=camera)
    assert (network.card.width, network.card.height) == (160, 120)
    assert len(network.card.data["train"]) == 2
    assert read_network(out).metrics == json.loads((out / "card.json").read_text())["metrics"]

    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["judged_on"] == network.card.data["held_out"]
    assert figures["metrics"]["predicted_all_psnr_db"] > figures["metrics"]["idle_all_psnr_db"]
    record = tmp_path / "optics_training"
    assert sorted(path.name for path in record.iterdir()) == [
        "preview.png",
        "training.json",
        "training.pt",
    ]
