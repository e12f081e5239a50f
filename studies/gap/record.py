# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The power of the gap finder on hidden effects, and what it knows of presses without any."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dotsim_ros.gap.presses.covariance import save_discrepancy
from dotsim_ros.io.files import cache_directory
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.io.worker_pool.pool import crew
from dotsim_ros.specification import load_sensor
from studies.data import SENSOR_A
from studies.gap.discrepancy import calibrated_discrepancy
from studies.gap.presses import Source
from studies.gap.study import run_study
from studies.hidden.laws import LAWS, OTHER_LAWS


def gap(
    *,
    data: Path = SENSOR_A,
    sensor: str = "sensor_a",
    nulls: int = 200,
    repeats: int = 2,
    laws: tuple[str, ...] = tuple(OTHER_LAWS),
    seed: int = 5,
    workers: int = 2,
    ray_address: str | None = None,
    cache: Path | None = None,
) -> dict[str, Any]:
    """Power of the gap finder on effects that are hidden in measured presses.

    Args:
        data: folder of a data set without an effect.
        sensor: name or file of the sensor, calibrated to it.
        nulls: cases without an effect.
        repeats: cases of each law and size, from each half of the presses.
        laws: that are hidden; by default none that is a formula of the library.
        seed: of all draws.
        workers: processes, or workers of the Ray cluster, at most.
        ray_address: HOST:PORT of the head of a Ray cluster, auto or local (none).
        cache: folder of the solves (the user's cache).

    Raises:
        ValueError: no such law; SolveError: as `run_study`.
    """
    unknown = sorted(set(laws) - set(LAWS))
    if unknown:
        raise ValueError(f"no law {', '.join(unknown)}; known are {', '.join(LAWS)}")
    source = _source(data, sensor, cache, workers, ray_address)
    source.run.mkdir(parents=True, exist_ok=True)
    return run_study(source, nulls=nulls, repeats=repeats, seed=seed, laws=laws)


def gap_discrepancy(
    *,
    data: Path = Path("data/hidden_17/commissioning"),
    sensor: str = "data/hidden_17/sensor_a.yaml",
    out: Path = Path("out/discrepancy.npz"),
    representative: bool = False,
    seed: int = 0,
    workers: int = 2,
    ray_address: str | None = None,
    cache: Path | None = None,
) -> dict[str, Any]:
    """The twin's own error, and the limits of effects, from presses without an effect.

    Args:
        data: folder of a data set without an effect.
        sensor: name or file of the sensor, calibrated to it.
        out: file for the discrepancy (.npz).
        representative: whether the presses differ as the units do that will be searched: they are
            of several, or of several meshes of a solver. Limits need no margin for that then.
        seed: of the draws.
        workers: processes, or workers of the Ray cluster, at most.
        ray_address: HOST:PORT of the head of a Ray cluster, auto or local (none).
        cache: folder of the solves (the user's cache).
    """
    source = _source(data, sensor, cache, workers, ray_address)
    names = [recording.name for recording in source.measurement.recordings]
    found = calibrated_discrepancy(source, names, seed, is_representative=representative)
    save_discrepancy(found, out)
    return {
        "file": str(out),
        "source": found.source,
        "bias": dict(found.bias),
        "limit_factors": dict(found.limit_factors),
    }


def _source(
    data: Path, sensor: str, cache: Path | None, workers: int, ray_address: str | None
) -> Source:
    return Source(
        data,
        load_sensor(sensor),
        cache or cache_directory() / "gap",
        crew(workers, ray_address),
        PrintedProgress(),
    )
