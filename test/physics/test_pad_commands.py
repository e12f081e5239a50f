# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A pad by the commands that a dome goes by: calibrated, and searched for what was changed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dotsim_ros.calibration.calibrate import calibrate
from dotsim_ros.calibration.loss import LossNoise
from dotsim_ros.cli.main import main
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.trajectory import PoseChannel, SkinChannel, Trajectory, WrenchChannel
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.indenter import Indenter, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.files import write_image
from dotsim_ros.optics.idle import lights_of
from dotsim_ros.optics.network.card import FORMAT, NetworkCard, camera_hash
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import (
    CameraSpecification,
    GelSpecification,
    SensorSpecification,
    SolverSpecification,
    load_sensor,
    write_sensor,
)
from dotsim_ros.twin.simulator import GelSimulator

THICKNESS_M = 4.0e-3
PAD = SensorSpecification(
    name="coarse_pad",
    gel=GelSpecification(
        shape="flat_pad", pad_size_m=(0.016, 0.012, THICKNESS_M), skin_spacing_m=1.0e-3
    ),
    solver=SolverSpecification(grid_spacing_m=2.0e-3, refined=False),
)
TRUTH = replace(
    values_of(PAD),
    youngs_modulus_pa=1.8e5,
    poisson_ratio=0.46,
    friction=0.3,
    thickness_m=3.5e-3,
)
BALL = replace(sphere(4.0e-3), name="ball")
SMALL_BALL = replace(sphere(2.0e-3), name="small_ball")
SKIN_NOISE_M, FORCE_NOISE_N = 0.01e-3, 0.005


def pad_press(simulator: GelSimulator, name: str, ball: Indenter, way: Sequence[Any]) -> Trajectory:
    """Return a press of the true pad, measured with noise, along places (x, y, depth) in mm."""
    poses = [
        Pose(np.array([1e-3 * x, 1e-3 * y, THICKNESS_M - 1e-3 * depth]), np.array([0, 0, 0, 1.0]))
        for x, y, depth in way
    ]
    stamp_s = 1.0 + 0.1 * np.arange(len(poses))
    exact = simulator.press(TRUTH, ball, poses, stamp_s)
    random = np.random.default_rng(len(name))
    force_n = exact.force_n + FORCE_NOISE_N * random.normal(size=exact.force_n.shape)
    skin_m = exact.skin_position_m + SKIN_NOISE_M * random.normal(size=exact.skin_position_m.shape)
    stamp_ns = np.round(1e9 * stamp_s).astype(np.int64)
    return Trajectory(
        pose=PoseChannel(
            stamp_ns,
            np.stack([pose.position_m for pose in poses]),
            np.stack([pose.quaternion_xyzw for pose in poses]),
        ),
        wrench=WrenchChannel(stamp_ns, force_n, np.zeros_like(force_n)),
        skin=SkinChannel(stamp_ns, skin_m.astype(np.float32)),
        name=name,
    )


def lit_pad(folder: Path) -> SensorSpecification:
    """Return the pad with an idle image, lights next to it, and a network for its camera."""
    export = pytest.importorskip("dotsim_ros.learning.export", exc_type=ImportError)
    from dotsim_ros.learning.neighbourhood import NeighbourhoodModel

    size = width, height = 160, 120
    image, network = folder / "idle.png", folder / "network"
    write_image(image, np.full((height, width, 3), 120, dtype=np.uint8))
    lines = [
        "# A photograph of somebody's.",
        "lighting:",
        "  height_m: -0.002",
        "  radius_m: 0.012",
    ]
    image.with_suffix(".yaml").write_text("\n".join(lines))
    camera = CameraSpecification(
        projection="pinhole",
        width=width,
        height=height,
        position_m=(0.0, 0.0, -0.016),
        half_height_angle_deg=16.0,
        principal_point_px=(79.5, 59.5),
        idle_image=str(image),
        residual=str(network),
    )
    hashed = camera_hash(Camera.from_specification(camera))
    card = NetworkCard(FORMAT, "neighbourhood", PAD.name, hashed, *size, "", "")
    export.write_network(network, NeighbourhoodModel().eval(), card)
    return replace(PAD, camera=camera)


def searched(data: Path, sensor: Path, out: Path) -> dict[str, Any]:
    command = ["find-gap", "--measured", str(data), "--sensor", str(sensor), "--out", str(out)]
    command += ["--candidates", "thickness_error", "pose_offset"]
    status = main([*command, "--workers", "1"])
    findings: dict[str, Any] = json.loads((out / "findings.json").read_text())
    assert status == {"no_gap": 0, "named": 10}[findings["verdict"]]
    return findings


