# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the pixels of measured frames show: where they lie, how the skin is tilted, what changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.io.arrays import BoolArray, Float32Array, ImageArray
from dotsim_ros.twin.footage import OpticalPress, Rest

FULL_SCALE = 255.0
TOWARDS_CAMERA = np.array([0.0, 0.0, -1.0], dtype=np.float32)


Ground = Callable[[OpticalPress, Rest], ImageArray]
"""Gives the images (F, H, W, 3) of a press that a model's change of the colour is added to."""


def idle_ground(press: OpticalPress, rest: Rest) -> ImageArray:
    """Return the idle image for every frame, as the published simulators take it."""
    return np.broadcast_to(rest.idle, press.measured.shape)


def warped_ground(press: OpticalPress, _rest: Rest) -> ImageArray:
    """Return the idle image warped by the skin and shaded to first order, for every frame."""
    return press.warped


def check_frames(train: Sequence[OpticalPress]) -> None:
    """Refuse to fit on nothing.

    Raises:
        ValueError: no frame.
    """
    if not sum(len(press.measured) for press in train):
        raise ValueError("no frame to fit on; a model of images takes one at least")


def seen_region(rest: Rest) -> BoolArray:
    """Return (H, W) where the lit gel is seen at rest: pixels that a model may change."""
    return np.asarray(rest.lit & np.isfinite(rest.depth_m))


def pixel_positions(shape: tuple[int, int]) -> Float32Array:
    """Return (H, W, 2) positions of the pixels, x then y, -1 to 1 over the longer side."""
    height, width = shape
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    centre = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
    position = (np.stack([x, y], axis=-1) - centre) / (0.5 * max(width, height))
    return np.asarray(position, dtype=np.float32)


def filled_normal(normal: Float32Array, rest_normal: Float32Array) -> Float32Array:
    """Return normals (..., 3), those at rest where no skin is seen."""
    return np.where(np.isfinite(normal), normal, rest_normal)


def relative_normal(normal: Float32Array, rest_normal: Float32Array) -> Float32Array:
    """Return normals (..., 3) turned by the rotation that takes those at rest the shortest way to
    the optical frame's -z: a skin at rest is then as flat as a flat gel's.

    Args:
        normal: (..., 3) unit normals.
        rest_normal: (..., 3) unit normals at rest, none along +z.
    """
    # Rodrigues' formula for the rotation between two unit vectors a and b:
    # R v = v + w x v + w x (w x v) / (1 + a.b) with w = a x b.
    axis = np.cross(rest_normal, TOWARDS_CAMERA)
    cosine = rest_normal @ TOWARDS_CAMERA
    once = np.cross(axis, normal)
    twice = np.cross(axis, once) / (1.0 + cosine)[..., None]
    return np.asarray(normal + once + twice, dtype=np.float32)


@dataclass(frozen=True)
class PixelSamples:
    """N pixels of measured frames.

    Attributes:
        position: (N, 2) as `pixel_positions`.
        normal: (N, 3) in the optical frame.
        relative: (N, 3) as `relative_normal`.
        change: (N, 3) colour measured less that of the ground, full scale 1.
    """

    position: Float32Array
    normal: Float32Array
    relative: Float32Array
    change: Float32Array


@dataclass(frozen=True)
class PixelGrid:
    """The seen pixels of one camera, N of them.

    Attributes:
        seen: (H, W) which.
        position: (N, 2) as `pixel_positions`.
        rest_normal: (N, 3) at rest.
    """

    seen: BoolArray
    position: Float32Array
    rest_normal: Float32Array

    def normals(self, normal: Float32Array) -> tuple[Float32Array, Float32Array]:
        """Return normals (H, W, 3) of one frame at the seen pixels (N, 3), and relative to rest."""
        turned = filled_normal(normal[self.seen], self.rest_normal)
        return turned, relative_normal(turned, self.rest_normal)

    def changed(self, ground: ImageArray, change: NDArray[np.floating]) -> ImageArray:
        """Return the image (H, W, 3) with colours (N, 3), full scale 1, added where it is seen."""
        image = ground.copy()
        level = ground[self.seen] + FULL_SCALE * change
        image[self.seen] = np.clip(np.rint(level), 0.0, FULL_SCALE).astype(np.uint8)
        return image


def pixel_grid(rest: Rest) -> PixelGrid:
    """Return the pixels that a model may change."""
    seen = seen_region(rest)
    return PixelGrid(seen, pixel_positions(seen.shape)[seen], rest.normal[seen])


def draw_pixels(
    train: Sequence[OpticalPress],
    rest: Rest,
    *,
    count: int,
    seed: int,
    ground: Ground = idle_ground,
) -> PixelSamples:
    """Return pixels drawn evenly from the seen region of all frames, at most all of them.

    Args:
        train: the frames.
        rest: of the gel untouched.
        count: how many pixels.
        seed: of the draw.
        ground: what the change is measured from.

    Raises:
        ValueError: no frame.
    """
    check_frames(train)
    grid = pixel_grid(rest)
    seen_count = len(grid.position)
    share = min(1.0, count / (sum(len(press.measured) for press in train) * seen_count))
    random = np.random.default_rng(seed)
    parts = []
    for press in train:
        frames = zip(press.normal, press.measured, ground(press, rest), strict=True)
        for normal, measured, below in frames:
            turned, relative = grid.normals(normal)
            change = (measured[grid.seen] - below[grid.seen].astype(np.float32)) / FULL_SCALE
            drawn = random.choice(seen_count, size=round(share * seen_count), replace=False)
            parts.append([a[drawn] for a in (grid.position, turned, relative, change)])
    return PixelSamples(*(np.concatenate(column) for column in zip(*parts, strict=True)))
