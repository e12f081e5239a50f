# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The circle in which a ball touches a gel, found in a photograph.

A ball changes the gel's colour by its slope, which is steepest where contact ends and falls
off on both sides. So the difference from the idle photograph is a bright ring with a dimmer middle
and a fading outside: a disc that stands out of its surroundings says where, and the radius at which
the mean difference around it is largest says how wide. What the camera adds everywhere alike (its
white balance, its exposure) is taken off first, as the median of the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from dotsim_ros.io.arrays import BoolArray, Float32Array, FloatArray, ImageArray

SEARCH_WIDTH_PX = 160
"""Width of the image in which the place is searched."""
SMALLEST_SHARE, LARGEST_SHARE, RADIUS_COUNT = 0.03, 0.28, 14
"""Radii that are searched, over the image's shorter side."""
FINE_PX = 2.0
LEAST_CONTRAST = 8.0
"""Difference inside a contact over that around it, in deviations of the noise, and at least ..."""
LEAST_LEVELS = 4.0
"""... so many grey levels."""
SECOND_SHARE = 0.5
"""A second disc that stands out by this share of the first is a second contact."""
PROFILE_REACH = 1.9
"""The radius is looked for up to this multiple of the disc's."""
CONTACT_REACH = 1.5
"""Radius of the region around a contact in which models are judged, over the circle's."""


@dataclass(frozen=True)
class ContactCircle:
    """Where a ball touches: centre (2,), x then y from that of the first pixel; and radius."""

    centre_px: FloatArray
    radius_px: float

    def leaves(self, width: int, height: int) -> bool:
        """Return whether a part of the circle is outside the frame."""
        far = np.array([width - 1, height - 1]) - self.centre_px
        return bool(min(self.centre_px.min(), far.min()) < self.radius_px)


@dataclass(frozen=True)
class BallPress:
    """One photograph (H, W, 3) of the ball, by the name of its file, and its circle of contact."""

    name: str
    centre_px: FloatArray
    radius_px: float
    image: ImageArray

    def within(self, reach: float) -> BoolArray:
        """Return (H, W) the pixels within so many radii of the circle's centre."""
        height, width = self.image.shape[:2]
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        distance = np.hypot(x - self.centre_px[0], y - self.centre_px[1])
        return np.asarray(distance < reach * self.radius_px)

    def near_contact(self) -> BoolArray:
        """Return (H, W) the pixels within one and a half radii of the circle's centre."""
        return self.within(CONTACT_REACH)


def colour_difference(image: ImageArray, idle: ImageArray, blur_px: float) -> Float32Array:
    """Return (H, W) how far the colour is from the idle one's, grey levels, less what the whole
    frame has in common."""
    change = image.astype(np.float32) - idle.astype(np.float32)
    blurred = np.asarray(cv2.GaussianBlur(change, (0, 0), blur_px), dtype=np.float32)
    blurred -= np.median(blurred.reshape(-1, 3), axis=0)
    return np.asarray(np.linalg.norm(blurred, axis=-1), dtype=np.float32)


def find_contact_circles(image: ImageArray, idle: ImageArray) -> list[ContactCircle]:
    """Return the contacts in a photograph (H, W, 3), the clearest first; none where nothing
    touches.

    Raises:
        ValueError: the photograph without contact has another size.
    """
    if image.shape != idle.shape:
        raise ValueError(
            f"the photograph has shape {image.shape}, expected that of the idle one, {idle.shape}; "
            "take all with the same crop and resolution"
        )
    width = idle.shape[1]
    scale = min(1.0, SEARCH_WIDTH_PX / width)
    difference = colour_difference(image, idle, max(1.0, width / SEARCH_WIDTH_PX))
    small: Float32Array = np.asarray(
        cv2.resize(difference, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA),
        dtype=np.float32,
    )
    # Of the fine texture: the light of a contact fills half of some frames.
    fine = small - cv2.GaussianBlur(small, (0, 0), FINE_PX)
    noise = 1.4826 * float(np.median(np.abs(fine)))
    found: list[ContactCircle] = []
    contrasts, radii = _contrasts(small)
    strongest = 0.0
    while len(found) < 3:
        best = np.unravel_index(int(contrasts.argmax()), contrasts.shape)
        strength, radius = float(contrasts[best]), float(radii[best[0]])
        strongest = max(strongest, strength)
        if strength < max(LEAST_LEVELS, LEAST_CONTRAST * noise, SECOND_SHARE * strongest):
            break
        place = np.array([best[2], best[1]], dtype=np.float64)
        found.append(_refined(difference, (place + 0.5) / scale - 0.5, radius / scale))
        y, x = np.mgrid[: small.shape[0], : small.shape[1]]
        # The light of a contact reaches far around it: a second ball stands clear of the first.
        taken = np.hypot(x - place[0], y - place[1]) < 3.0 * radius
        contrasts[:, taken] = 0.0
    return found


