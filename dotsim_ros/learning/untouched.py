# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A better idle image: the mean of all that was seen of the gel untouched.

A press begins off the gel, so its first frames show what the idle images show, each with noise of
its own; what idle images taken together share (the path tracer's noise of a synthetic sensor, the
flicker of lights) they average out. The warped image inherits what the idle image gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.twin.footage import FilmedData, FilmedPress

UNMOVED_M = 1e-6
"""A gel no point of which has moved farther is untouched."""


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


def with_refined_idle(filmed: FilmedData, presses: Sequence[str] | None = None) -> FilmedData:
    """Return the data with `refined_idle` as its idle image."""
    return replace(filmed, idle=refined_idle(filmed, presses))
