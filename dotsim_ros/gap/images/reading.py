# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images of a data set as the gap finder sees them, and what of them cannot be used."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.measurement import Measurement
from dotsim_ros.data.reading import BadBagError
from dotsim_ros.data.recording import Recording, recording_of
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.specification import SensorSpecification

ALIKE = 0.5
"""Correlation of the pattern of two idle frames of one unit; those of two units have 0.2 to 0.3 at
the best shift, those of one 0.9 and more, and a camera that has moved, dimmed or worn keeps it."""
TILES = (8, 6)
"""Columns and rows of the pieces of an image whose patterns are compared."""
REACH_SHARE = 0.04
"""How far pieces may have moved, of the image's height: a tilt of 3 degrees."""
FINE_PX = 6.0
"""The pattern is what is finer than this blur, in an image 240 px high."""


@dataclass(frozen=True)
class ImageTrajectory:
    """A trajectory with images.

    Attributes:
        recording: the motion at the images' times; force as far as it was measured, no skin.
        measured: (F, H, W, 3) uint8.
    """

    recording: Recording
    measured: ImageArray


@dataclass(frozen=True)
class MeasuredImages:
    """What a camera took of a data set.

    Attributes:
        idle_images: (N, H, W, 3) uint8 without contact.
        trajectories: with images of the same size, in the order of the index.
        warnings: what was left out, and why.
        digest: of all that was read.
    """

    idle_images: ImageArray
    trajectories: tuple[ImageTrajectory, ...]
    warnings: tuple[str, ...]
    digest: str

    @property
    def idle(self) -> ImageArray:
        """Mean (H, W, 3) of the idle images."""
        return np.rint(self.idle_images.mean(axis=0)).astype(np.uint8)


def read_images(measurement: Measurement, *, sensor: SensorSpecification) -> MeasuredImages:
    """Return the images of a measurement as a twin sees them, next to its idle images.

    Raises:
        FileNotFoundError: no idle image.
        ValueError: an idle image that shows a contact, or no trajectory with images.
    """
    # Loaded on use: they start Warp.
    from dotsim_ros.gel.make import skin_of
    from dotsim_ros.optics.idle_check import mean_idle_image, read_idle_images
    from dotsim_ros.twin.simulator import base_in_data_m, seen_from

    data_set = measurement.data_set
    skin, base_m = skin_of(sensor.gel), base_in_data_m(sensor, data_set)
    paths = data_set.idle_images()
    idle_images = read_idle_images(paths)
    mean_idle_image(idle_images, paths)
    warnings = [*measurement.image_warnings]
    trajectories = []
    digest = hashlib.sha256(idle_images.tobytes())
    for footage in measurement.footage:
        images = footage.images
        try:
            images.check_size(idle_images[0])
        except BadBagError as error:
            warnings.append(f"the images of {images.press.name} were left out: {error}")
            continue
        press = seen_from(images.press, base_m)
        recording = recording_of(press, footage.indenter, skin, footage.session_s)
        trajectories.append(ImageTrajectory(recording, images.pixels))
        digest.update(images.pixels.tobytes())
    if not trajectories:
        raise ValueError(
            f"no trajectory of {data_set.directory} has images that can be used; record the "
            "camera's images next to the poses, and say 'images: true' in the index"
            + "".join(f"; {text}" for text in warnings)
        )
    return MeasuredImages(
        idle_images, tuple(trajectories), tuple(warnings), digest.hexdigest()[:16]
    )


def check_same_unit(idle: ImageArray, measured: ImageArray, *, owner: str) -> None:
    """Refuse images of another unit: the pattern of the coat is each unit's own.

    Args:
        idle: (H, W, 3) of the twin or of the commissioning.
        measured: (H, W, 3) of the data set.
        owner: of the former, for the message.

    Raises:
        ValueError: another size or another pattern.
    """
    if idle.shape != measured.shape:
        raise ValueError(
            f"the idle images are {measured.shape[1]}x{measured.shape[0]}, {owner} is "
            f"{idle.shape[1]}x{idle.shape[0]}: take both with one camera and setting"
        )
    found = pattern_likeness(idle, measured)
    if found < ALIKE:
        raise ValueError(
            f"the idle images show another pattern than {owner} (correlation {found:.2f}, expected "
            f"{ALIKE} at least): they belong to another unit; name its own twin with --sensor, or "
            "its commissioning with --reference"
        )


def pattern_likeness(one: ImageArray, other: ImageArray) -> float:
    """Return how alike the patterns of two images (H, W, 3) are: the median, over pieces of the
    image, of their correlation at the best shift."""
    first, second = _fine(one), _fine(other)
    height, width = first.shape
    reach = max(1, round(REACH_SHARE * height))
    columns, rows = TILES
    found = []
    for row in range(rows):
        for column in range(columns):
            top, bottom = max(row * height // rows, reach), (row + 1) * height // rows
            left, right = max(column * width // columns, reach), (column + 1) * width // columns
            bottom, right = min(bottom, height - reach), min(right, width - reach)
            piece = first[top:bottom, left:right]
            if min(piece.shape) < 4 or np.mean(piece != 0.0) < 0.8:
                continue
            around = second[top - reach : bottom + reach, left - reach : right + reach]
            found.append(float(cv2.matchTemplate(around, piece, cv2.TM_CCOEFF_NORMED).max()))
    return float(np.median(found)) if found else 0.0


def _fine(image: ImageArray) -> NDArray[np.float32]:
    """Return (H, W) what is fine in an image, relative to its brightness; 0 where it is dark."""
    grey = image.mean(axis=2).astype(np.float32)
    size_px = FINE_PX * image.shape[0] / 240.0
    level = cv2.GaussianBlur(grey, (0, 0), size_px)
    fine = grey - level
    fine[level < 0.1 * level.max()] = 0.0
    return np.asarray(fine / np.maximum(level, 1.0), dtype=np.float32)
