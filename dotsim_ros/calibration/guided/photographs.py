# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A folder of photographs of a ball: which is idle, and where the ball touches in the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dotsim_ros.data.contact_circle import BallPress, find_contact_circles, one_contact
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.files import read_image

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
IDLE_STEM = "idle"
LEAST_PRESSES = 13
"""Ten to fit on, and every fourth to judge on."""
SEARCH_WIDTH_PX = 160


@dataclass(frozen=True)
class GuidedPhotographs:
    """What a folder holds.

    Attributes:
        idle_name: of the photograph without contact.
        idle_was_named: whether its name said so.
        idle: (H, W, 3) that photograph.
        presses: of one ball each, sorted by name, with the circles found.
        left_out: why a photograph is not among them, by its name.
    """

    idle_name: str
    idle_was_named: bool
    idle: ImageArray
    presses: tuple[BallPress, ...]
    left_out: Mapping[str, str]


def read_guided_photographs(folder: Path) -> GuidedPhotographs:
    """Return the photographs of a folder, those that show no single ball left out with a reason.

    The idle photograph is the one called `idle`, or else the one with the least contrast between
    neighbouring places. Files that are no images by their name are passed over.

    Raises:
        FileNotFoundError: no such folder.
        ValueError: fewer photographs that show one ball than it takes, with what was wrong with
            the others.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"no folder {folder}; expected one with photographs of a ball")
    left_out: dict[str, str] = {}
    photographs: dict[str, ImageArray] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in SUFFIXES:
            continue
        try:
            photographs[path.name] = read_image(path)
        except ValueError as error:
            left_out[path.name] = str(error)
    if len(photographs) <= LEAST_PRESSES:
        raise ValueError(
            f"{folder} holds {len(photographs)} photographs ({', '.join(SUFFIXES)}), expected one "
            f"without contact and {LEAST_PRESSES} of the ball or more, pressed at different places"
        )
    named = [name for name in photographs if Path(name).stem.lower() == IDLE_STEM]
    idle_name = named[0] if named else min(photographs, key=lambda n: _contrast(photographs[n]))
    idle = photographs.pop(idle_name)
    presses = []
    for name, image in photographs.items():
        try:
            presses.append(_press(folder / name, image, idle))
        except ValueError as error:
            left_out[name] = str(error)
    if len(presses) < LEAST_PRESSES:
        reasons = "".join(f"\n  {reason}" for reason in left_out.values())
        raise ValueError(
            f"{folder}: {len(presses)} photographs show one ball against {idle_name}, expected "
            f"{LEAST_PRESSES} or more; take others for those left out, or call the photograph "
            f"without contact {IDLE_STEM}.png:{reasons}"
        )
    return GuidedPhotographs(idle_name, bool(named), idle, tuple(presses), left_out)


def _press(path: Path, image: ImageArray, idle: ImageArray) -> BallPress:
    if image.shape != idle.shape:
        raise ValueError(
            f"{path} is {image.shape[1]}x{image.shape[0]}, expected {idle.shape[1]}x"
            f"{idle.shape[0]} as the idle photograph; take all with one resolution and crop"
        )
    circle = one_contact(path, find_contact_circles(image, idle))
    height, width = idle.shape[:2]
    if circle.leaves(width, height):
        raise ValueError(
            f"{path}: the ball is at the frame's edge, its circle of {circle.radius_px:.0f} pixels "
            "leaves the frame; press nearer the middle"
        )
    return BallPress(path.name, circle.centre_px, circle.radius_px, image)


def _contrast(image: ImageArray) -> float:
    """Return how much the colour differs between places next to each other, where it does most."""
    scale = min(1.0, SEARCH_WIDTH_PX / image.shape[1])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), 2.0)
    along = [cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)]
    # A hundredth of the image is a ball's; a scratch or a rim is less.
    return float(np.percentile(np.sqrt(sum(np.sum(each**2, axis=-1) for each in along)), 98.0))
