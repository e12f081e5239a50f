"""The gap finder's null: how far a calibrated twin is from presses in which nothing is missing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.calibration.parameters import values_of
from dotsim_ros.gap.covariance import Discrepancy, fit_discrepancy, load_discrepancy
from dotsim_ros.gap.measurement import Measurement, read_measurement
from dotsim_ros.gap.observables import observe, places_of
from dotsim_ros.gap.recording import Recording
from dotsim_ros.gap.simulate import open_solver, request_of
from dotsim_ros.geometry.specification import SensorSpecification
from dotsim_ros.sensor import skin_of

Array = NDArray[np.float64]


def residuals_without_effect(
    measurement: Measurement,
    sensor: SensorSpecification,
    directory: Path,
    *,
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> list[Array]:
    """Return measured minus simulated, (F, SIZE), of each trajectory.

    Args:
        measurement: of a unit in which nothing is missing.
        sensor: calibrated to it.
        directory: where solves are kept.
        workers: processes.
        progress: told the solves.
    """
    rest_m, values = measurement.skin.rest_position_m, values_of(sensor)
    with open_solver(sensor, measurement.skin, directory, workers=workers) as solver:
        answers = solver.run([request_of(r, values) for r in measurement.recordings], progress)
    result = []
    for recording, answer in zip(measurement.recordings, answers, strict=True):
        places, press = places_of(recording, measurement.skin), recording.press
        measured = observe(places, rest_m, press.skin_position_m, press.force_n, press.frame_count)
        simulated = observe(
            places, rest_m, answer.skin_position_m, answer.force_n, press.frame_count
        )
        result.append(measured - simulated)
    return result


def discrepancy_of_half(
    recordings: Sequence[Recording], residuals: Sequence[Array], names: Sequence[str]
) -> Discrepancy:
    """Return the covariances of some recordings in which nothing is missing, and shipped limits.

    Args:
        recordings: of a data set.
        residuals: of each, as `residuals_without_effect` returns them.
        names: of those that are used.
    """
    by_name = {r.name: (r, e) for r, e in zip(recordings, residuals, strict=True)}
    used = [by_name[name] for name in names]
    found = fit_discrepancy([r for r, _ in used], [e for _, e in used], f"{len(used)} presses")
    shipped = load_discrepancy()
    return replace(found, limit_factors=shipped.limit_factors, misfit_limit=shipped.misfit_limit)


def discrepancy_of(
    directory: str | Path,
    sensor: SensorSpecification,
    run: Path,
    *,
    leave_out: Sequence[str] = (),
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
) -> Discrepancy:
    """Return the covariances of a data set in which nothing is missing.

    Args:
        directory: of the data set.
        sensor: calibrated to it.
        run: folder of the solves.
        leave_out: trajectories not to use.
        workers: processes.
        progress: told the solves.
    """
    measurement = read_measurement(directory, own_skin=skin_of(sensor.gel))
    residuals = residuals_without_effect(
        measurement, sensor, run, workers=workers, progress=progress
    )
    used = [
        (r, e)
        for r, e in zip(measurement.recordings, residuals, strict=True)
        if r.name not in leave_out
    ]
    source = f"{len(used)} trajectories of {Path(directory).name} with {sensor.name}"
    return fit_discrepancy([r for r, _ in used], [e for _, e in used], source)
