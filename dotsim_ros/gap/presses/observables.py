# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What of a trajectory is compared: forces, and the skin's displacement over patches, with sign and
place, in axes of the contact.

Patches are sectors of rings around the contact at its deepest, so that the same number of an
observable means the same place of the contact in every trajectory. Axes: the skin's normal there,
the direction of the slide (or an arbitrary tangent where nothing slides), and the third.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.data.recording import STILL_M, Phase, Recording
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, IntArray

RING_M = (0.0, 1.0e-3, 2.0e-3, 3.0e-3, 4.5e-3, 6.5e-3, 10.0e-3, np.inf)
"""Edges of the rings, by the distance at rest from the contact's middle."""
SECTORS = (1, 4, 8, 8, 8, 8, 4)
REGIONS = ("apex", "contact", "contact", "rim", "rim", "far", "base")
"""What each ring is called in a report."""

FAR_SHARE = 0.9
"""A pose of a slide is far out from this share of the farthest one's distance on."""

PATCH_COUNT = sum(SECTORS)
SIZE = 3 * PATCH_COUNT + 3
"""Observables of a frame: the patches' displacements (m), then the force (N)."""
CHANNELS = {"skin": slice(0, 3 * PATCH_COUNT), "force": slice(3 * PATCH_COUNT, SIZE)}


@dataclass(frozen=True)
class Places:
    """Where a trajectory's observables are.

    Attributes:
        axes: (3, 3) rows: normal, along, across, in the base frame.
        patch: (V,) number of each vertex's patch; -1 for those on the base.
        count: (PATCH_COUNT,) vertices of each; 0 where a patch lies beyond the skin.
    """

    axes: FloatArray
    patch: IntArray
    count: IntArray


def ring_of_patch() -> IntArray:
    """Return (PATCH_COUNT,) the ring of each patch."""
    return np.repeat(np.arange(len(SECTORS)), SECTORS)


def regions_of_observables() -> list[str]:
    """Return (SIZE,) the region of each observable of a frame; "load" for forces."""
    rings = np.repeat(ring_of_patch(), 3)
    return [REGIONS[ring] for ring in rings] + ["load"] * 3


def places_of(recording: Recording, skin: SkinMesh) -> Places:
    """Return where the observables of a trajectory are, from its poses alone."""
    poses = recording.press.poses
    rest = skin.rest_position_m
    deepest = int(np.argmax(recording.depth_m))
    slides = [k for k, phase in enumerate(recording.phase) if phase is Phase.SLIDE]
    middle_frame = slides[0] - 1 if slides and slides[0] > 0 else deepest
    tip = poses[middle_frame].position_m
    normal = poses[middle_frame].rotation()[:, 2]
    # The tip is in the gel: the contact's middle is above it, where its axis leaves the skin.
    outward = rest - tip
    along_axis = outward @ normal
    off_axis = np.linalg.norm(outward - along_axis[:, None] * normal, axis=1)
    off_axis[along_axis < 0.0] = np.inf
    centre = rest[int(np.argmin(off_axis))]
    along = _slide_direction(np.array([poses[k].position_m - tip for k in slides]), normal)
    axes = np.stack([normal, along, np.cross(normal, along)])
    offset = rest - centre
    distance = np.linalg.norm(offset, axis=1)
    ring = np.searchsorted(RING_M, distance, side="right") - 1
    angle = np.arctan2(offset @ axes[2], offset @ axes[1]) % (2.0 * np.pi)
    sectors = np.asarray(SECTORS)[ring]
    # Centred on the axes, so that what is ahead of a slide is one sector.
    sector = np.floor(angle / (2.0 * np.pi) * sectors + 0.5).astype(int) % sectors
    patch = np.concatenate([[0], np.cumsum(SECTORS)])[ring] + sector
    patch[skin.on_base] = -1
    count = np.bincount(patch[patch >= 0], minlength=PATCH_COUNT)
    return Places(axes, patch.astype(np.int64), count.astype(np.int64))


def _slide_direction(moved_m: FloatArray, normal: FloatArray) -> FloatArray:
    """Return the unit vector (3,) across the normal that a slide leads along; any across it where
    nothing slides.

    Args:
        moved_m: (S, 3) from the contact's middle to each pose of the slide; may be empty.
        normal: (3,) unit vector.
    """
    across = moved_m.reshape(-1, 3)
    across = across - np.outer(across @ normal, normal)
    distance = np.linalg.norm(across, axis=1)
    if len(distance) and distance.max() > STILL_M:
        # A slide there and back ends where it began: the last pose that is far out leads.
        far = np.flatnonzero(distance >= FAR_SHARE * distance.max())[-1]
        return across[far] / distance[far]
    any_way = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    any_way -= (any_way @ normal) * normal
    return any_way / np.linalg.norm(any_way)


def observe(
    places: Places,
    rest_m: FloatArray,
    skin_m: FloatArray | None,
    force_n: FloatArray | None,
    frame_count: int,
) -> FloatArray:
    """Return (F, SIZE) observables; NaN where there is no patch or a channel is missing.

    Args:
        places: of the trajectory.
        rest_m: (V, 3) the skin at rest, base frame.
        skin_m: (F, V, 3), base frame.
        force_n: (F, 3), base frame.
        frame_count: F.
    """
    result = np.full((frame_count, SIZE), np.nan)
    if skin_m is not None:
        inside = places.patch >= 0
        weight = np.zeros((PATCH_COUNT, int(inside.sum())))
        weight[places.patch[inside], np.arange(weight.shape[1])] = 1.0
        with np.errstate(invalid="ignore", divide="ignore"):
            weight /= places.count[:, None]
        displacement = (skin_m - rest_m)[:, inside] @ places.axes.T
        result[:, : 3 * PATCH_COUNT] = (weight @ displacement).reshape(frame_count, -1)
    if force_n is not None:
        result[:, 3 * PATCH_COUNT :] = force_n @ places.axes.T
    return result
