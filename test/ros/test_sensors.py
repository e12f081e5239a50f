# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The node with other sensors: a pad by its name, and one whose camera has noise."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from harness import APEX_M, Client, LockstepPress, sensor
from sensor_msgs.msg import PointCloud2

import msg_adapters
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.specification import load_sensor, sensor_path

LOCKSTEP = {"clock": "lockstep", "diagnostics_period_s": 0.1}


def test_a_pad_with_markers_is_pressed_and_seen_by_a_pinhole() -> None:
    file = load_sensor("gelsight_mini_markers")
    top_m, count = file.gel.pad_size_m[2], file.markers.columns * file.markers.rows
    clouds = {}

    def keep(message: PointCloud2) -> None:
        clouds[msg_adapters.message_stamp_ns(message)] = message

    with sensor(sensor=file.name, **LOCKSTEP) as (node, client):
        client.node.create_subscription(PointCloud2, "markers", keep, 50)
        press = LockstepPress(client)
        away = press.frame_at((0.0, 0.0, top_m + 0.05))
        assert away.force_n().tolist() == [0.0, 0.0, 0.0]
        touched = press.frame_at((0.0, 0.0, top_m - 0.001))
        end_s = time.monotonic() + 30.0
        # The markers' publisher learns of its reader on its own way.
        while touched.stamp_ns not in clouds and time.monotonic() < end_s:
            touched = press.frame_at((0.0, 0.0, top_m - 0.001))
        assert touched.force_n()[2] > 0.5
        middle = (117, 153)
        sunk_m = away.depth_m()[middle] - touched.depth_m()[middle]
        assert sunk_m == pytest.approx(0.001, abs=4e-5)
        change = np.abs(touched.image().astype(float) - away.image()).max(axis=2)
        dent, far = change[95:140, 130:176].mean(), change[5:60, 5:60].mean()
        assert dent > 10.0
        assert far < 0.2 * dent
        assert np.abs(touched.cloud().position[:, 2] - top_m).max() == pytest.approx(
            0.001, abs=4e-5
        )
        info = msg_adapters.decode_camera_info(touched.messages["camera_info"])
        assert info.distortion_model == "plumb_bob"
        assert info.distortion.tolist() == [0.203, 0.0, 0.0, 0.0, 0.0]
        assert info.focal_px == pytest.approx(120.0 / np.tan(np.radians(23.2)))
        markers = msg_adapters.decode_cloud(clouds[touched.stamp_ns])
        assert len(markers.position) == count
        assert markers.displacement[:, 2].argmin() == count // 2
        assert markers.displacement[count // 2, 2] == pytest.approx(-0.001, abs=4e-5)
        camera = Camera.from_specification(file.camera)
        rest_m = markers.position - markers.displacement
        assert markers.pixel == pytest.approx(camera.project(markers.position), abs=1e-2)
        moved = markers.pixel - camera.project(rest_m)
        assert markers.pixel_displacement == pytest.approx(moved, abs=1e-2)
        assert node.interrupt() == 0


@pytest.fixture
def noisy_sensor(tmp_path: Path) -> Path:
    document = yaml.safe_load(sensor_path("densetact2").read_text())
    document["noise"] = {"deviation_levels": 3.0, "seed": 2}
    path = tmp_path / "noisy.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def idle_image(client: Client, stamp_ns: int) -> np.ndarray:
    client.send((0.0, 0.0, APEX_M + 0.05), stamp_ns=stamp_ns)
    return client.whole_frame(stamp_ns).image().astype(float)


def test_the_sensors_noise_is_published_unless_the_parameter_is_set(noisy_sensor: Path) -> None:
    with sensor(sensor=noisy_sensor, **LOCKSTEP) as (_, client):
        first, second, third = (idle_image(client, 10**10 + k * 10**9) for k in range(3))
        assert client.set_parameters(image_noise_levels=0.0).successful
        clean = idle_image(client, 10**10 + 3 * 10**9)
        assert np.array_equal(clean, idle_image(client, 10**10 + 4 * 10**9))
        lit = clean.min(axis=2) > 50.0
        for image in (first, second, third):
            assert (image - clean)[lit].std() == pytest.approx(3.0, rel=0.1)
        assert not np.array_equal(first, second)
        assert client.set_parameters(image_noise_levels=-1.0).successful
        assert (idle_image(client, 10**10 + 5 * 10**9) - clean)[lit].std() > 2.0
