# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`dotsim_ros sensors`, and that every shipped sensor is whole."""

from __future__ import annotations

import pytest

from dotsim_ros.cli.main import main
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import shipped_names
from dotsim_ros.optics.idle import lit_region
from dotsim_ros.optics.pattern import idle_frame_of
from dotsim_ros.specification import load_sensor, read_source, sensor_path


def test_every_shipped_sensor_is_listed(tmp_path, capsys):
    path = tmp_path / "sensors.json"
    assert main(["sensors", "--json", str(path), "--seed", "3"]) == 0
    first, *rows = capsys.readouterr().out.splitlines()
    assert first.split() == ["name", "shape", "camera", "law", "source"]
    assert [row.split()[0] for row in rows] == shipped_names("sensors")
    digit = next(row for row in rows if row.startswith("digit "))
    assert digit.split()[1:6] == ["curved_pad", "pinhole", "240x320", "rgb", "neo_hookean"]
    listing = read_json(path)
    assert [sensor["name"] for sensor in listing["sensors"]] == shipped_names("sensors")
    listed = next(sensor for sensor in listing["sensors"] if sensor["name"] == "digit")
    assert (listed["shape"], listed["camera"]) == ("curved_pad", "pinhole 240x320 rgb")
    assert {sensor["frames_per_second"] for sensor in listing["sensors"]} == {None}
    assert "--frames N measures it" in listing["note"]
    assert listing["provenance"]["command"]
    assert main(["sensors", "digits"]) == 1
    assert "no shipped sensor 'digits'; there are densetact2, digit," in capsys.readouterr().err


def test_a_rate_is_measured_where_it_is_asked_for(tmp_path, capsys):
    path = tmp_path / "sensors.json"
    assert main(["sensors", "flat_pad", "--frames", "3", "--json", str(path)]) == 0
    (flat,) = read_json(path)["sensors"]
    assert 0.1 < flat["frames_per_second"] < 10_000.0
    assert "measures it" not in read_json(path)["note"]
    # Warp tells of its kernels first.
    *_, head, row = capsys.readouterr().out.splitlines()
    assert head.split()[3] == "frames_per_second"
    assert f" {flat['frames_per_second']} " in row
    assert main(["sensors", "flat_pad", "--frames", "0"]) == 1
    assert "0 frames have no rate" in capsys.readouterr().err


@pytest.mark.parametrize("name", shipped_names("sensors"))
def test_a_shipped_sensor_says_its_source_and_has_an_image(name):
    sensor = load_sensor(name)
    assert sensor.name == name
    assert read_source(sensor_path(name))
    frame = idle_frame_of(sensor, Camera.from_specification(sensor.camera))
    assert lit_region(frame.image).mean() > 0.3
    grey = (frame.image == frame.image[..., :1]).all()
    assert grey == (sensor.camera.colour == "grey")
