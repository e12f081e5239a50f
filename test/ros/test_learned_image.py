# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor whose file names a network publishes the image that the network completes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from harness import LockstepPress, TactileFrame, sensor

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.files import given_path
from dotsim_ros.optics.idle import lit_region, read_idle_frame
from dotsim_ros.specification import NoiseSpecification, load_sensor, write_sensor

LEARNED = replace(load_sensor("sensor_a"), noise=NoiseSpecification())


def frames_of(path: Path, residual: str) -> list[TactileFrame]:
    write_sensor(path, replace(LEARNED, camera=replace(LEARNED.camera, residual=residual)), "")
    with sensor(sensor=str(path), clock="lockstep") as (_, client):
        return LockstepPress(client).run()


def test_the_network_completes_what_the_node_publishes(tmp_path: Path) -> None:
    learned = frames_of(tmp_path / "learned.yaml", LEARNED.camera.residual)
    plain = frames_of(tmp_path / "plain.yaml", "")
    camera = Camera.from_specification(LEARNED.camera)
    idle = read_idle_frame(given_path(LEARNED.camera.idle_image), camera).image
    assert np.array_equal(learned[0].image(), idle)
    dark = ~lit_region(idle)
    for one, other in zip(learned[1:], plain[1:], strict=True):
        # The gel is the same; the image is another where it is pressed, inside the lit disc.
        assert np.array_equal(one.depth_m(), other.depth_m(), equal_nan=True)
        assert np.array_equal(one.image()[dark], other.image()[dark])
    assert not np.array_equal(learned[-1].image(), plain[-1].image())
