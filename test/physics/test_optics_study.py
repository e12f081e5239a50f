# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole way from bags with images to the figures of images, on a small data set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
import yaml
from numpy.typing import NDArray

from dotsim_ros.data.motion import pose_along
from dotsim_ros.data.trajectory import (
    ImageChannel,
    PoseChannel,
    Trajectory,
    write_trajectory,
)
from studies.optics.study import optics

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


def test_the_study_on_a_small_data_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_photographed_presses(tmp_path)

    def measured() -> dict[str, Any]:
        return optics(
            data=tmp_path,
            sensor=str(tmp_path / "coarse.yaml"),
            models=("idle", "taxim", "carried"),
            splits=("medium", "hard"),
            images=tmp_path / "images",
            cache=tmp_path / "cache",
        )

    figures = measured()
    assert figures["failures"] == []
    for way in ("by_frame", "by_trajectory"):
        assert set(figures["medium"][way]) == {"idle", "taxim", "carried"}
        assert figures["hard"][way]["idle"]["frames"] == 20
    assert figures["medium"]["by_trajectory"]["idle"]["deep"]["frames"] == 2
    assert (tmp_path / "images" / "optics_hard.jpg").is_file()
    capsys.readouterr()
    measured()
    said = capsys.readouterr().out
    assert "following" not in said
    assert said.count("made before") == 12