def test_a_thinner_softer_pad_is_calibrated_and_its_thickness_is_missed_where_it_is_not_fitted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    skin = skin_of(PAD.gel)
    simulator = GelSimulator(PAD, skin)
    slide = [(0, 0, -0.3), (0, 0, 0.5), (0, 0, 1.0), (0, 0, 1.5), (0.4, 0, 1.5), (0.9, 0, 1.5)]
    press = [(2, 1, -0.3), (2, 1, 0.5), (2, 1, 1.0), (2, 1, 1.5), (2, 1, 0.5)]
    data, before, fitted = (tmp_path / name for name in ("data", "before.yaml", "fitted.yaml"))
    write_data_set(
        data,
        [
            (pad_press(simulator, "slide_0", BALL, slide), BALL),
            (pad_press(simulator, "press_0", SMALL_BALL, press), SMALL_BALL),
        ],
        skin=skin,
    )
    pad = lit_pad(tmp_path)
    write_sensor(before, pad, "lit")
    TactileSensor.load(before)

    command = ["calibrate", "--data", str(data), "--sensor", str(before), "--out", str(fitted)]
    command += ["--fit", "E", "nu", "friction", "thickness", "--hold-out", "0"]
    command += ["--noise-skin-discretisation-m", "1e-5", "--noise-force-discretisation", "0.01"]
    # The network is for a sensor of this name.
    command += ["--joint-steps", "0", "--solves", "24", "--workers", "1", "--name", PAD.name]
    assert main(command) == 0
    sensor = load_sensor(fitted)
    found = values_of(sensor)
    assert found.youngs_modulus_pa == pytest.approx(TRUTH.youngs_modulus_pa, rel=0.06)
    assert np.log(0.5 - found.poisson_ratio) == pytest.approx(np.log(0.04), abs=0.25)
    assert found.friction == pytest.approx(TRUTH.friction, rel=0.15)
    assert found.thickness_m == pytest.approx(TRUTH.thickness_m, abs=0.08e-3)
    printed = capsys.readouterr().out
    assert "lower poses by 0." in printed

    # The camera sees the face as it did, lit as before, and by no network of another camera.
    TactileSensor.load(fitted)
    assert sensor.camera.residual == ""
    drop_m = THICKNESS_M - sensor.gel.thickness_m
    assert pad.camera.position_m[2] - sensor.camera.position_m[2] == pytest.approx(drop_m)
    lights = [lights_of(each)[0].lights for each in (pad, sensor)]
    for stood, stands in zip(*lights, strict=True):
        assert stands.position_m[:2] == stood.position_m[:2]
        assert stood.position_m[2] - stands.position_m[2] == pytest.approx(drop_m, abs=1e-9)
    copied = (tmp_path / "fitted_idle.yaml").read_text()
    assert copied.startswith("# A photograph of somebody's.\n# The lights 0.")
    assert sensor.camera.idle_image == str(tmp_path / "fitted_idle.png")
    # What the sensor before is lit by is as it was.
    assert (tmp_path / "idle.yaml").read_text().endswith("radius_m: 0.012")
    assert "this sensor names none; train one with dotsim_ros train-optics" in printed
    assert "lights: as far from the face as before" in printed
    remarks = json.loads((tmp_path / "fitted_report" / "report.json").read_text())["remarks"]
    assert len(remarks) == 2

    # The same call without a file to write, from the run that is kept.
    unwritten = calibrate(
        data,
        sensor=pad,
        fit=("E", "nu", "friction", "thickness"),
        hold_out=0,
        noise=LossNoise(skin_discretisation_m=1e-5, force_discretisation=0.01),
        joint_steps=0,
        solves=24,
        workers=1,
        run_folder=tmp_path / "fitted_report" / "run",
    )
    assert unwritten.specification.camera.idle_image == pad.camera.idle_image
    assert "has them where they were" in unwritten.remarks[1]

    # A file that is off by less than an effect, and by more than the floor, is not passed over. It
    # has the face lower than the data have it: the presses meet it all the same.
    stiffer = tmp_path / "stiffer.yaml"
    material = replace(sensor.material, youngs_modulus_pa=1.25 * found.youngs_modulus_pa)
    write_sensor(stiffer, replace(sensor, material=material), "stiffer than fitted")
    made_up = searched(data, stiffer, tmp_path / "stiffer")
    assert made_up["verdict"] == "no_gap"
    assert made_up["sentence"].startswith("No gap beyond the twin's constants")
    assert "RMS force 0.2" in made_up["sentence"]
    assert "To tell, record for" in made_up["sentence"]
    modulus = next(c for c in made_up["calibrated"] if c["name"] == "E")
    assert modulus["value"] == pytest.approx(TRUTH.youngs_modulus_pa, rel=0.1)

    thicker = tmp_path / "thicker.yaml"
    write_sensor(thicker, replace(sensor, gel=PAD.gel), "all but the thickness")
    missed = searched(data, thicker, tmp_path / "missed")
    assert missed["named"] == ["thickness_error"]
    entry = next(c for c in missed["candidates"] if c["name"] == "thickness_error")
    (share,) = entry["estimates"]
    # A hundredth or two of it is taken for the tolerance of any unit.
    assert share["value"] == pytest.approx(-0.11, abs=0.035)
    tolerance = next(c for c in missed["calibrated"] if c["name"] == "thickness")
    assert tolerance["unit"] == "share"
    assert abs(tolerance["value"]) < 0.05
