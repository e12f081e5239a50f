# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Solves presses in a pool of processes; every solve is kept on disk, so that an interrupted run
can be resumed, and nothing is solved twice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.values import GelValues
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.cache import PHYSICS, content_key, load_arrays, store_arrays, tell_broken
from dotsim_ros.io.worker_pool.pool import Crew, open_pool
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SimulatedPress, SolveError
from dotsim_ros.twin.simulator import REFERENCE_MODULUS_PA, GelSimulator, gel_key, tables_of

TOLERANCE_M = 5.0e-6
"""Tolerance of the solves: effects move the skin by tens of micrometres where tried, and a solve
to a fifth of this takes more than twice as long."""


TOGETHER = 8
"""So many presses of one gel are one worker's task: making the gel takes as long as some of
them."""

MAKING = 5
"""Making a gel takes as long as so many presses."""

Progress = Callable[[int, int], None]
"""Called with how much work is done, in presses, and of how much; `MAKING` is counted."""


@dataclass(frozen=True)
class SolveRequest:
    """A press to solve.

    Attributes:
        name: for messages.
        indenter: what presses.
        poses: F of the indenter, base frame.
        stamp_s: (F,) their times.
        values: the gel; no solve depends on its Young's modulus, the force is proportional to it.
        relaxation: of the gel.
    """

    name: str
    indenter: Indenter
    poses: tuple[Pose, ...]
    stamp_s: FloatArray
    values: GelValues
    relaxation: PronySeries


_simulator: GelSimulator | None = None


def begin(specification: SensorSpecification, skin: SkinMesh) -> None:
    """Prepare a worker: make the gel that its solves are of."""
    global _simulator
    _simulator = GelSimulator(specification, skin, tolerance_m=TOLERANCE_M)


def solve(request: SolveRequest) -> SimulatedPress | str:
    """Return skin and force of a request, in a worker, or why it could not be solved."""
    assert _simulator is not None
    try:
        return _simulator.press(
            replace(request.values, youngs_modulus_pa=REFERENCE_MODULUS_PA),
            request.indenter,
            request.poses,
            request.stamp_s,
            relaxation=request.relaxation,
        )
    except SolveError as error:
        return str(error)


def prepare_table(number: int) -> None:
    """Make a table of the gel's refinement, in a worker."""
    assert _simulator is not None
    _simulator.prepare_table(number)


def solve_each(requests: Sequence[SolveRequest]) -> list[SimulatedPress | str]:
    """Return the answers of `solve`, in a worker."""
    return [solve(request) for request in requests]


@dataclass(frozen=True)
class _Task:
    """Requests by key that one worker solves in a row, all of one gel, and how much work it is."""

    requests: dict[str, SolveRequest]
    work: int


def _tasks(requests: Mapping[str, SolveRequest]) -> list[_Task]:
    """Return requests by key in the tasks of workers: those of one gel follow each other."""
    by_gel: dict[tuple[float | tuple[float, ...], ...], list[str]] = {}
    for key, request in requests.items():
        by_gel.setdefault(gel_key(request.values), []).append(key)
    tasks = []
    for keys in by_gel.values():
        for begin in range(0, len(keys), TOGETHER):
            part = {key: requests[key] for key in keys[begin : begin + TOGETHER]}
            # The worker that is given the next ones has the gel still.
            tasks.append(_Task(part, len(part) + (0 if begin else MAKING)))
    return tasks


