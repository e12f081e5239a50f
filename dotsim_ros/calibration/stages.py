"""The work on single presses, in a pool of processes, each result kept in a file of its own.

An interrupted run resumes from its files: a file belongs to a task by a key of all that the task
depends on.
"""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.cache import content_key
from dotsim_ros.calibration.fitting import (
    FitProblem,
    PressFit,
    PressLinearisation,
    fit_press,
    linearise,
    simulate,
)
from dotsim_ros.files import write_json
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.measured.reading import Observation
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SolveError
from dotsim_ros.twin.simulator import GelSimulator

DECIDED_BY = ("dotsim_ros.calibration.stages",)
"""The code, with all that it imports, that decides a result."""


@dataclass(frozen=True)
class Task:
    """A piece of work on one press.

    Attributes:
        stage: its name, a folder of the run.
        observation: the press.
        problem: what is fitted.
        point: (n,) unknowns to linearise at.
        start: where to fit the press alone from; None only linearises at the point.
        budget: most solves of a fit.
        key: of all that the result depends on.
    """

    stage: str
    observation: Observation
    problem: FitProblem
    point: FloatArray
    start: PressLinearisation | None
    budget: int
    key: str


@dataclass(frozen=True)
class Outcome:
    """What a task gave: a fit, or why it could not be done."""

    name: str
    fit: PressFit | None
    error: str = ""


_simulator: GelSimulator | None = None


def _begin(specification: SensorSpecification, skin: SkinMesh) -> None:
    global _simulator
    _simulator = GelSimulator(specification, skin)


def _work(task: Task) -> Outcome:
    assert _simulator is not None
    name = task.observation.press.name
    try:
        if task.start is None:
            found = linearise(_simulator, task.observation, task.problem, task.point)
            return Outcome(name, PressFit(found, [], found.solve_count))
        fit = fit_press(_simulator, task.observation, task.problem, task.start, budget=task.budget)
    except SolveError as error:
        return Outcome(name, None, str(error))
    return Outcome(name, fit)


def _predict(task: Task) -> tuple[str, FloatArray | None, FloatArray | None, str]:
    assert _simulator is not None
    name = task.observation.press.name
    try:
        found = simulate(_simulator, task.observation, task.problem, task.point)
    except SolveError as error:
        return name, None, None, str(error)
    return name, found.skin_position_m, found.force_n, ""


class Workers:
    """A pool of processes that each hold the sensor's gel; use `open_workers`."""

    def __init__(self, pool: ProcessPoolExecutor, directory: Path) -> None:
        self._pool, self._directory = pool, directory

    def run(self, tasks: Sequence[Task], progress: Callable[[str], None]) -> dict[str, Outcome]:
        """Return the outcomes by press, from files where a run before has left them.

        Args:
            tasks: of one stage.
            progress: called with the name of each press as it is finished.
        """
        outcomes: dict[str, Outcome] = {}
        waiting: dict[Future[Outcome], Task] = {}
        for task in tasks:
            stored = _load(self._file(task), task.key)
            if stored is None:
                waiting[self._pool.submit(_work, task)] = task
            else:
                outcomes[stored.name] = stored
                progress(stored.name)
        while waiting:
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                task = waiting.pop(future)
                outcome = future.result()
                _store(self._file(task), task.key, outcome)
                outcomes[outcome.name] = outcome
                progress(outcome.name)
        return outcomes

    def predict(
        self, tasks: Sequence[Task], progress: Callable[[str], None]
    ) -> dict[str, tuple[FloatArray | None, FloatArray | None, str]]:
        """Return skin (F, V, 3) and force (F, 3) at the tasks' points, or why there are none."""
        found = {}
        for name, skin, force, error in self._pool.map(_predict, tasks):
            found[name] = (skin, force, error)
            progress(name)
        return found

    def _file(self, task: Task) -> Path:
        return self._directory / task.stage / f"{task.observation.press.name}.json"


@contextmanager
def open_workers(
    specification: SensorSpecification, skin: SkinMesh, directory: Path, count: int
) -> Iterator[Workers]:
    """Open a pool of `count` processes; their files go below a directory."""
    # Forked children would share the threads and locks of Warp.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        count, mp_context=context, initializer=_begin, initargs=(specification, skin)
    ) as pool:
        try:
            yield Workers(pool, directory)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def task_key(
    specification: SensorSpecification,
    skin: SkinMesh,
    observation: Observation,
    problem: FitProblem,
    *arrays: FloatArray,
) -> str:
    """Return a key of all that a result depends on."""
    return content_key(
        DECIDED_BY,
        specification,
        [parameter.name for parameter in problem.parameters],
        problem.start,
        problem.noise,
        problem.skin_loss,
        problem.with_offset,
        skin.rest_position_m,
        observation,
        arrays,
    )


def _store(path: Path, key: str, outcome: Outcome) -> None:
    record: dict[str, Any] = {"key": key, "name": outcome.name, "error": outcome.error}
    if outcome.fit is not None:
        fit = asdict(outcome.fit)
        record["fit"] = json.loads(json.dumps(fit, default=lambda array: array.tolist()))
    write_json(path, record)


def _load(path: Path, key: str) -> Outcome | None:
    """Return a stored outcome; None if there is none of this key."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if record.get("key") != key:
        return None
    if "fit" not in record:
        return Outcome(record["name"], None, record["error"])
    fit, best = record["fit"], record["fit"]["best"]
    arrays = {
        field: {channel: np.array(values) for channel, values in best[field].items()}
        for field in ("information", "gradient")
    }
    found = PressLinearisation(**{**best, **arrays, "point": np.array(best["point"])})
    return Outcome(record["name"], PressFit(**{**fit, "best": found}))
