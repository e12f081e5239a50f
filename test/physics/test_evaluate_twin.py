# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor judged on recordings of itself, and on recordings that are off by known amounts."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dotsim_ros.cli.main import main
from dotsim_ros.data.data_set_writer import trajectory_of_frames, write_data_set
from dotsim_ros.data.measurement import read_measurement
from dotsim_ros.data.trajectory import Trajectory
from dotsim_ros.gap.images.reading import read_images
from dotsim_ros.geometry.indenter import Indenter, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import vertex_normals
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import (
    CameraSpecification,
    GelSpecification,
    SensorSpecification,
    SolverSpecification,
    write_sensor,
)
from dotsim_ros.twin.footage import read_filmed_data, with_measured_skin

PAD = SensorSpecification(
    name="coarse_pad",
    gel=GelSpecification(
        shape="flat_pad", pad_size_m=(0.016, 0.012, 4.0e-3), skin_spacing_m=1.0e-3
    ),
    solver=SolverSpecification(grid_spacing_m=2.0e-3, refined=False, tolerance_m=1.0e-6),
    camera=CameraSpecification(
        projection="pinhole",
        width=160,
        height=120,
        position_m=(0.0, 0.0, -0.016),
        half_height_angle_deg=14.0,
        principal_point_px=(79.5, 59.5),
        idle_image="",
    ),
)
# By their definitions: a mesh of a ball would be another shape than the one that pressed.
BALL = replace(sphere(0.004), name="sphere(radius_m=0.004)")
SMALL_BALL = replace(sphere(0.003), name="sphere(radius_m=0.003)")
WAY_MM = ((0, 0, -0.3), (0, 0, 0.6), (0, 0, 1.2), (0, 0, 1.6), (0.3, 0, 1.6), (0.6, 0.3, 1.6))
JUDGED = 4
LOUDER, STIFFER, OUT_M = 3, 1.25, 0.1e-3


def recorded(sensor: SensorSpecification, ball: Indenter, name: str) -> Trajectory:
    twin = TactileSensor(sensor, indenter=ball)
    up = np.array([0.0, 0.0, 0.0, 1.0])
    poses = [
        Pose(np.array([1e-3 * x, 1e-3 * y, 4e-3 - 1e-3 * depth]), up) for x, y, depth in WAY_MM
    ]
    return trajectory_of_frames([twin.step(pose, 0.1) for pose in poses], name=name)


def off(true: Trajectory) -> Trajectory:
    """Return a recording whose skin lies 0.1 mm farther out, and whose images are brighter by three
    grey levels."""
    triangles = TactileSensor(PAD, indenter=BALL).skin.triangles
    out_m = [p + OUT_M * vertex_normals(p.astype(float), triangles) for p in true.skin.position_m]
    brighter = true.image.pixels + np.uint8(LOUDER)
    assert true.image.pixels.max() < 255 - LOUDER
    return replace(
        true,
        skin=replace(true.skin, position_m=np.float32(out_m)),
        image=replace(true.image, pixels=brighter),
    )


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Return a data set, with the sensor's file `pad.yaml` next to it."""
    folder = tmp_path_factory.mktemp("evaluated")
    stiff = replace(PAD.material, youngs_modulus_pa=STIFFER * PAD.material.youngs_modulus_pa)
    same = recorded(PAD, BALL, "same_0")
    presses = [
        (same, BALL),
        (off(recorded(replace(PAD, material=stiff), SMALL_BALL, "off_0")), SMALL_BALL),
        (replace(same, name="force_0", skin=None, image=None), BALL),
        (replace(same, name="image_0", skin=None, wrench=None), BALL),
        (replace(same, name="poses_0", skin=None, wrench=None, image=None), BALL),
    ]
    write_data_set(folder / "data", presses, skin=TactileSensor(PAD, indenter=BALL).skin)
    write_sensor(folder / "pad.yaml", PAD, "coarse")
    return folder / "data"


def evaluated(data: Path, out: Path, trajectories: Sequence[str]) -> dict[str, Any]:
    command = ["evaluate", "--data", str(data), "--sensor", str(data.parent / "pad.yaml")]
    command += ["--out", str(out), "--json", str(out / "copy.json"), "--workers", "1"]
    assert main([*command, "--from-depth-mm", "1", "--trajectories", *trajectories]) == 0
    errors: dict[str, Any] = json.loads((out / "errors.json").read_text())
    assert json.loads((out / "copy.json").read_text()) == errors
    return errors


