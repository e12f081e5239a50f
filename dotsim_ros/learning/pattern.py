# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The idle image with samples between its own, learned from presses.

An idle image shows each point of the skin at one place between the pixels. Warped by half a pixel,
a pattern whose edges are sharper than pixels has an error of interpolation; on images
of 320x240 that is more than their noise. Presses show the same points at many other places, so they
identify the samples between: those whose warped image fits the measured ones best, by least
squares. (Super-resolution from known motion; Elad and Feuer, "Restoration of a
single superresolution image from several blurred, noisy, and undersampled measured images", 1997.)
The samples at the idle image's own pixels lose noise in the same solve.

The solve begins with the mean of all that was seen of the gel untouched. A press begins off the
gel, so its first frames show what the idle images show, each with noise of its own; what idle
images taken together share (a path tracer's noise, the flicker of lights) they average out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import cg

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import BoolArray, Float32Array, FloatArray, ImageArray, IntArray
from dotsim_ros.optics.idle import lit_region
from dotsim_ros.optics.image import ImageRenderer, double_resolution
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.optics.renderer import SkinRenderer, View
from dotsim_ros.twin.footage import FilmedData, FilmedPress

UNMOVED_M = 1e-6
"""A gel no point of which has moved farther is untouched."""
PRIOR_WEIGHT = 0.7
"""Weight of a sample interpolated in the idle image, relative to one measured pixel."""
OUTLIER_LEVELS = 10.0
"""Differences above this many grey levels are errors of the motion and count ever less (Cauchy)."""
LEAST_GAIN = 0.2
"""Darker pixels do not identify the pattern."""
ROUNDS = 2
ITERATIONS = 60
TOLERANCE = 1e-4


def untouched_frames(press: FilmedPress, filmed: FilmedData) -> list[int]:
    """Return the frames of a press before its gel moved."""
    moved_m = np.abs(press.skin_position_m - filmed.skin.rest_position_m).max(axis=(1, 2))
    moving = np.flatnonzero(moved_m > UNMOVED_M)
    return list(range(int(moving[0]) if moving.size else len(moved_m)))


def refined_idle(filmed: FilmedData, presses: Sequence[str] | None = None) -> ImageArray:
    """Return the mean (H, W, 3) of the idle image and the untouched frames of presses.

    The idle image counts as one frame: idle images taken at once may share their noise.

    Args:
        filmed: what was measured.
        presses: names of those whose frames may be used, such as those trained on; None for all.
    """
    images = [filmed.idle]
    for press in filmed.presses:
        if presses is None or press.name in presses:
            images.extend(press.measured[frame] for frame in untouched_frames(press, filmed))
    return np.rint(np.mean(images, axis=0)).astype(np.uint8)


@dataclass(frozen=True)
class _Samples:
    """The equations of the N lit pixels of one frame for the samples.

    Attributes:
        first: (N,) number of the upper left of the four samples around where the pixel looks.
        weight: (N, 4) of upper left, upper right, lower left, lower right.
        value: (N, 3) measured, without shading and vignetting.
    """

    first: IntArray
    weight: FloatArray
    value: FloatArray


def with_learned_pattern(
    filmed: FilmedData,
    camera: Camera,
    *,
    lighting: Lighting,
    vignetting: Vignetting,
    presses: Sequence[str] | None = None,
) -> FilmedData:
    """Return the data by an idle image that presses refine, with samples between its pixels.

    Args:
        filmed: what was measured, by the idle image as it was taken.
        camera: at the images' resolution.
        lighting: the LEDs.
        vignetting: of the camera.
        presses: names of those to learn from, such as those trained on; None for all.
    """
    filmed = replace(filmed, idle=refined_idle(filmed, presses))
    learn_from = [p for p in filmed.presses if presses is None or p.name in presses]
    renderer = SkinRenderer(camera, filmed.skin)
    image = ImageRenderer(
        camera, filmed.skin, filmed.idle, lighting=lighting, vignetting=vignetting
    )
    brightness = vignetting.brightness(camera)
    lit = lit_region(filmed.idle)
    rest = renderer.render(filmed.skin.rest_position_m)
    shape = image.fine_pattern.shape
    given = image.fine_pattern.reshape(-1, 3).astype(np.float64)

    def samples() -> Iterator[_Samples]:
        # Made again in each round: all at once would take gigabytes.
        for press in learn_from:
            for position, measured in zip(press.skin_position_m, press.measured, strict=True):
                view = renderer.render(position)
                gain = image.vertex_gain(view)
                yield _samples_of(
                    view, rest, filmed.skin.triangles, gain, lit, brightness, measured
                )

    pattern = given
    for _ in range(ROUNDS):
        pattern = _solved(samples(), pattern, given, shape[1])
    fine = pattern.reshape(shape) * double_resolution(brightness)[..., None]
    fine_image = np.clip(np.rint(fine), 0.0, 255.0).astype(np.uint8)
    idle = np.where(lit[..., None], fine_image[::2, ::2], filmed.idle)
    return replace(filmed, idle=idle, fine=fine_image)


def _samples_of(
    view: View,
    rest: View,
    triangles: NDArray[np.int32],
    gain: Float32Array,
    lit: BoolArray,
    brightness: Float32Array,
    measured: ImageArray,
) -> _Samples:
    """Return the equations of one frame.

    Args:
        view: of its skin.
        rest: of the skin untouched.
        triangles: (T, 3) of the skin.
        gain: (V, 3) brightness of each vertex over that at rest.
        lit: (H, W) the lit disc.
        brightness: (H, W) that vignetting leaves.
        measured: (H, W, 3).
    """
    height, width = lit.shape
    seen = (view.triangle >= 0) & lit
    corners = triangles[view.triangle[seen]]
    share = view.barycentric[seen].astype(np.float64)
    share = np.column_stack([1.0 - share.sum(axis=1), share])
    back = rest.vertex_pixel - view.vertex_pixel
    y, x = np.nonzero(seen)
    looked_at = np.column_stack([x, y]) + np.einsum("nc,ncd->nd", share, back[corners])
    fine = np.clip(2.0 * looked_at, 0.0, [2.0 * (width - 1), 2.0 * (height - 1)])
    scale = np.einsum("nc,ncd->nd", share, gain[corners]) * brightness[seen][:, None]
    column = np.minimum(fine[:, 0].astype(np.int64), 2 * width - 3)
    row = np.minimum(fine[:, 1].astype(np.int64), 2 * height - 3)
    right, down = fine[:, 0] - column, fine[:, 1] - row
    weight = np.column_stack(
        [(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down]
    )
    bright = scale.min(axis=1) > LEAST_GAIN
    return _Samples(
        (row * (2 * width - 1) + column)[bright],
        weight[bright],
        measured[seen][bright] / scale[bright],
    )


def _solved(
    frames: Iterator[_Samples], pattern: FloatArray, given: FloatArray, width: int
) -> FloatArray:
    """Return the samples (S, 3) that meet the frames best.

    Args:
        frames: their equations.
        pattern: (S, 3) samples so far, which show outliers.
        given: (S, 3) samples before anything was measured.
        width: of a row of samples.
    """
    count = len(pattern)
    steps = np.array([0, 1, width, width + 1])
    known = np.zeros_like(pattern)
    # Samples that a pixel sees together lie a step apart: few diagonals hold the matrix.
    products: dict[int, FloatArray] = {}
    for frame in frames:
        index = frame.first[:, None] + steps
        difference = np.einsum("nc,ncd->nd", frame.weight, pattern[index]) - frame.value
        trust = 1.0 / (1.0 + np.mean(difference**2, axis=1) / OUTLIER_LEVELS**2)
        for i, step in enumerate(steps):
            weight = trust * frame.weight[:, i]
            for colour in range(3):
                known[:, colour] += np.bincount(
                    index[:, i], weight * frame.value[:, colour], minlength=count
                )
            for j, other in enumerate(steps):
                diagonal = products.setdefault(int(other - step), np.zeros(count))
                diagonal += np.bincount(index[:, j], weight * frame.weight[:, j], minlength=count)
    offsets = sorted(products)
    # A diagonal matrix stores each entry under its column.
    matrix = sparse.dia_array(
        (np.array([products[offset] for offset in offsets]), offsets), shape=(count, count)
    ).tocsr() + PRIOR_WEIGHT * sparse.eye_array(count, format="csr")
    solved = [
        cg(
            matrix,
            known[:, colour] + PRIOR_WEIGHT * given[:, colour],
            x0=pattern[:, colour],
            maxiter=ITERATIONS,
            rtol=TOLERANCE,
        )[0]
        for colour in range(3)
    ]
    return np.column_stack(solved)
