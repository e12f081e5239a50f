# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor whose file names a network publishes the image that the network completes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from harness import LockstepPress, TactileFrame, sensor

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.files import parameter_path
from dotsim_ros.optics.idle import lit_region, read_idle_frame
from dotsim_ros.optics.network.card import FORMAT, NetworkCard, camera_hash
from dotsim_ros.specification import load_sensor, write_sensor

PLAIN = load_sensor("densetact2")


@pytest.fixture(scope="module")
def sensor_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of a sensor with a network of random weights."""
    torch = pytest.importorskip("torch", reason="making a network needs the extra 'learning'")
    from dotsim_ros.learning.export import write_network
    from dotsim_ros.learning.networks import make_network

    directory = tmp_path_factory.mktemp("network")
    torch.manual_seed(2)
    network = make_network("ours").eval()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.03 * torch.randn_like(parameter)
    camera = Camera.from_specification(PLAIN.camera)
    write_network(
        directory,
        network,
        NetworkCard(FORMAT, "ours", PLAIN.name, camera_hash(camera), 320, 240, "", ""),
    )
    path = directory / "sensor.yaml"
    write_sensor(path, replace(PLAIN, camera=replace(PLAIN.camera, residual=str(directory))), "")
    return path


def frames_of(name: str) -> list[TactileFrame]:
    with sensor(sensor=name, clock="lockstep", grid_spacing_m=0.0048) as (_, client):
        return LockstepPress(client).run()


def test_the_network_completes_what_the_node_publishes(sensor_file: Path) -> None:
    learned, plain = frames_of(str(sensor_file)), frames_of(PLAIN.name)
    camera = Camera.from_specification(PLAIN.camera)
    idle = read_idle_frame(parameter_path(PLAIN.camera.idle_image), camera).image
    assert np.array_equal(learned[0].image(), idle)
    dark = ~lit_region(idle)
    for one, other in zip(learned[1:], plain[1:], strict=True):
        # The gel is the same; the image is another, inside the lit disc.
        assert np.array_equal(one.depth_m(), other.depth_m(), equal_nan=True)
        assert not np.array_equal(one.image(), other.image())
        assert np.array_equal(one.image()[dark], other.image()[dark])
