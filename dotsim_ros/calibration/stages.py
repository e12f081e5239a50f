# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The work on single presses, in a pool of processes, each result kept in a file of its own.

An interrupted run resumes from its files: a file belongs to a task by a key of all that the task
depends on.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.calibration.fitting import (
    FitProblem,
    PressFit,
    PressLinearisation,
    fit_press,
    linearise,
    simulate,
)
from dotsim_ros.data.presses import Prediction
from dotsim_ros.data.reading import Observation
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.cache import PHYSICS, content_key, tell_broken
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import short_name, write_json
from dotsim_ros.io.worker_pool.pool import Crew, open_pool
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SolveError
from dotsim_ros.twin.simulator import GelSimulator


@dataclass(frozen=True)
class Task:
    """A piece of work on one press.

    Attributes:
        observation: the press.
        problem: what is fitted.
        point: (n,) unknowns to linearise at.
        start: where to fit the press alone from, at the point; None only linearises there.
        budget: most solves of a fit.
    """

    observation: Observation
    problem: FitProblem
    point: FloatArray
    start: PressLinearisation | None = None
    budget: int = 0

    @property
    def name(self) -> str:
        """Name of the press."""
        return self.observation.press.name


Outcome = PressFit | str
"""What a task gave: a fit, or why it could not be done."""

_simulator: GelSimulator | None = None


def _begin(specification: SensorSpecification, skin: SkinMesh) -> None:
    global _simulator
    _simulator = GelSimulator(specification, skin)


def _work(task: Task) -> Outcome:
    assert _simulator is not None
    press, problem = task.observation, task.problem
    try:
        if task.start is None:
            found = linearise(_simulator, press, problem, task.point)
            return PressFit(found, [], found.solve_count)
        return fit_press(_simulator, press, problem, task.start, budget=task.budget)
    except SolveError as error:
        return str(error)


def _predict(task: Task) -> Prediction | str:
    assert _simulator is not None
    try:
        found = simulate(_simulator, task.observation, task.problem, task.point)
    except SolveError as error:
        return str(error)
    return Prediction(found.skin_position_m, found.force_n)


@dataclass(frozen=True)
class Workers:
    """A pool of workers that each hold the sensor's gel; by `open_workers`."""

    pool: Executor
    sensor: SensorSpecification
    skin: SkinMesh
    directory: Path

    def run(self, stage: str, tasks: Sequence[Task]) -> Iterator[tuple[str, Outcome]]:
        """Yield the outcome of each task of a stage with its press as it is done, from the file
        that a run before has left where there is one."""
        waiting: dict[Future[Outcome], tuple[Task, Path, str]] = {}
        for task in tasks:
            path = self.directory / stage / f"{short_name(task.name)}.json"
            key = self._key(task)
            stored = _load(path, task, key)
            if stored is None:
                waiting[self.pool.submit(_work, task)] = task, path, key
            else:
                yield task.name, stored
        for future in as_completed(waiting):
            task, path, key = waiting.pop(future)
            _store(path, task, key, future.result())
            yield task.name, future.result()

    def predict(
        self, problem: FitProblem, point: FloatArray, observations: Sequence[Observation]
    ) -> Iterator[tuple[Observation, Prediction | str]]:
        """Yield each press with what the gel gives for it at the shared point (P,), or with why it
        could not be solved."""
        shared = replace(problem, with_offset=False)
        found = self.pool.map(_predict, [Task(o, shared, point) for o in observations])
        yield from zip(observations, found, strict=True)

    def _key(self, task: Task) -> str:
        """Return a key of all that an outcome depends on."""
        return content_key(
            (*PHYSICS, "calibration"), self.sensor, self.skin, replace(task, start=None)
        )


@contextmanager
def open_workers(
    sensor: SensorSpecification, skin: SkinMesh, directory: Path, crew: Crew
) -> Iterator[Workers]:
    """Open a pool of workers; their files go below a directory."""
    with open_pool(crew, _begin, sensor, skin) as pool:
        yield Workers(pool, sensor, skin, directory)


def _store(path: Path, task: Task, key: str, outcome: Outcome) -> None:
    record: dict[str, Any] = {"key": key, "name": task.name}
    if isinstance(outcome, str):
        record["error"] = outcome
    else:
        fit = asdict(outcome)
        record["fit"] = json.loads(json.dumps(fit, default=lambda array: array.tolist()))
    write_json(path, record)


def _load(path: Path, task: Task, key: str) -> Outcome | None:
    """Return a stored outcome; None if there is none of this task that can be read."""
    try:
        record = read_json(path)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        tell_broken(path, error)
        return None
    if not isinstance(record, dict) or "key" not in record:
        tell_broken(path, "it holds no result of a press")
        return None
    if record["key"] != key:
        return None
    try:
        if "fit" not in record:
            return str(record["error"])
        return _fit_of(record["fit"], task.problem.size)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        tell_broken(path, f"it holds no whole result of a press ({error})")
        return None


def _fit_of(record: dict[str, Any], size: int) -> PressFit:
    """Return a fit of so many unknowns.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: the record holds none.
    """
    best = record["best"]
    shapes = {"information": (size, size), "gradient": (size,)}
    arrays = {
        field: {
            channel: np.array(values, dtype=np.float64) for channel, values in best[field].items()
        }
        for field in shapes
    }
    found = PressLinearisation(**{**best, **arrays, "point": np.array(best["point"])})
    channels = [(values, shapes[field]) for field in shapes for values in arrays[field].values()]
    for values, shape in [*channels, (found.point, (size,))]:
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(f"an array of shape {values.shape}, expected {shape}, all finite")
    if not (set(found.loss) == set(found.count) == set(arrays["gradient"])):
        raise ValueError("channels that differ")
    return PressFit(**{**record, "best": found})
