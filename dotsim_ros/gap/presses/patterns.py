# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Patterns that a residual may have whatever its cause: by channel, phase and region.

They show how much of a residual any model could remove, and where it lies, when no effect of the
library explains it.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.data.recording import Phase, Recording
from dotsim_ros.gap.presses.covariance import amplitude
from dotsim_ros.gap.presses.observables import PATCH_COUNT, SIZE, regions_of_observables
from dotsim_ros.io.arrays import FloatArray

PLACES = (("load",), ("apex", "contact"), ("rim",), ("far",))
"""Regions that one pattern covers."""


LEANING = (("apex", "contact"), ("rim",), ("far",), ("base",))
"""Regions that may go with the sideways force, as far as the dome's base."""


def patterns(recording: Recording, predicted: FloatArray, axes: FloatArray) -> FloatArray:
    """Return (K, F, SIZE) patterns of a trajectory, each of about one percent of the press.

    Args:
        recording: the trajectory.
        predicted: (F, SIZE) observables of the twin, whose forces give the sign along a slide.
        axes: (3, 3) rows: of the observables, in the base frame.
    """
    force = predicted[:, 3 * PATCH_COUNT :]
    scale = 0.01 * amplitude(recording, force)
    region = np.array(regions_of_observables())
    axis = np.arange(SIZE) % 3
    result = []
    for phase in (Phase.LOAD, Phase.HOLD, Phase.SLIDE, Phase.RELEASE, Phase.IDLE):
        frames = np.array([p is phase for p in recording.phase], dtype=float)[:, None]
        # Along the normal and along the slide.
        for number in range(2):
            result += [
                frames * scale * (np.isin(region, place) & (axis == number)) for place in PLACES
            ]
    time = _time_of_hold(recording)[:, None]
    result.append(time * scale * ((region == "load") & (axis == 0)))
    result.append(time * scale * (np.isin(region, ("contact", "apex", "rim")) & (axis == 0)))
    depth = (recording.depth_m / max(float(recording.depth_m.max()), 1e-6))[:, None]
    result.append((depth - 0.5) * scale * ((region == "load") & (axis == 0)))
    sideways = _sideways(force, axes)
    result += [scale * np.isin(region, place) * sideways[:, axis] for place in LEANING]
    return np.stack(result)


def _sideways(force_n: FloatArray, axes: FloatArray) -> FloatArray:
    """Return (F, 3) the share of the force that is parallel to the base, with its direction, in the
    axes of the observables."""
    lateral = np.nan_to_num(force_n) @ axes * [1.0, 1.0, 0.0]
    size = np.linalg.norm(np.nan_to_num(force_n), axis=1, keepdims=True)
    return np.asarray(np.divide(lateral, size, out=np.zeros_like(lateral), where=size > 0) @ axes.T)


def _time_of_hold(recording: Recording) -> FloatArray:
    """Return (F,) from -1/2 to 1/2 over a hold, 0 elsewhere."""
    held = [k for k, phase in enumerate(recording.phase) if phase is Phase.HOLD]
    result = np.zeros(len(recording.phase))
    if len(held) > 1:
        stamp = recording.press.stamp_s[held]
        result[held] = (stamp - stamp[0]) / (stamp[-1] - stamp[0]) - 0.5
    return result
