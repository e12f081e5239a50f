# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What images show where nothing is missing: the file that thresholds of the images come from.

It holds the covariance of the tiles, the sizes that the model's own error gives each effect, and
how far whole trajectories exceed what the covariance predicts. It is made from images in which
nothing is wrong (`dotsim_ros find-gap --fit-optical-noise`); a file made with one sensor serves
another's images as a guess, each of whose tiles takes the deviations of the nearest one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree
from scipy.stats import t as student

from dotsim_ros.effects.effect import Effect
from dotsim_ros.gap.images.case import IDLE, OpticalCase, Shot
from dotsim_ros.gap.images.search import (
    OpticalSearch,
    Signature,
    camera_nuisances,
    freed,
    signatures_of,
)
from dotsim_ros.gap.images.tile_noise import Correlation, TileNoise, estimate_noise
from dotsim_ros.gap.images.tiles import TileMeter
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import Arrays, read_arrays
from dotsim_ros.io.files import parameter_path, whole_file

FILE = "gap/optical_noise.npz"
VERSION = 1


@dataclass(frozen=True)
class SpuriousSize:
    """How far an effect's sizes scatter where there is none.

    Attributes:
        effect: its name.
        shape: values of the parameters that have no direction, by name.
        step: of the first direction, with its sign.
        deviation: of each direction's parameter, by name.
    """

    effect: str
    shape: Mapping[str, float]
    step: float
    deviation: Mapping[str, float]


@dataclass(frozen=True)
class OpticalNull:
    """What images show where nothing is missing.

    Attributes:
        noise: covariance of the tiles.
        spurious: of the effects' sizes.
        excess: (J,) mean square of the whitened residual of each trajectory, by the covariance of
            the others.
        sensor: whose images it was estimated from.
        source: which ones, in words.
    """

    noise: TileNoise
    spurious: tuple[SpuriousSize, ...]
    excess: FloatArray
    sensor: str
    source: str

    def at(self, meter: TileMeter, camera: FloatArray) -> TileNoise:
        """Return the covariance of other tiles.

        Args:
            meter: of them.
            camera: (T, 6) deviation by the camera's noise; NaN where it is not known.
        """
        own, centre = self.noise, meter.grid.centre_px
        nearest = KDTree(own.centre_px).query(centre)[1]
        known = np.where(np.isfinite(camera), camera, own.camera[nearest])
        return replace(own, centre_px=centre, camera=known, model=own.model[nearest])

    def knows(self, effect: Effect) -> bool:
        """Return whether the scatter of an effect's sizes is known, by its parameters' names."""
        directions = {p.name for p in effect.parameters if p.none is not None}
        shape = {p.name for p in effect.parameters if p.none is None}
        return bool(self._known(effect.name, directions, shape))

    def _known(self, name: str, directions: set[str], shape: set[str]) -> list[SpuriousSize]:
        return [
            one
            for one in self.spurious
            if (one.effect, set(one.deviation), set(one.shape)) == (name, directions, shape)
        ]

    def with_effects(self, effects: Sequence[Effect], case: OpticalCase) -> OpticalNull:
        """Return it with the sizes that some more effects seem to have where nothing is missing.

        Thresholds then count on no more trajectories than those of the case.
        """
        shots = [shot for shot in case.shots if shot.name != IDLE]
        signatures = signatures_of(effects, [shot.film for shot in shots], case.meter)
        found = _spurious_sizes(signatures, shots, self.at(case.meter, case.camera), case.meter)
        others = tuple(one for one in self.spurious if one.effect not in signatures)
        fewest = min(self.noise.trajectory_count, len(shots))
        return replace(
            self, noise=replace(self.noise, trajectory_count=fewest), spurious=others + found
        )

    def variances(self, name: str, signature: Signature) -> FloatArray:
        """Return (P,) the variance of a signature's sizes, in squared steps.

        That of the probe whose shape is nearest, of an effect that it knows.
        """
        known = self._known(name, {d.name for d in signature.directions}, set(signature.shape))
        step = signature.directions[0].step
        nearest = min(known, key=lambda one: _distance(one, signature, known, step))
        return np.array([(nearest.deviation[d.name] / d.step) ** 2 for d in signature.directions])

    @property
    def usual_excess(self) -> float:
        """Mean square of a whitened residual where nothing is missing."""
        return float(np.exp(np.mean(np.log(self.excess))))

    def largest_excess(self, alpha: float) -> float:
        """Return the mean square that one more trajectory exceeds with probability alpha.

        Its logarithm is taken as normal, of the mean and the deviation that few trajectories have.
        Data of several trajectories scatter less if these are independent, which is not assumed.
        """
        logarithm = np.log(self.excess)
        count = len(logarithm)
        spread = float(np.std(logarithm, ddof=1)) * np.sqrt(1.0 + 1.0 / count)
        beyond = float(student.ppf(1.0 - alpha, count - 1))
        return float(np.exp(np.mean(logarithm) + beyond * spread))


def _distance(
    one: SpuriousSize, signature: Signature, known: Sequence[SpuriousSize], step: float
) -> tuple[float, float]:
    """Return how far a probe's shape is from a signature's, then how far their steps are."""
    total = 0.0
    for name, value in signature.shape.items():
        values = [other.shape[name] for other in known]
        width = max(max(values) - min(values), 1e-12)
        total += ((one.shape[name] - value) / width) ** 2
    return total, abs(one.step - step)


