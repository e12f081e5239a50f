# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole way from bags with images to the optics table, on a small data set."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
import yaml
from numpy.typing import NDArray

from dotsim_ros.cli.main import main
from dotsim_ros.measured.motion import pose_along
from dotsim_ros.measured.trajectory import (
    ImageChannel,
    PoseChannel,
    Trajectory,
    write_trajectory,
)
from studies.rivals.optics import tacto

RADIUS_M = 0.01575
TIP_DEPTHS_M = (-0.5e-3, 0.5e-3, 1.2e-3, 1.9e-3, 2.5e-3)
COARSE_SENSOR = """
name: coarse
gel: {shape: dome, skin_spacing_m: 0.0016}
solver: {grid_spacing_m: 0.004, refined: false, friction_passes: 1}
camera: {width: 64, height: 48, principal_point_px: [31.5, 23.5]}
"""


def photographed(idle: NDArray[np.uint8], x: float, depth_m: float) -> NDArray[np.uint8]:
    """Return an image with a spot where the gel is pressed, stronger the deeper."""
    rows, columns = np.mgrid[: idle.shape[0], : idle.shape[1]]
    spot = np.exp(-((columns - 31.5 - 60.0 * x) ** 2 + (rows - 23.5) ** 2) / 30.0)
    level = idle + 2.0e4 * max(depth_m, 0.0) * spot[..., None]
    return np.clip(level, 0.0, 255.0).astype(np.uint8)


def write_photographed_presses(folder: Path) -> None:
    """Write two presses of each of three balls, with images, and the sensor's file."""
    random = np.random.default_rng(0)
    rows, columns = np.mgrid[:48, :64]
    lit = np.hypot(columns - 31.5, rows - 23.5) < 22.0
    idle = (random.integers(70, 130, size=(48, 64, 3)) * lit[..., None]).astype(np.uint8)
    for k in range(2):
        cv2.imwrite(str(folder / f"idle_{k}.png"), idle[..., ::-1])
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.002)
    ball.apply_translation([0.0, 0.0, 0.002])
    records = []
    for number in range(6):
        indenter, x = f"{number // 2 + 1}_ball", 0.1 * (number - 2.5)
        outward = np.array([x, 0.0, np.sqrt(1.0 - x * x)])
        poses = [pose_along((RADIUS_M - depth) * outward, outward) for depth in TIP_DEPTHS_M]
        stamps = np.array([10**9 + 10**8 * k for k in range(len(poses))])
        images = np.stack([photographed(idle, x, depth) for depth in TIP_DEPTHS_M])
        trajectory = Trajectory(
            pose=PoseChannel(
                stamps,
                np.stack([pose.position_m for pose in poses]),
                np.stack([pose.quaternion_xyzw for pose in poses]),
            ),
            image=ImageChannel(stamps, images),
        )
        name = f"{indenter}_{number % 2}"
        write_trajectory(folder / "bags" / name, trajectory)
        records.append({"bag": f"bags/{name}", "indenter": indenter, "frames": 5, "images": True})
        (folder / "indenters").mkdir(exist_ok=True)
        ball.export(folder / "indenters" / f"{indenter}.stl")
    (folder / "dataset.yaml").write_text(yaml.safe_dump({"trajectories": records}))
    (folder / "coarse.yaml").write_text(COARSE_SENSOR)


def test_the_command_on_a_small_data_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DOTSIM_ROS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(tacto, "GENERATIONS", 2)
    monkeypatch.setattr(tacto, "SEARCH_PIXELS", 1000)
    write_photographed_presses(tmp_path)
    command = [
        *("evaluate", "optics", "--data", str(tmp_path), "--sensor", str(tmp_path / "coarse.yaml")),
        *("--models", "idle", "tacto", "taxim", "carried", "--splits", "medium", "hard"),
        *("--out", str(tmp_path / "out"), "--images", str(tmp_path / "images")),
        *("--json", str(tmp_path / "copy.json")),
    ]
    assert main(command) == 0
    figures = json.loads((tmp_path / "out" / "optics.json").read_text())
    assert json.loads((tmp_path / "copy.json").read_text()) == figures
    assert figures["failures"] == []
    for way in ("by_frame", "by_trajectory"):
        assert set(figures["medium"][way]) == {"idle", "tacto", "taxim", "carried"}
        assert figures["hard"][way]["idle"]["frames"] == 20
    assert figures["provenance"]["seed"] == "0"
    assert figures["medium"]["by_trajectory"]["idle"]["deep"]["frames"] == 2
    assert (tmp_path / "images" / "optics_hard.jpg").is_file()
    assert "# Images of" in (tmp_path / "out" / "optics.md").read_text()
    capsys.readouterr()
    assert main(command) == 0
    said = capsys.readouterr().err
    assert "following" not in said
    assert said.count("made before") == 16


def test_a_sensor_for_each_level_and_how_long_networks_were_trained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("torch")
    monkeypatch.setenv("DOTSIM_ROS_CACHE", str(tmp_path / "cache"))
    write_photographed_presses(tmp_path)
    calibrated = tmp_path / "calibrated"
    calibrated.mkdir()
    (calibrated / "easy.yaml").write_text(COARSE_SENSOR)
    moved = COARSE_SENSOR.replace("[31.5, 23.5]", "[33.0, 23.5]")
    (calibrated / "hard.yaml").write_text(moved)
    command = [
        *("evaluate", "optics", "--data", str(tmp_path), "--sensor", str(calibrated)),
        *("--models", "carried", "unet", "--network-epochs", "1", "--network-width", "64"),
        *("--out", str(tmp_path / "out"), "--images", str(tmp_path / "images")),
    ]
    assert main([*command, "--splits", "medium"]) == 1
    assert "holds no medium.yaml" in capsys.readouterr().err
    assert main([*command, "--splits", "easy", "hard"]) == 0
    figures = json.loads((tmp_path / "out" / "optics.json").read_text())
    assert set(figures["splits"]) == {
        f"{level}.{way}" for level in ("easy", "hard") for way in ("by_frame", "by_trajectory")
    }
    assert figures["hard"]["by_frame"]["carried"]["training"] is None
    training = figures["hard"]["by_frame"]["unet"]["training"]
    assert (training["width_px"], training["height_px"]) == (64, 48)
    assert training["epochs"] == 1
    page = (tmp_path / "out" / "optics.md").read_text()
    assert "unet: **1 of its 100 epochs** in " in page
    assert "images of 64x48" in page
    assert page.index("## Easy") < page.index("optics_easy.jpg") < page.index("## Hard")
