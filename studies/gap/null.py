# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gap finder's null: how far a calibrated twin is from presses in which nothing is missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from dotsim_ros.data.measurement import Measurement
from dotsim_ros.effects.simulate import EffectRequest, open_solver
from dotsim_ros.gap.presses.observables import observe, places_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.worker_pool.pool import Crew
from dotsim_ros.specification import SensorSpecification


def residuals_without_effect(
    measurement: Measurement,
    sensor: SensorSpecification,
    directory: Path,
    *,
    workers: Crew = 2,
    progress: Callable[[int, int], None] | None = None,
) -> list[FloatArray]:
    """Return measured minus simulated, (F, SIZE), of each trajectory.

    Args:
        measurement: of a unit in which nothing is missing.
        sensor: calibrated to it.
        directory: where solves are kept.
        workers: how many processes, or workers of Ray.
        progress: called with the number of solves done, and of all.
    """
    rest_m, values = measurement.skin.rest_position_m, values_of(sensor)
    with open_solver(sensor, measurement.skin, directory, workers=workers) as solver:
        answers = solver.run([EffectRequest(r, values) for r in measurement.recordings], progress)
    result = []
    for recording, answer in zip(measurement.recordings, answers, strict=True):
        places, press = places_of(recording, measurement.skin), recording.press
        measured = observe(places, rest_m, press.skin_position_m, press.force_n, press.frame_count)
        simulated = observe(
            places, rest_m, answer.skin_position_m, answer.force_n, press.frame_count
        )
        result.append(measured - simulated)
    return result
