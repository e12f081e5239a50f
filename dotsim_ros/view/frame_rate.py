# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How many frames a sensor gives in a second on this machine."""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import cycle, islice

import numpy as np

from dotsim_ros.geometry.pose import ApexPose
from dotsim_ros.sensor import FRAME_S, TactileSensor
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.view.sensors import DEPTH_SHARE, INDENTER, LARGEST_DEPTH_M

CLEARANCE_M = 0.5e-3
PRESS_M_S, SLIDE_M_S, SLIDE_M = 5.0e-3, 10.0e-3, 4.0e-3
SETTLE_FRAMES = 10


def motion(sensor: SensorSpecification) -> list[ApexPose]:
    """Return a pose a frame: press, slide there and back, and lift."""
    depth_m = min(DEPTH_SHARE * sensor.gel.thickness_m, LARGEST_DEPTH_M)
    press = [ApexPose(float(d)) for d in np.arange(-CLEARANCE_M, depth_m, PRESS_M_S * FRAME_S)]
    there = np.arange(0.0, SLIDE_M, SLIDE_M_S * FRAME_S)
    slide = [ApexPose(depth_m, x_m=float(x)) for x in (*there, *reversed(there))]
    return [*press, *slide, *reversed(press)]


def warm_sensor(sensor: SensorSpecification, poses: Sequence[ApexPose]) -> TactileSensor:
    """Return a sensor with the ball, at rest, whose kernels and caches the first of some poses have
    warmed up."""
    made = TactileSensor.load(sensor, indenter=INDENTER)
    for pose in poses[:SETTLE_FRAMES]:
        made.step(pose)
    made.reset()
    return made


def frames_per_second(sensor: SensorSpecification, frame_count: int) -> float:
    """Return the rate of a sensor's frames with its own solver, gel and image one after the other,
    while a ball of 4 mm radius presses, slides and lifts, again and again.

    Args:
        sensor: whose frames.
        frame_count: how many to take the time of, 1 or more.

    Raises:
        ValueError: no frame.
    """
    if frame_count < 1:
        raise ValueError(f"{frame_count} frames have no rate, expected 1 or more")
    poses = motion(sensor)
    made = warm_sensor(sensor, poses)
    begun_s = time.perf_counter()
    for pose in islice(cycle(poses), frame_count):
        made.step(pose)
    return frame_count / (time.perf_counter() - begun_s)