def one_contact(path: Path, found: Sequence[ContactCircle]) -> ContactCircle:
    """Return the only contact of a photograph.

    Raises:
        ValueError: there is none, or a second one.
    """
    if not found:
        raise ValueError(
            f"{path} shows no ball: it differs from the idle photograph nowhere by a disc; leave "
            "it out, or press deeper"
        )
    if len(found) > 1:
        places = " and ".join(place_of(circle) for circle in found[:2])
        raise ValueError(
            f"{path} shows two contacts, at {places}; expected one ball alone: leave it out, or "
            "take it again"
        )
    return found[0]


def place_of(circle: ContactCircle) -> str:
    """Return the middle of a circle, for messages."""
    x, y = np.rint(circle.centre_px).astype(int)
    return f"pixel ({x}, {y})"


def _contrasts(small: Float32Array) -> tuple[Float32Array, FloatArray]:
    """Return (R, h, w) the mean in a disc less that around it, by radius, and the radii (R,)."""
    shorter = min(small.shape)
    radii = np.geomspace(SMALLEST_SHARE * shorter, LARGEST_SHARE * shorter, RADIUS_COUNT)
    contrasts = []
    for radius in radii:
        inside = _disc_mean(small, radius)
        outer, inner = 2.4 * radius, 1.6 * radius
        # The mean of an annulus from those of two discs.
        around = (outer**2 * _disc_mean(small, outer) - inner**2 * _disc_mean(small, inner)) / (
            outer**2 - inner**2
        )
        # Without the factor the brightest patch of a contact would stand for it.
        contrasts.append((inside - around) * (radius / shorter) ** 0.25)
    return np.stack(contrasts), radii


def _disc_mean(image: Float32Array, radius: float) -> Float32Array:
    reach = int(np.ceil(radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = np.clip(radius + 0.5 - np.hypot(x, y), 0.0, 1.0).astype(np.float32)
    mean = cv2.filter2D(image, cv2.CV_32F, disc / disc.sum(), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(mean, dtype=np.float32)


def _refined(difference: Float32Array, centre: FloatArray, radius: float) -> ContactCircle:
    """Return the circle whose rim is the brightest ring near a disc."""
    best_level, best = -np.inf, (centre, radius)
    # The place of the disc is good to a part of its radius.
    step = 0.15 * radius
    while step > 0.4:
        start = best[0]
        for dy in (-1.0, 0.0, 1.0):
            for dx in (-1.0, 0.0, 1.0):
                moved = start + step * np.array([dx, dy])
                level, rim = _brightest_ring(difference, moved, radius)
                if level > best_level:
                    best_level, best = level, (moved, rim)
        step *= 0.5
    return ContactCircle(*best)


def _brightest_ring(
    difference: Float32Array, centre: FloatArray, radius: float
) -> tuple[float, float]:
    """Return the largest mean on a ring around a centre, and that ring's radius."""
    reach = int(np.ceil(PROFILE_REACH * radius))
    middle = np.rint(centre).astype(int)
    height, width = difference.shape
    rows = slice(max(middle[1] - reach, 0), min(middle[1] + reach + 1, height))
    columns = slice(max(middle[0] - reach, 0), min(middle[0] + reach + 1, width))
    y, x = np.mgrid[rows, columns]
    distance = np.hypot(x - centre[0], y - centre[1])
    bins = max(int(PROFILE_REACH * radius / max(0.06 * radius, 1.0)), 4)
    ring = np.minimum((distance / (PROFILE_REACH * radius) * bins).astype(np.int64), bins)
    count = np.bincount(ring.ravel(), minlength=bins + 1)[:bins]
    total = np.bincount(ring.ravel(), difference[rows, columns].ravel(), bins + 1)[:bins]
    profile = total / np.maximum(count, 1)
    # Rings of which most lies outside the frame say little.
    whole = np.pi * (2.0 * np.arange(bins) + 1.0) * (PROFILE_REACH * radius / bins) ** 2
    profile[count < 0.4 * whole] = 0.0
    # Not the middle, which a bright part of the rim would make a ring of its own.
    first = max(bins // 4, 1)
    peak = first + int(profile[first:].argmax())
    return float(profile[peak]), (peak + 0.5) * PROFILE_REACH * radius / bins