def fit_optical_null(
    case: OpticalCase,
    effects: Iterable[Effect],
    *,
    sensor: str,
    source: str,
    signatures: Mapping[str, Sequence[Signature]] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> OpticalNull:
    """Return what images show in which nothing is wrong.

    Args:
        case: the images; the idle images give the camera's noise alone.
        effects: those with an image hook are fitted.
        sensor: name of the sensor.
        source: what the images are, in words.
        signatures: of the effects on the trajectories, where they were made before.
        progress: called with the number of trajectories done, and of all.

    Raises:
        ValueError: a single idle image.
    """
    shots = [shot for shot in case.shots if shot.name != IDLE]
    if not np.all(np.isfinite(case.camera)):
        raise ValueError(
            "the camera's noise cannot be estimated from a single idle image; record a few"
        )
    residuals, changes = [s.residual for s in shots], [s.change for s in shots]
    films, centre = [s.film for s in shots], case.meter.grid.centre_px
    noise = estimate_noise(residuals, changes, case.camera, centre)
    if signatures is None:
        signatures = signatures_of(effects, films, case.meter)
    spurious = _spurious_sizes(signatures, shots, noise, case.meter)
    excess = np.zeros(len(shots))
    for left_out in range(len(shots)):
        others = [k for k in range(len(shots)) if k != left_out]
        of_others = estimate_noise(
            [residuals[k] for k in others], [changes[k] for k in others], case.camera, centre
        )
        own = camera_nuisances([films[left_out]], case.meter)
        excess[left_out] = np.mean(
            freed([residuals[left_out]], of_others, own, [changes[left_out]]) ** 2
        )
        if progress is not None:
            progress(left_out + 1, len(shots))
    return OpticalNull(noise, spurious, excess, sensor, source)


def _spurious_sizes(
    signatures: Mapping[str, Sequence[Signature]],
    shots: Sequence[Shot],
    noise: TileNoise,
    meter: TileMeter,
) -> tuple[SpuriousSize, ...]:
    """Return how far effects' sizes scatter in trajectories in which nothing is wrong."""
    nuisances = camera_nuisances([shot.film for shot in shots], meter)
    search = OpticalSearch(signatures, noise, nuisances, [shot.change for shot in shots])
    variances = search.spurious_variances([shot.residual for shot in shots])
    return tuple(
        SpuriousSize(
            name,
            dict(one.shape),
            one.directions[0].step,
            {
                d.name: abs(d.step) * float(np.sqrt(v))
                for d, v in zip(one.directions, variance, strict=True)
            },
        )
        for name, several in signatures.items()
        for one, variance in zip(several, variances[name], strict=True)
    )


def save_optical_null(null: OpticalNull, path: Path) -> None:
    """Write it, whole or not at all."""
    noise = null.noise
    rows = [
        (number, one.effect, name, kind, value)
        for number, one in enumerate(null.spurious)
        for kind, values in (
            ("shape", one.shape),
            ("step", {"": one.step}),
            ("deviation", one.deviation),
        )
        for name, value in values.items()
    ]
    number, effect, name, kind, value = zip(*rows, strict=True)
    with whole_file(path) as part:
        np.savez_compressed(
            part,
            version=np.array(VERSION),
            centre_px=noise.centre_px,
            camera=noise.camera,
            model=noise.model,
            growth=noise.growth,
            mixing=noise.mixing,
            correlations=np.array([(c.white, c.frames, c.length_px) for c in noise.correlations]),
            trajectory_count=np.array(noise.trajectory_count),
            spurious_number=np.array(number),
            spurious_effect=np.array(effect),
            spurious_name=np.array(name),
            spurious_kind=np.array(kind),
            spurious_value=np.array(value, dtype=np.float64),
            excess=null.excess,
            sensor=np.array(null.sensor),
            source=np.array(null.source),
        )


def load_optical_null(path: str | Path | None = None) -> OpticalNull:
    """Read it; None: the shipped one.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a file of another version.
    """
    path = parameter_path(FILE) if path is None else Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"no file of the images' noise at {path}; find-gap --fit-optical-noise makes one"
        )
    arrays = read_arrays(path)
    version = arrays.get("version")
    if version is None or version.shape != () or version.dtype.kind != "i" or version != VERSION:
        raise ValueError(
            f"{path} is no noise of images of version {VERSION}; make it again with find-gap "
            "--fit-optical-noise"
        )
    try:
        return _null_of(arrays)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ValueError(
            f"{path} is no whole noise of images ({type(error).__name__}: {error}); make it again "
            "with find-gap --fit-optical-noise"
        ) from error


def _null_of(arrays: Arrays) -> OpticalNull:
    noise = TileNoise(
        arrays["centre_px"],
        arrays["camera"],
        arrays["model"],
        arrays["growth"],
        arrays["mixing"],
        tuple(Correlation(*map(float, row)) for row in arrays["correlations"]),
        int(arrays["trajectory_count"]),
    )
    parts: dict[int, dict[str, dict[str, float]]] = {}
    effects: dict[int, str] = {}
    for number, effect, name, kind, value in zip(
        arrays["spurious_number"].tolist(),
        arrays["spurious_effect"].tolist(),
        arrays["spurious_name"].tolist(),
        arrays["spurious_kind"].tolist(),
        arrays["spurious_value"].tolist(),
        strict=True,
    ):
        effects[number] = effect
        parts.setdefault(number, {}).setdefault(kind, {})[name] = value
    return OpticalNull(
        noise,
        tuple(
            SpuriousSize(
                effects[number],
                parts[number].get("shape", {}),
                parts[number]["step"][""],
                parts[number]["deviation"],
            )
            for number in sorted(parts)
        ),
        arrays["excess"],
        str(arrays["sensor"]),
        str(arrays["source"]),
    )
