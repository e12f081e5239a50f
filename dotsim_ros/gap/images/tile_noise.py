# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How far tiles of measured images lie from the twin's where no effect is missing.

Two parts: the camera's noise, estimated from repeats, and the model's own error, estimated from
images of trajectories that nothing was fitted to and in which no effect is missing. The deviation
of an observable is that of its tile at rest, and grows with what the contact changes there: a model
errs where there is something to predict. Errors of one channel are partly white, partly shared by
neighbouring tiles and frames with a correlation that falls exponentially in both, so that many
frames of one trajectory do not count as independent. The three numbers of a channel are those of
greatest likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from dotsim_ros.gap.images.tiles import COLOURS, NAMES, SHIFTS
from dotsim_ros.io.arrays import FloatArray

TILE_PRIOR_FRAMES = 20.0
"""Weight, in frames, of all tiles' deviation in that of one."""
LEAST_SHARE = 0.2
"""No tile's deviation is below so much of that of all."""


@dataclass(frozen=True)
class Correlation:
    """Correlation of the errors of one channel.

    Attributes:
        white: share of the variance that nothing shares.
        frames: over which the rest falls to 1/e.
        length_px: over which it falls to 1/e.
    """

    white: float
    frames: float
    length_px: float

    def modes(
        self, frame_count: int, distance_px: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what whitens F frames of T tiles: (F, F) and (T, T) orthogonal columns, and (F, T)
        the variances along them."""
        lag = np.abs(np.subtract.outer(np.arange(frame_count), np.arange(frame_count)))
        in_time, over_time = np.linalg.eigh(np.exp(-lag / self.frames))
        in_space, over_space = np.linalg.eigh(np.exp(-distance_px / self.length_px))
        shared = np.maximum(np.outer(in_time, in_space), 0.0)
        return over_time, over_space, self.white + (1.0 - self.white) * shared


@dataclass(frozen=True)
class TileNoise:
    """Covariance of the observables (F, T, 6) of one trajectory; trajectories are independent.

    Attributes:
        centre_px: (T, 2) of the tiles.
        camera: (T, 6) deviation by the camera's noise.
        model: (T, 6) deviation by the model's error where nothing is pressed.
        growth: (6,) deviation by the model's error, over what the contact changes.
        mixing: (6, 6) symmetric; turns deviations into channels that are not correlated.
        correlations: of those channels.
        trajectory_count: how many trajectories it was estimated from.
    """

    centre_px: FloatArray
    camera: FloatArray
    model: FloatArray
    growth: FloatArray
    mixing: FloatArray
    correlations: tuple[Correlation, ...]
    trajectory_count: int

    def deviation(self, change: FloatArray) -> FloatArray:
        """Return (F, T, 6) the deviation of each observable.

        Args:
            change: (F, T, 6) `contact_change` of the prediction.
        """
        growing = (change * self.growth) ** 2
        return np.sqrt(self.camera**2 + self.model**2 + growing)

    def whiten(self, values: FloatArray, change: FloatArray) -> FloatArray:
        """Return (F * T * 6, P) with unit covariance where values have this one.

        Args:
            values: (F, T, 6, P) P sets of observables of one trajectory.
            change: (F, T, 6) `contact_change` of its prediction.
        """
        scaled = values / self.deviation(change)[..., None]
        mixed = np.einsum("kc,ftcp->ftkp", self.mixing, scaled)
        distance = _distance_px(self.centre_px)
        for channel, correlation in enumerate(self.correlations):
            over_time, over_space, variance = correlation.modes(len(values), distance)
            along = np.einsum("fa,tb,ftp->abp", over_time, over_space, mixed[:, :, channel])
            mixed[:, :, channel] = along / np.sqrt(variance)[..., None]
        return np.asarray(mixed.reshape(-1, values.shape[-1]))


def contact_change(change: FloatArray) -> FloatArray:
    """Return (F, T, 6) how much a contact changes what there is to predict for each observable.

    For colours and sharpness, the root mean square of the change of the three colours; for the
    shifts, that of the two shifts.

    Args:
        change: (F, T, 6) observables of predicted images against the idle frame.
    """
    result = np.empty_like(change)
    result[..., : SHIFTS.start] = _rms(change[..., COLOURS])
    result[..., SHIFTS] = _rms(change[..., SHIFTS])
    return result


def _rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=-1, keepdims=True)))


def estimate_noise(
    residuals: Sequence[FloatArray],
    changes: Sequence[FloatArray],
    camera: FloatArray,
    centre_px: FloatArray,
) -> TileNoise:
    """Return the noise of tiles, from trajectories in which no effect is missing.

    Args:
        residuals: (F, T, 6) of each trajectory, measured against predicted, that the model was not
            fitted to; of several.
        changes: (F, T, 6) of each, `contact_change`.
        camera: (T, 6) deviation by the camera's noise.
        centre_px: (T, 2) of the tiles.
    """
    total, growth = _variances(np.concatenate(residuals), np.concatenate(changes))
    model = np.sqrt(np.maximum(total - camera**2, 0.0))
    identity = tuple(Correlation(1.0, 1.0, 1.0) for _ in NAMES)
    plain = TileNoise(
        centre_px, camera, model, growth, np.eye(len(NAMES)), identity, len(residuals)
    )
    scaled = [r / plain.deviation(c) for r, c in zip(residuals, changes, strict=True)]
    every = np.concatenate(scaled).reshape(-1, len(NAMES))
    value, vector = np.linalg.eigh(every.T @ every / len(every))
    mixing = (vector / np.sqrt(value)) @ vector.T
    mixed = [one @ mixing for one in scaled]
    distance = _distance_px(centre_px)
    correlations = tuple(
        _correlation([one[..., channel] for one in mixed], distance)
        for channel in range(len(NAMES))
    )
    return TileNoise(centre_px, camera, model, growth, mixing, correlations, len(residuals))


def _distance_px(centre_px: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(centre_px[:, None] - centre_px[None], axis=2))


def _variances(residual: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (T, 6) variance at rest, and (6,) the growth of the deviation with the change.

    Fitted as residual^2 = variance + (growth change)^2 by least squares, weighted by what is
    expected, in turns.
    """
    square, power = residual**2, change**2
    pooled = np.maximum(square.mean(axis=(0, 1)), 1e-12)
    rest = np.broadcast_to(pooled, square.shape[1:]).copy()
    growth_square = np.zeros(len(pooled))
    frames = len(square)
    for _ in range(10):
        weight = 1.0 / (rest + growth_square * power) ** 2
        beyond = np.sum(weight * power * (square - rest), axis=(0, 1))
        scale = np.maximum(np.sum(weight * power**2, axis=(0, 1)), 1e-12)
        growth_square = np.maximum(beyond / scale, 0.0)
        weight = 1.0 / (rest + growth_square * power) ** 2
        left = np.sum(weight * (square - growth_square * power), axis=0)
        mass = np.sum(weight, axis=0)
        common = np.maximum(left.sum(axis=0) / mass.sum(axis=0), LEAST_SHARE**2 * pooled * 0.1)
        prior = TILE_PRIOR_FRAMES / frames * mass.mean(axis=0)
        rest = np.maximum((left + prior * common) / (mass + prior), LEAST_SHARE**2 * common)
    return rest, np.sqrt(growth_square)


def _correlation(values: Sequence[FloatArray], distance_px: FloatArray) -> Correlation:
    """Return the correlation of greatest likelihood of trajectories (F, T) of one channel."""
    widest = float(distance_px.max())

    def of(x: FloatArray) -> Correlation:
        white = 1.0 / (1.0 + np.exp(-x[0]))
        frames, share = np.exp(np.clip(x[1:], -3.0, 5.0))
        return Correlation(float(white), float(frames), float(share) * widest)

    def unlikeliness(x: FloatArray) -> float:
        correlation = of(x)
        total = 0.0
        modes = {len(v): correlation.modes(len(v), distance_px) for v in values}
        for one in values:
            over_time, over_space, variance = modes[len(one)]
            along = over_time.T @ one @ over_space
            total += float(np.sum(np.log(variance) + along**2 / variance))
        return 0.5 * total

    start = np.array([0.0, 1.0, -1.5])
    found = minimize(
        unlikeliness,
        start,
        method="Nelder-Mead",
        bounds=[(-6.0, 6.0), (-3.0, 5.0), (-3.0, 2.0)],
        # Steps of a size that matters: the default's vanish about zero.
        options={
            "xatol": 0.02,
            "fatol": 0.05,
            "initial_simplex": np.vstack([start, start + np.eye(3)]),
        },
    )
    return of(found.x)
