# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor whose file names a network publishes the image that the network completes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from harness import LockstepPress, sensor

from dotsim_ros import Pose, TactileSensor, load_indenter, load_sensor
from dotsim_ros.specification import NoiseSpecification, SensorSpecification

LEARNED = replace(load_sensor("sensor_a"), noise=NoiseSpecification())
PLAIN = replace(LEARNED, camera=replace(LEARNED.camera, residual=""))


def test_the_network_completes_what_the_node_publishes() -> None:
    place_m = (0.0, 0.0, LEARNED.gel.outer_radius_m - 1e-3)
    with sensor(sensor=LEARNED.name, image_noise_levels=0.0, clock="lockstep") as (_, client):
        frame = LockstepPress(client).frame_at(place_m)

    def seen_by(specification: SensorSpecification) -> np.ndarray:
        made = TactileSensor(specification, indenter=load_indenter("sphere_4mm"))
        return made.step(Pose(np.array(place_m)), 0.04).image

    assert np.array_equal(frame.image(), seen_by(LEARNED))
    assert not np.array_equal(frame.image(), seen_by(PLAIN))