class PressSolver:
    """Solves requests; use `open_press_solver`.

    Attributes:
        solve_count: presses that were solved, not taken from disk.
    """

    def __init__(
        self,
        pool: Executor,
        directory: Path,
        specification: SensorSpecification,
        skin: SkinMesh,
    ) -> None:
        self._pool, self._directory = pool, directory
        s = specification
        self._sensor = (s.gel, s.solver, s.contact, TOLERANCE_M, skin)
        self._vertex_count = skin.vertex_count
        self._is_refined = s.solver.refined
        self._known: dict[str, SimulatedPress | str] = {}
        self._tables: set[int] = set()
        self.solve_count = 0

    def prepare(self, requests: Iterable[SolveRequest], progress: Progress | None = None) -> None:
        """Make the tables that the requests need, each once, side by side: half a minute each where
        they are not on disk. `progress` is called with the number of tables done, and of all."""
        if not self._is_refined:
            return
        ratios = {request.values.poisson_ratio for request in requests}
        numbers = {number for ratio in ratios for number, _ in tables_of(ratio)} - self._tables
        tasks = [self._pool.submit(prepare_table, number) for number in sorted(numbers)]
        for count, future in enumerate(as_completed(tasks), 1):
            future.result()
            if progress is not None:
                progress(count, len(tasks))
        self._tables |= numbers

    def work_of(self, requests: Sequence[SolveRequest]) -> int:
        """Return how much of the requests is to be solved, as `Progress` counts it."""
        return sum(task.work for task in _tasks(self._missing(requests)[1]))

    def run_each(
        self, requests: Sequence[SolveRequest], progress: Progress | None = None
    ) -> list[SimulatedPress | str]:
        """Return skin and force of each request, or why it could not be solved."""
        keys, missing = self._missing(requests)
        self.prepare(missing.values())
        tasks = _tasks(missing)
        work, total = 0, sum(task.work for task in tasks)
        if progress is not None:
            progress(work, total)
        waiting = {
            self._pool.submit(solve_each, tuple(task.requests.values())): task for task in tasks
        }
        for future in as_completed(waiting):
            task = waiting.pop(future)
            for key, found in zip(task.requests, future.result(), strict=True):
                self._known[key] = found
                _store(self._path(key), found)
                self.solve_count += 1
            work += task.work
            if progress is not None:
                progress(work, total)
        return [
            _with_modulus(self._known[key], request.values.youngs_modulus_pa)
            for key, request in zip(keys, requests, strict=True)
        ]

    def _missing(
        self, requests: Sequence[SolveRequest]
    ) -> tuple[list[str], dict[str, SolveRequest]]:
        """Return the keys of requests, and those requests that are neither known nor on disk."""
        keys = [self._key(request) for request in requests]
        missing: dict[str, SolveRequest] = {}
        for key, request in zip(keys, requests, strict=True):
            if key in self._known or key in missing:
                continue
            stored = _load(self._path(key), (len(request.poses), self._vertex_count))
            if stored is None:
                missing[key] = request
            else:
                self._known[key] = stored
        return keys, missing

    def _key(self, request: SolveRequest) -> str:
        values = replace(request.values, youngs_modulus_pa=REFERENCE_MODULUS_PA)
        return content_key(
            PHYSICS,
            self._sensor,
            values,
            request.relaxation,
            replace(request.indenter, name=""),
            request.poses,
            request.stamp_s,
        )

    def _path(self, key: str) -> Path:
        return self._directory / f"{key}.npz"


def _with_modulus(found: SimulatedPress | str, youngs_modulus_pa: float) -> SimulatedPress | str:
    if isinstance(found, str):
        return found
    return replace(found, force_n=found.force_n * (youngs_modulus_pa / REFERENCE_MODULUS_PA))


def _store(path: Path, found: SimulatedPress | str) -> None:
    if isinstance(found, str):
        store_arrays(path, {"error": np.array(found)})
        return
    store_arrays(
        path,
        {
            "skin_position_m": found.skin_position_m,
            "force_n": found.force_n,
            "converged": np.array(found.converged),
        },
    )


def _load(path: Path, shape: tuple[int, int]) -> SimulatedPress | str | None:
    """Return a kept solve of so many frames and vertices; None where there is none to be used."""
    stored = load_arrays(path)
    if stored is None:
        return None
    if "error" in stored:
        return str(stored["error"])
    skin, force = stored.get("skin_position_m"), stored.get("force_n")
    if (
        skin is None
        or force is None
        or skin.shape != (*shape, 3)
        or force.shape != (shape[0], 3)
        or not (np.isfinite(skin).all() and np.isfinite(force).all())
        or stored.get("converged", np.zeros(0)).shape != ()
    ):
        tell_broken(path, f"it holds no skin and force of {shape[0]} frames")
        return None
    return SimulatedPress(skin, force, bool(stored["converged"]))


@contextmanager
def open_press_solver(
    specification: SensorSpecification, skin: SkinMesh, directory: Path, *, workers: Crew = 2
) -> Iterator[PressSolver]:
    """Open a pool of workers that each hold the sensor's gel; solves are kept in the folder."""
    with open_pool(workers, begin, specification, skin) as pool:
        yield PressSolver(pool, directory, specification, skin)
