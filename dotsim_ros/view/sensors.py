# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What sensors look like, untouched and with a ball pressed into them, and how fast they are."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from itertools import cycle, islice
from pathlib import Path

import cv2
import numpy as np

from dotsim_ros.geometry.markers import MarkerMotion
from dotsim_ros.geometry.pose import ApexPose
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.files import write_image
from dotsim_ros.sensor import FRAME_S, TactileSensor
from dotsim_ros.specification import SensorSpecification

INDENTER = "sphere_4mm"
DEPTH_SHARE = 0.3
"""Of the gel's thickness; few pads take more."""
LARGEST_DEPTH_M = 2.0e-3
SLIDE_SHARE = 0.5
"""How far the ball slides along +x after the press, over its depth: markers show it."""
STEP_M = 0.2e-3
ARROW_LENGTHENING = 3.0
ARROW_COLOUR = (255, 255, 0)
SHEET = "sensors.jpg"
CLEARANCE_M = 0.5e-3
PRESS_M_S, SLIDE_M_S, SLIDE_M = 5.0e-3, 10.0e-3, 4.0e-3
SETTLE_FRAMES = 10
ROW_HEIGHT_PX, TITLE_HEIGHT_PX, GAP_PX = 200, 22, 12


def pressed_images(name: str) -> tuple[ImageArray, ImageArray]:
    """Return a sensor's images (H, W, 3), by its name or file, untouched and pressed; the motion of
    its printed markers is drawn into the pressed one as arrows of `ARROW_LENGTHENING` times their
    length."""
    sensor = TactileSensor.load(name, indenter=INDENTER)
    depth_m = min(DEPTH_SHARE * sensor.specification.gel.thickness_m, LARGEST_DEPTH_M)
    poses = [ApexPose(d) for d in np.linspace(0.0, depth_m, int(np.ceil(depth_m / STEP_M)) + 1)]
    way_m = SLIDE_SHARE * depth_m
    poses += [
        ApexPose(depth_m, x_m=x) for x in np.linspace(0.0, way_m, int(np.ceil(way_m / STEP_M)) + 1)
    ]
    for pose in poses[:-1]:
        sensor.press(pose)
    frame = sensor.step(poses[-1])
    image = frame.image
    if sensor.markers is not None:
        image = with_arrows(image, sensor.marker_motion(frame.skin_position_m))
    return sensor.idle_image, image


def with_arrows(image: ImageArray, motion: MarkerMotion) -> ImageArray:
    """Return an image (H, W, 3) with an arrow at each marker that it shows."""
    drawn = np.ascontiguousarray(image).copy()
    for start, end in zip(motion.rest_px, motion.position_px, strict=True):
        tip = start + ARROW_LENGTHENING * (end - start)
        if np.all(np.isfinite([start, tip])):
            first, last = (tuple(int(v) for v in np.rint(place)) for place in (start, tip))
            cv2.arrowedLine(drawn, first, last, ARROW_COLOUR, 1, cv2.LINE_AA, tipLength=0.3)
    return drawn


def write_pictures(names: Sequence[str], directory: Path) -> Iterator[Path]:
    """Write NAME_idle.png and NAME_pressed.png of each sensor, then all of them next to each other
    as sensors.jpg, and yield the paths."""
    directory.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in names:
        pair = pressed_images(name)
        rows.append(_row(name, pair))
        for state, image in zip(("idle", "pressed"), pair, strict=True):
            path = directory / f"{name}_{state}.png"
            write_image(path, image)
            yield path
    sheet = directory / SHEET
    write_image(sheet, _sheet(rows))
    yield sheet


def _row(name: str, pair: tuple[ImageArray, ImageArray]) -> ImageArray:
    """Return both images of a sensor, next to each other below its name."""
    height, width = pair[0].shape[:2]
    size = (round(width * ROW_HEIGHT_PX / height), ROW_HEIGHT_PX)
    images = np.hstack([cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in pair])
    title = np.full((TITLE_HEIGHT_PX, images.shape[1], 3), 255, dtype=np.uint8)
    place = (4, TITLE_HEIGHT_PX - 7)
    cv2.putText(title, name, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([title, images])


def _sheet(rows: Sequence[ImageArray]) -> ImageArray:
    """Return rows in two columns on white."""
    width = max(row.shape[1] for row in rows) + GAP_PX
    wide = [
        cv2.copyMakeBorder(
            row, 0, 0, 0, width - row.shape[1], cv2.BORDER_CONSTANT, value=(255, 255, 255)
        )
        for row in rows
    ]
    if len(wide) % 2:
        wide.append(np.full_like(wide[0], 255))
    return np.vstack([np.hstack(wide[i : i + 2]) for i in range(0, len(wide), 2)])


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
