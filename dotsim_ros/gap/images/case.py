# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measured images next to the twin's: the residuals and films of a set of trajectories."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.recording import Phase, Recording
from dotsim_ros.effects.effect import Active, Effect
from dotsim_ros.gap.images.model import Film, TwinCamera, resized, resized_image
from dotsim_ros.gap.images.reading import MeasuredImages
from dotsim_ros.gap.images.tile_noise import contact_change
from dotsim_ros.gap.images.tiles import TileMeter, tile_grid
from dotsim_ros.io.arrays import FloatArray

IDLE = "idle"
"""Name of the trajectory that the idle images make: one frame, their mean, at the session's
start."""
WIDTH, HEIGHT = 320, 240
"""Pixels that tiles are compared at, whatever the camera has: shifts and noise are of that size."""


@dataclass(frozen=True)
class Shot:
    """A trajectory's images next to the twin's, at the size of the tiles.

    Attributes:
        name: of the trajectory.
        recording: its motion; None for `IDLE`.
        measured: (F, H, W, 3), 0 to 255.
        film: what the twin predicts.
        residual: (F, T, 6) observables of measured against predicted.
        change: (F, T, 6) `contact_change` of the prediction.
    """

    name: str
    recording: Recording | None
    measured: NDArray[np.generic]
    film: Film
    residual: FloatArray
    change: FloatArray

    def of_frames(self, frames: NDArray[np.integer]) -> Shot:
        """Return some of the frames."""
        return replace(
            self,
            measured=self.measured[frames],
            film=self.film.of_frames(frames),
            residual=self.residual[frames],
            change=self.change[frames],
        )


@dataclass(frozen=True)
class OpticalCase:
    """All images of a data set next to the twin's.

    Attributes:
        shots: `IDLE` first.
        meter: that compared them.
        camera: (T, 6) deviation by the camera's noise; NaN where there is a single idle image.
        solve_count: of the twin's skins.
        left_out: what could not be solved.
    """

    shots: tuple[Shot, ...]
    meter: TileMeter
    camera: FloatArray
    solve_count: int = 0
    left_out: tuple[str, ...] = ()

    def without_contact(self) -> OpticalCase:
        """Return the frames in which nothing touches the skin."""
        kept = []
        for shot in self.shots:
            if shot.recording is None:
                kept.append(shot)
                continue
            free = np.flatnonzero([phase is Phase.IDLE for phase in shot.recording.phase])
            if len(free):
                kept.append(shot.of_frames(free))
        return replace(self, shots=tuple(kept))

    def of(self, names: Sequence[str]) -> list[Shot]:
        """Return the shots of some names, in their own order."""
        return [shot for shot in self.shots if shot.name in names]

    def changed_by(self, shot: Shot, effects: Sequence[Active]) -> FloatArray:
        """Return (F, T, 6) what effects do to the observables of a shot."""
        return self.meter.difference(shot.film.with_effects(effects), shot.film.pixels)


def optical_case(
    images: MeasuredImages,
    model: TwinCamera,
    skins: Sequence[FloatArray | None],
    *,
    progress: Callable[[int, int], None] | None = None,
) -> OpticalCase:
    """Return measured images next to those of a model.

    Args:
        images: as measured.
        model: of the twin's images, at their size.
        skins: (F, V, 3) of the sensor's skin for each trajectory; one of None is left out.
        progress: called with the number of trajectories done, and of all.
    """
    # Loaded on use: it starts Warp.
    from dotsim_ros.optics.idle import lit_region

    rest = resized_image(model.idle.astype(np.float64), WIDTH, HEIGHT)
    meter = TileMeter(tile_grid(lit_region(np.rint(rest).astype(np.uint8))), rest)
    idles = np.stack([resized_image(one, WIDTH, HEIGHT) for one in images.idle_images])
    mean = idles.mean(axis=0, dtype=np.float64)[None]
    shots = [_shot(IDLE, None, mean, resized(model.idle_film(), WIDTH, HEIGHT), meter)]
    for number, (one, skin) in enumerate(zip(images.trajectories, skins, strict=True)):
        if skin is not None:
            recording = one.recording
            film = model.film(skin, recording.press.stamp_s, start_s=recording.session_s)
            measured = np.stack([resized_image(image, WIDTH, HEIGHT) for image in one.measured])
            film = resized(film, WIDTH, HEIGHT)
            shots.append(_shot(recording.name, recording, measured, film, meter))
        if progress is not None:
            progress(number + 1, len(skins))
    unknown = np.full((len(meter.grid), shots[0].residual.shape[-1]), np.nan)
    return OpticalCase(tuple(shots), meter, meter.noise(idles) if len(idles) > 1 else unknown)


def _shot(
    name: str,
    recording: Recording | None,
    measured: NDArray[np.generic],
    film: Film,
    meter: TileMeter,
) -> Shot:
    rest = np.broadcast_to(film.idle, film.pixels.shape)
    change = contact_change(meter.difference(film.pixels, rest))
    residual = meter.difference(measured, film.pixels)
    return Shot(name, recording, measured, film, residual, change)


def excited(effects: Sequence[Effect], shots: Sequence[Shot]) -> list[Effect]:
    """Return the effects that the trajectories of some shots excite."""
    recordings = [shot.recording for shot in shots if shot.recording is not None]
    return [e for e in effects if any(e.excited_by(recording) for recording in recordings)]
