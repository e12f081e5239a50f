# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shear and its history: what a whole slide or unloading shows, and no frame of it alone.

They follow from the observables that an effect is judged by, so they give no verdict of their own:
they say what an effect does for a task that slides or pushes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.recording import Phase, Recording
from dotsim_ros.gap.findings import ShearGap
from dotsim_ros.gap.presses.evidence import Case, EvidenceTrajectory
from dotsim_ros.gap.presses.locate import Residuals
from dotsim_ros.gap.presses.observables import (
    PATCH_COUNT,
    SIZE,
    Places,
    regions_of_observables,
)
from dotsim_ros.io.arrays import FloatArray, IntArray

STICKING = 0.7
"""Up to this share of its largest, the shear force grows with the way: beyond, more and more of the
contact slips."""
STEP = 1e-3
"""Of a difference, in deviations."""
CONTACT_REGIONS = ("apex", "contact")
ALONG_FORCE = np.array([3 * PATCH_COUNT + 1])
CONTACT = 3 * np.flatnonzero(
    np.isin(regions_of_observables()[: 3 * PATCH_COUNT : 3], CONTACT_REGIONS)
)
INWARD, ALONG = CONTACT, CONTACT + 1


@dataclass(frozen=True)
class Quantity:
    """What a trajectory shows as a whole.

    Attributes:
        unit: of its value.
        of: maps a recording, its places and observables (F, SIZE) to it; NaN where it shows none.
        columns: of the observables, that it follows from.
    """

    unit: str
    of: Callable[[Recording, Places, FloatArray], float]
    columns: IntArray


def tangential_stiffness(recording: Recording, places: Places, seen: FloatArray) -> float:
    """Return the shear force (N) a way (m) of a slide until it slips; NaN without a frame of it."""
    way_m, shear_n = _slide(recording, places, seen)
    sticks = shear_n <= STICKING * np.max(shear_n, initial=0.0)
    if not sticks.any() or not np.all(way_m > 0.0):
        return float("nan")
    last = int(np.argmin(sticks)) if not sticks.all() else len(sticks)
    way_m, shear_n = way_m[:last], shear_n[:last]
    return float(way_m @ shear_n / (way_m @ way_m)) if last else float("nan")


def slip_onset_m(recording: Recording, places: Places, seen: FloatArray) -> float:
    """Return the way at which the line before slip meets the largest shear force, by which the
    contact slips as a whole; NaN where it sticks to the end."""
    way_m, shear_n = _slide(recording, places, seen)
    stiffness = tangential_stiffness(recording, places, seen)
    onset_m = float(np.max(shear_n, initial=0.0) / stiffness)
    return onset_m if np.isfinite(onset_m) and onset_m < way_m[-1] else float("nan")


def left_inward_m(recording: Recording, places: Places, seen: FloatArray) -> float:
    """Return how far inward the skin of the contact stays after it was let go."""
    return -_left(recording, seen[:, INWARD])


def left_along_m(recording: Recording, places: Places, seen: FloatArray) -> float:
    """Return how far along a slide the skin of the contact stays after it was let go; NaN without a
    slide."""
    return _left(recording, seen[:, ALONG]) if recording.has(Phase.SLIDE) else float("nan")


QUANTITIES = {
    "tangential stiffness before slip": Quantity("N/m", tangential_stiffness, ALONG_FORCE),
    "way to the onset of slip": Quantity("m", slip_onset_m, ALONG_FORCE),
    "left inward after unloading": Quantity("m", left_inward_m, INWARD),
    "left along the slide after unloading": Quantity("m", left_along_m, ALONG),
}


def shear_gaps(case: Case, residuals: Residuals, chosen: Sequence[int]) -> tuple[ShearGap, ...]:
    """Return the quantities that trajectories show, those first that are farthest off."""
    found = []
    for number in chosen:
        t = case.trajectories[number]
        simulated = [t.observed - left[number] for left in (residuals.before, residuals.after)]
        for name, quantity in QUANTITIES.items():
            measured, before, after = (
                quantity.of(t.recording, t.places, seen) for seen in (t.observed, *simulated)
            )
            if np.isfinite([measured, before, after]).all():
                deviation = _deviation(t, quantity, simulated[0])
                values = (measured, before, after, deviation)
                found.append(ShearGap(name, quantity.unit, t.recording.name, *values))
    return tuple(sorted(found, key=lambda gap: -abs(gap.measured - gap.before) / gap.deviation))


def _slide(recording: Recording, places: Places, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return way (m) and shear force (N), (S,) each, of the frames of the first slide, on its way
    out, from the frame before it; none where nothing slides."""
    slides = np.array([phase is Phase.SLIDE for phase in recording.phase])
    first = int(np.argmax(slides))
    if not slides.any() or first == 0:
        return np.zeros(0), np.zeros(0)
    ends = np.flatnonzero(~slides[first:])
    end = first + int(ends[0]) if len(ends) else len(slides)
    position = np.stack([p.position_m for p in recording.press.poses[first - 1 : end]])
    way_m = (position[1:] - position[0]) @ places.axes[1]
    way_m *= np.sign(way_m[0]) or 1.0
    out = int(np.argmax(way_m)) + 1
    force_n = seen[first - 1 : end, ALONG_FORCE[0]]
    shear_n = np.abs(force_n[1:] - force_n[0])
    return way_m[:out], shear_n[:out]


def _left(recording: Recording, seen: FloatArray) -> float:
    """Return how much larger observables (F, N) are after the last contact than before the first,
    averaged over frames and observables."""
    touched = np.flatnonzero(recording.depth_m > 0.0)
    if not len(touched):
        return float("nan")
    before, after = seen[: touched[0]], seen[touched[-1] + 1 :]
    if not (np.isfinite(before).any() and np.isfinite(after).any()):
        return float("nan")
    return float(np.nanmean(after) - np.nanmean(before))


def _deviation(t: EvidenceTrajectory, quantity: Quantity, seen: FloatArray) -> float:
    """Return the deviation that noise, the twin's own error and that of pose and clock give a
    quantity: to first order, from the covariance of the observables."""
    deviation = np.linalg.norm(t.whitening.root, axis=1)
    at = quantity.of(t.recording, t.places, seen)
    slope = np.zeros(t.whitening.size)
    for k, place in enumerate(np.flatnonzero(t.whitening.is_used).tolist()):
        if place % SIZE in quantity.columns:
            moved = seen.copy()
            moved.flat[place] += STEP * deviation[k]
            change = quantity.of(t.recording, t.places, moved) - at
            slope[k] = change / (STEP * deviation[k])
    return float(np.linalg.norm(t.whitening.root.T @ np.nan_to_num(slope)))
