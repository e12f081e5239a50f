# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How far apart simulation and measurement are where no effect is missing: noise, and a discrepancy
of the model and of the measurement that belongs to a place of the contact.

The discrepancy of frame f of a trajectory is a_f (b + w_f): b is drawn once for it, w_f changes
as the indenter moves, and a_f scales with the press: the skin by the depth, the force by the force.
Next to it every trajectory has an error of pose and of clock of its own. The covariances of b and w
come from residuals of presses in which nothing is missing (Kennedy and O'Hagan 2001 say why,
Brynjarsdottir and O'Hagan 2014 what happens without).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from dotsim_ros.data.recording import Recording
from dotsim_ros.gap.presses.observables import PATCH_COUNT, SECTORS, SIZE, Places, ring_of_patch
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import ArrayForm, Arrays, read_arrays
from dotsim_ros.io.files import parameter_path, whole_file

SMALLEST_DEPTH_M = 0.3e-3
"""The discrepancy of a shallower press is that of this depth: the skin's own roughness."""
SMALLEST_FORCE_N = 0.05
SHALLOW_M = 1.5e-3
"""A surface that is off by d changes the force, which grows with the depth's power of 3/2 (Hertz),
by the share 3/2 d / depth: the force's discrepancy is this share larger."""
JUDGED_DEPTH_M = 0.5e-3
"""Shallower frames do not identify the discrepancy."""
SHRINKAGE = 0.3
"""Share of the diagonal, averaged over a ring, that a covariance from few presses is drawn to."""
WAY_SHARE = 0.2
"""w is alike in frames between which the indenter goes less than this share of the largest depth:
of 0, 0.2, 0.5 and 1 the one that half of the stand-in sensor's presses make most probable for the
other half."""
SKIN_FROM_M = 1.0e-3
"""The skin of a shallower contact is not used: a dent of a few of the skin's points shows their
discretisation, which looks like an error of depth."""
SKIN_DOUBT = 2.0
"""The skin's discrepancy is taken as so much larger: a covariance from few presses misses shapes
that neighbouring points share, and effects have such shapes."""
FILE = "gap/discrepancy.npz"


@dataclass(frozen=True)
class ChannelNoise:
    """White noise of the measurement, one standard deviation.

    Attributes:
        skin_m: of a skin point, an axis.
        force_n: of the force, an axis.
        source: where the figures come from, for the report.
    """

    skin_m: float = 0.04e-3
    force_n: float = 0.015
    source: str = "declared"


@dataclass(frozen=True)
class Discrepancy:
    """Covariances of b and w, dimensionless.

    Attributes:
        between: (SIZE, SIZE) of b.
        within: (SIZE, SIZE) of w.
        source: the presses that they come from.
        bias: by nuisance, the mean of what the twin is off by (see `assumptions.BIASED`).
        limit_factors: by effect, how much more it gains on true data without any effect than on
            simulated ones.
        pattern_factor: the same of what all patterns gain together.
        misfit_limit: largest objective of an observable (see `inference.Fit`) that the twin,
            recalibrated, leaves of true data without any effect; 0 is that of the covariance.
        is_representative: whether the presses show how the units differ that are searched: those
            of one unit, or on one mesh of a solver, do not.
    """

    between: FloatArray
    within: FloatArray
    source: str
    bias: Mapping[str, float] = field(default_factory=dict)
    limit_factors: Mapping[str, float] = field(default_factory=dict)
    pattern_factor: float = 0.0
    misfit_limit: float = 0.0
    is_representative: bool = False


def amplitude(recording: Recording, force_n: FloatArray | None) -> FloatArray:
    """Return (F, SIZE) a_f: metres for the skin, newtons for the force.

    Args:
        recording: whose depths are taken.
        force_n: (F, 3) measured; None where it was not.
    """
    depth = np.maximum(recording.depth_m, SMALLEST_DEPTH_M)
    result = np.empty((len(depth), SIZE))
    result[:, : 3 * PATCH_COUNT] = depth[:, None]
    size = np.zeros(len(depth)) if force_n is None else np.linalg.norm(force_n, axis=1)
    size = np.maximum(size, SMALLEST_FORCE_N) * (1.0 + SHALLOW_M / depth)
    result[:, 3 * PATCH_COUNT :] = size[:, None]
    return result


def noise_from_idle(
    recordings: Sequence[Recording], rest_m: FloatArray, declared: ChannelNoise
) -> ChannelNoise:
    """Return the noise that frames without contact show; the declared one where there are none."""
    skin, force = [], []
    for recording in recordings:
        press = recording.press
        for frame in np.flatnonzero(recording.depth_m < 0.0):
            if press.skin_position_m is not None:
                skin.append((press.skin_position_m[frame] - rest_m).ravel())
            if press.force_n is not None:
                force.append(press.force_n[frame])
    if len(skin) < 2 and len(force) < 6:
        return declared
    return ChannelNoise(
        float(np.std(np.concatenate(skin))) if len(skin) >= 2 else declared.skin_m,
        # About each axis's own mean: a bias of the gauge is no noise.
        float(np.sqrt(np.mean(np.var(force, axis=0)))) if len(force) >= 6 else declared.force_n,
        f"{max(len(skin), len(force))} frames without contact",
    )


def fit_discrepancy(
    recordings: Sequence[Recording], residuals: Sequence[FloatArray], source: str
) -> Discrepancy:
    """Return the covariances that residuals of presses without any effect have.

    Args:
        recordings: R presses.
        residuals: of each (F, SIZE), NaN where nothing was observed.
        source: what the presses are, in words.

    Raises:
        ValueError: none of them is deep enough.
    """
    between = np.zeros((SIZE, SIZE))
    within = np.zeros((SIZE, SIZE))
    frames = used = 0
    for recording, residual in zip(recordings, residuals, strict=True):
        judged = recording.depth_m > JUDGED_DEPTH_M
        if not judged.any():
            continue
        used += 1
        scaled = np.nan_to_num(residual / amplitude(recording, recording.press.force_n))[judged]
        for turned in _symmetric(scaled):
            mean = turned.mean(axis=0)
            between += np.outer(mean, mean)
            within += (turned - mean).T @ (turned - mean)
        frames += max(1, int(judged.sum()) - 1)
    if not used:
        raise ValueError(
            f"no frame of {source} is deeper than {1e3 * JUDGED_DEPTH_M:g} mm, so they do not tell "
            "how far model and measurement are apart; record presses"
        )
    count = 2 * used
    return Discrepancy(_shrunk(between / count), _shrunk(within / (2 * frames)), source)


def _symmetric(scaled: FloatArray) -> list[FloatArray]:
    """Return residuals (F, SIZE) as they are, and mirrored along the slide."""
    mirrored = scaled.copy()
    start = 0
    for sectors in SECTORS:
        order = (-np.arange(sectors)) % sectors
        block = scaled[:, 3 * start : 3 * (start + sectors)].reshape(-1, sectors, 3)
        mirrored[:, 3 * start : 3 * (start + sectors)] = block[:, order].reshape(len(scaled), -1)
        start += sectors
    mirrored[:, 2::3] *= -1.0
    return [scaled, mirrored]


def _shrunk(covariance: FloatArray) -> FloatArray:
    """Return a covariance drawn to its diagonal, the latter averaged over rings and components."""
    diagonal = np.diag(covariance).copy()
    rings = ring_of_patch()
    for ring in range(len(SECTORS)):
        for component in range(3):
            members = 3 * np.flatnonzero(rings == ring) + component
            diagonal[members] = diagonal[members].mean()
    # Across the slide, or to the other side, is the same where nothing slides.
    return (1.0 - SHRINKAGE) * covariance + SHRINKAGE * np.diag(diagonal)


def save_discrepancy(discrepancy: Discrepancy, path: Path) -> None:
    """Write covariances as single precision, whole or not at all."""
    with whole_file(path) as part:
        np.savez_compressed(
            part,
            between=discrepancy.between.astype(np.float32),
            within=discrepancy.within.astype(np.float32),
            source=np.array(discrepancy.source),
            biased=np.array(list(discrepancy.bias), dtype=str),
            bias=np.array(list(discrepancy.bias.values())),
            limited=np.array(list(discrepancy.limit_factors), dtype=str),
            limit_factor=np.array(list(discrepancy.limit_factors.values())),
            pattern_factor=np.array(discrepancy.pattern_factor),
            misfit_limit=np.array(discrepancy.misfit_limit),
            representative=np.array(discrepancy.is_representative),
        )


def load_discrepancy(path: str | Path | None = None) -> Discrepancy:
    """Return covariances from a file; None: the shipped ones.

    Raises:
        FileNotFoundError: no such file.
        ValueError: covariances of other observables.
    """
    path = parameter_path(FILE) if path is None else Path(path)
    arrays = read_arrays(path, _FORMS)
    found = Discrepancy(
        arrays["between"].astype(np.float64),
        arrays["within"].astype(np.float64),
        str(arrays["source"]),
        _paired(path, arrays, "biased", "bias"),
        _paired(path, arrays, "limited", "limit_factor"),
        float(arrays["pattern_factor"]),
        float(arrays["misfit_limit"]),
        bool(arrays["representative"]),
    )
    if not found.between.shape == found.within.shape == (SIZE, SIZE):
        raise ValueError(
            f"{path} holds covariances of shapes {found.between.shape} and {found.within.shape}, "
            f"expected ({SIZE}, {SIZE}); make them again with "
            "python -m studies gap_discrepancy"
        )
    return found


_FORMS = {
    "between": ArrayForm((None, None)),
    "within": ArrayForm((None, None)),
    "source": ArrayForm((), "text"),
    "biased": ArrayForm((None,), "text"),
    "bias": ArrayForm((None,)),
    "limited": ArrayForm((None,), "text"),
    "limit_factor": ArrayForm((None,)),
    "pattern_factor": ArrayForm(()),
    "misfit_limit": ArrayForm(()),
    "representative": ArrayForm((), "truth value"),
}


def _paired(path: Path, arrays: Arrays, names: str, values: str) -> dict[str, float]:
    if len(arrays[names]) != len(arrays[values]):
        raise ValueError(
            f"{path}: {names} has {len(arrays[names])} entries and {values} {len(arrays[values])}, "
            "expected as many"
        )
    return dict(zip(arrays[names].tolist(), arrays[values].tolist(), strict=True))


def white_variance(noise: ChannelNoise, places: Places) -> FloatArray:
    """Return (SIZE,) the variance of each observable of a frame by white noise alone."""
    variance = np.full(SIZE, noise.force_n**2)
    points = np.maximum(np.repeat(places.count, 3), 1)
    variance[: 3 * PATCH_COUNT] = noise.skin_m**2 / points
    return variance


@dataclass(frozen=True)
class Whitening:
    """Turns a trajectory's observables into numbers of unit variance where no effect is missing.

    Attributes:
        is_used: (F, SIZE) which observables there are.
        root: lower Cholesky root of their covariance.
    """

    is_used: NDArray[np.bool_]
    root: FloatArray

    @property
    def size(self) -> int:
        """Number of observables."""
        return len(self.root)

    def whiten(self, observables: FloatArray) -> FloatArray:
        """Return (size,) of observables (F, SIZE)."""
        chosen = observables[self.is_used]
        result: FloatArray = linalg.solve_triangular(
            self.root, chosen, lower=True, check_finite=False
        )
        return result


def usable(recording: Recording, observed: FloatArray) -> FloatArray:
    """Return observables (F, SIZE), NaN where the skin is hardly touched."""
    shallow = (recording.depth_m > 0.0) & (recording.depth_m < SKIN_FROM_M)
    result = observed.copy()
    result[shallow, : 3 * PATCH_COUNT] = np.nan
    return result


def whitening_of(
    recording: Recording,
    places: Places,
    observed: FloatArray,
    *,
    noise: ChannelNoise,
    discrepancy: Discrepancy,
    own: FloatArray,
) -> Whitening:
    """Return the whitening of a trajectory.

    Args:
        recording: the trajectory.
        places: of its observables.
        observed: (F, SIZE) measured; NaN is not used.
        noise, discrepancy: of the measurement and of the model.
        own: (K, F, SIZE) what one deviation of each error of its own does: pose and clock.
    """
    scale = amplitude(recording, recording.press.force_n)
    scale[:, : 3 * PATCH_COUNT] *= SKIN_DOUBT
    used = np.isfinite(observed)
    flat = np.flatnonzero(used)
    frame, number = flat // SIZE, flat % SIZE
    position = np.stack([pose.position_m for pose in recording.press.poses])
    way = np.cumsum(np.linalg.norm(np.diff(position, axis=0, prepend=position[:1]), axis=1))
    reach = WAY_SHARE * max(float(recording.depth_m.max()), SMALLEST_DEPTH_M)
    alike = np.exp(-np.abs(way[:, None] - way[None, :]) / reach)
    covariance = discrepancy.between[np.ix_(number, number)]
    covariance += alike[np.ix_(frame, frame)] * discrepancy.within[np.ix_(number, number)]
    factor = scale.ravel()[flat]
    covariance *= factor[:, None] * factor[None, :]
    moved = own.reshape(len(own), -1)[:, flat]
    covariance += moved.T @ moved
    covariance[np.diag_indices(len(flat))] += white_variance(noise, places)[number]
    return Whitening(used, linalg.cholesky(covariance, lower=True, check_finite=False))
