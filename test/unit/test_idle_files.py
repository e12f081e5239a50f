# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The idle image of a calibrated sensor: where it lies, and its lights when they move."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dotsim_ros.calibration.idle_files import described_image, idle_image_of, write_lowered_copy
from dotsim_ros.io.files import given_path, parameter_path, write_image
from dotsim_ros.optics.idle import fine_path, lights_of, stated_lights
from dotsim_ros.specification import SensorSpecification, load_sensor

DROP_M = 0.3e-3


def with_image(sensor: SensorSpecification, image: str | Path) -> SensorSpecification:
    return replace(sensor, camera=replace(sensor.camera, idle_image=str(image)))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_an_image_lies_beside_its_sensor_and_a_shipped_one_below_params():
    out = Path("/somewhere/mine.yaml")
    assert idle_image_of(out) == (Path("/somewhere/mine_idle.png"), "/somewhere/mine_idle.png")
    sensors = parameter_path("sensors").resolve()
    shipped = sensors.parent / "images" / "mine_idle.jpg"
    assert idle_image_of(sensors / "mine.yaml", ".jpg") == (shipped, "images/mine_idle.jpg")


@pytest.mark.parametrize("name", ["gelsight_mini", "digit", "flat_pad"])
def test_a_copy_has_the_lights_of_a_shipped_pad_lower_and_all_else_as_it_was(name, tmp_path):
    sensor = load_sensor(name)
    described = described_image(sensor)
    assert described is not None
    copied = with_image(sensor, write_lowered_copy(described, DROP_M, tmp_path / "mine.yaml"))
    (before, shade), (after, same_shade) = stated_lights(sensor), stated_lights(copied)
    assert after.height_m == pytest.approx(before.height_m - DROP_M, abs=1e-9)
    assert replace(after, height_m=before.height_m) == before
    assert same_shade == shade
    image = given_path(sensor.camera.idle_image)
    assert (tmp_path / "mine_idle.png").read_bytes() == image.read_bytes()
    text = (tmp_path / "mine_idle.yaml").read_text()
    assert text.startswith(image.with_suffix(".yaml").read_text().splitlines()[0])
    assert f"0.3 mm lower than in {image.name}" in text


def test_a_copy_takes_the_samples_along_and_leaves_what_the_sensor_before_has(tmp_path):
    image, out = tmp_path / "mine_idle.png", tmp_path / "mine.yaml"
    write_image(image, np.full((24, 32, 3), 90, dtype=np.uint8))
    write_image(fine_path(image), np.full((47, 63, 3), 90, dtype=np.uint8))
    image.with_suffix(".yaml").write_text("vignetting:\n  falloff: [-0.1]\n")
    sensor = with_image(load_sensor("gelsight_mini"), image)
    written = contents(tmp_path)
    for _ in range(2):
        described = described_image(sensor)
        assert described is not None
        moved = with_image(sensor, write_lowered_copy(described, DROP_M, out))
        assert {name: contents(tmp_path)[name] for name in written} == written
        stood, stands = (lights_of(each)[0].lights[0].position_m[2] for each in (sensor, moved))
        assert stood - stands == pytest.approx(DROP_M)
        assert fine_path(Path(moved.camera.idle_image)).is_file()

    fine_path(image).unlink()
    described = described_image(sensor)
    assert described is not None
    assert not fine_path(Path(write_lowered_copy(described, DROP_M, out))).exists()


def test_what_nothing_describes_is_not_copied(tmp_path):
    write_image(tmp_path / "idle.png", np.full((24, 32, 3), 90, dtype=np.uint8))
    pad = load_sensor("gelsight_mini")
    assert described_image(with_image(pad, "")) is None
    assert described_image(with_image(pad, tmp_path / "idle.png")) is None