def test_errors_are_zero_on_own_recordings_and_right_on_recordings_that_are_off(
    tmp_path, data, capsys
):
    errors = evaluated(data, tmp_path, ["same_0", "off_0", "poses_0"])

    same = errors["indenters"][BALL.name]
    assert same["skin"]["frames"] == same["force"]["frames"] == same["image"]["frames"] == JUDGED
    assert same["skin"]["largest_mm"] < 0.005
    assert same["force"]["normal_share"] < 0.005
    assert same["force"]["tangential_share"] < 0.005
    assert same["image"]["psnr_db"] > 90.0

    other = errors["trajectories"]["off_0"]
    for key in ("rms_mm", "p95_mm", "largest_mm"):
        assert other["skin"][key] == pytest.approx(0.1, abs=0.002)
    # Softer than what was recorded: a force that is 1 / 1.25 of it.
    share = 1.0 - 1.0 / STIFFER
    assert other["force"]["normal_share"] == pytest.approx(share, abs=0.002)
    assert other["force"]["tangential_share"] == pytest.approx(share, abs=0.005)
    assert other["image"]["difference_levels"] == pytest.approx(LOUDER, abs=0.1)
    assert other["image"]["psnr_db"] == pytest.approx(20 * np.log10(255 / LOUDER), abs=0.3)

    everything = errors["all"]
    assert everything["skin"]["rms_mm"] == pytest.approx(0.1 / np.sqrt(2), abs=0.002)
    assert everything["skin"]["frames"] == 2 * JUDGED
    assert errors["shallow"] == 2 * 2 * (len(WAY_MM) - JUDGED)
    (omission,) = errors["omissions"]
    assert omission["reason"].startswith("skin and force of poses_0: neither /tactile/skin nor")
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png") == 4
    lead = f"{everything['skin']['rms_mm']:.3f} mm RMS of the skin, "
    assert lead in page
    assert lead in capsys.readouterr().out
    assert "off_0, frame" in (tmp_path / "report.md").read_text()


def test_a_pad_is_pressed_where_the_face_of_its_data_is(tmp_path):
    raised_m = np.array([0.0, 0.0, 0.4e-3])
    true = recorded(PAD, BALL, "raised_0")
    raised = replace(
        true,
        pose=replace(true.pose, position_m=true.pose.position_m + raised_m),
        skin=replace(true.skin, position_m=np.float32(true.skin.position_m + raised_m)),
    )
    sensor = TactileSensor(PAD, indenter=BALL)
    skin, data = sensor.skin, tmp_path / "data"
    position_m = skin.rest_position_m + raised_m * ~skin.on_base[:, None]
    write_data_set(
        data,
        [(raised, BALL), (replace(raised, name="raised_1"), BALL)],
        skin=replace(skin, rest_position_m=position_m),
        idle_images=[sensor.idle_image],
    )
    write_sensor(tmp_path / "pad.yaml", PAD, "coarse")
    found = evaluated(data, tmp_path / "out", ["raised_0"])["all"]
    assert found["image"]["psnr_db"] > 60.0
    assert found["force"]["normal_share"] < 0.01
    assert found["skin"]["largest_mm"] < 0.01

    # So it is where a camera is fitted, a network is trained, and images are searched.
    filmed = read_filmed_data(data, PAD, cache=tmp_path / "skins")
    np.testing.assert_allclose(filmed.presses[0].skin_position_m, true.skin.position_m, atol=1e-5)
    measured = with_measured_skin(filmed, data)
    np.testing.assert_allclose(measured.presses[1].skin_position_m, true.skin.position_m, atol=1e-8)
    free = ~skin.on_base
    np.testing.assert_allclose(
        measured.skin.rest_position_m[free], skin.rest_position_m[free], atol=1e-8
    )
    measurement = read_measurement(data, own_skin=skin, images=True)
    seen = read_images(measurement, sensor=PAD).trajectories[0].recording.press
    heights_m = [pose.position_m[2] for pose in seen.poses]
    np.testing.assert_allclose(heights_m, true.pose.position_m[:, 2], atol=1e-12)


def test_one_channel_alone_is_judged_and_the_others_are_said_to_be_missing(tmp_path, data):
    errors = evaluated(data, tmp_path, ["image_0"])
    found = {name: errors["all"][name] for name in ("skin", "force", "image")}
    assert found.pop("image")["frames"] == JUDGED
    assert set(found.values()) == {None}
    page = (tmp_path / "report.html").read_text()
    assert all(f"no {name} to compare" in page for name in found)
    assert page.count("data:image/png") == 3


def test_clouds_without_a_mesh_are_not_compared_and_the_force_is(tmp_path, capsys):
    true = replace(recorded(PAD, BALL, "force_0"), image=None)
    bare = replace(true, wrench=None, name="cloud_0")
    write_data_set(tmp_path / "data", [(true, BALL), (bare, BALL)])
    write_sensor(tmp_path / "pad.yaml", PAD, "coarse")
    errors = evaluated(tmp_path / "data", tmp_path / "out", ["force_0", "cloud_0"])
    assert errors["all"]["skin"] is None
    assert errors["all"]["force"]["frames"] == JUDGED
    assert errors["all"]["force"]["normal_share"] < 0.005
    assert "has no skin_mesh.npz" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--from-depth-mm", "1.8"], "the tip is 1.60 mm deep at most"),
        (["--from-depth-mm", "nan"], "is nan mm and the seed 0, expected 0 or more both"),
        (["--trajectories", "same_1"], "has no trajectory same_1; it has force_0, image_0"),
    ],
)
def test_data_without_a_frame_to_judge_are_refused(tmp_path, data, options, reason, capsys):
    command = ["evaluate", "--data", str(data), "--sensor", str(data.parent / "pad.yaml")]
    assert main([*command, "--out", str(tmp_path / "out"), "--workers", "1", *options]) == 1
    (line,) = [
        s for s in capsys.readouterr().err.splitlines() if s.startswith("dotsim_ros evaluate")
    ]
    assert reason in line
    assert not (tmp_path / "out" / "errors.json").exists()
