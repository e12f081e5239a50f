"""Simulates recordings with effects, in a pool of processes; every solve is kept on disk, so that
a run that was killed goes on."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.effects.effect import (
    Active,
    Effect,
    GelTerm,
    Response,
    gel_with,
    motion_filters,
    response_filters,
)
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.values import GelValues
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.measured.recording import Recording
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.simulator import (
    REFERENCE_MODULUS_PA,
    GelSimulator,
    Simulated,
    SolveError,
)

Array = NDArray[np.float64]

TOLERANCE_M = 5.0e-6
"""Of the solves: effects are tried at sizes that move the skin by tens of micrometres, and a solve
to a fifth of this takes more than twice as long."""

Progress = Callable[[int, int], None]
"""Told how many solves are done, and of how many."""


@dataclass(frozen=True)
class Request:
    """A recording to simulate.

    Attributes:
        recording: whose poses are followed.
        values: the gel.
        shift_m: (3,) of all poses, base frame.
        effects: names and values of the effects at work.
    """

    recording: Recording
    values: GelValues
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    effects: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()


def request_of(
    recording: Recording,
    values: GelValues,
    *,
    shift_m: Sequence[float] = (0.0, 0.0, 0.0),
    effects: Sequence[Active] = (),
) -> Request:
    """Return the request of a recording with effects."""
    x, y, z = map(float, shift_m)
    named = tuple((a.effect.name, tuple(sorted(a.values.items()))) for a in effects)
    return Request(recording, values, (x, y, z), named)


_simulator: GelSimulator | None = None
_own_relaxation = PronySeries((), ())
_library: Mapping[str, Effect] = {}


def _begin(specification: SensorSpecification, skin: SkinMesh, folders: tuple[str, ...]) -> None:
    global _simulator, _library, _own_relaxation
    _simulator = GelSimulator(specification, skin, tolerance_m=TOLERANCE_M)
    material = specification.material
    _own_relaxation = PronySeries(material.prony_shares, material.prony_times_s)
    _library = load_effects(folders)


def _active(request: Request, library: Mapping[str, Effect]) -> list[Active]:
    return [Active(library[name], dict(values)) for name, values in request.effects]


def _solve(request: Request) -> Simulated | str:
    assert _simulator is not None
    recording, press = request.recording, request.recording.press
    effects = _active(request, _library)
    own = GelTerm(request.values, _own_relaxation.shares, _own_relaxation.times_s)
    term = gel_with(effects, own, recording)
    filtered = motion_filters(effects)
    shift = np.array(request.shift_m)
    poses = []
    for frame, pose in enumerate(press.poses):
        force = np.zeros(3) if press.force_n is None else press.force_n[frame]
        moved = Pose(pose.position_m + shift, pose.quaternion_xyzw)
        poses.append(filtered(float(press.stamp_s[frame]), moved, force))
    try:
        return _simulator.press(
            replace(term.values, youngs_modulus_pa=REFERENCE_MODULUS_PA),
            recording.indenter,
            poses,
            press.stamp_s,
            relaxation=PronySeries(term.prony_shares, term.prony_times_s),
        )
    except SolveError as error:
        return str(error)


class Solver:
    """Simulates requests; use `open_solver`.

    Attributes:
        solve_count: recordings that were solved, not taken from disk.
    """

    def __init__(
        self,
        pool: ProcessPoolExecutor,
        directory: Path,
        key: str,
        rest_m: Array,
        library: Mapping[str, Effect],
    ) -> None:
        self._pool, self._directory, self._key = pool, directory, key
        self._rest_m, self._library = rest_m, library
        self._kept: dict[str, Simulated | str] = {}
        self.solve_count = 0

    def run(self, requests: Sequence[Request], progress: Progress | None = None) -> list[Simulated]:
        """Return skins and forces of the requests, all effects on skin and force included.

        Raises:
            SolveError: the gel of one could not be solved; the text names it.
        """
        results, failures = self.run_each(requests, progress)
        if failures:
            raise SolveError(failures[0])
        return [result for result in results if result is not None]

    def run_each(
        self, requests: Sequence[Request], progress: Progress | None = None
    ) -> tuple[list[Simulated | None], list[str]]:
        """Return as `run`, None for those that could not be solved, and why not."""
        keys = [self._request_key(request) for request in requests]
        waiting: dict[Future[Simulated | str], str] = {}
        for key, request in zip(keys, requests, strict=True):
            if key in self._kept or key in waiting.values():
                continue
            stored = self._load(key)
            if stored is None:
                waiting[self._pool.submit(_solve, request)] = key
            else:
                self._kept[key] = stored
        count, total = 0, len(waiting)
        while waiting:
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                key = waiting.pop(future)
                self._kept[key] = future.result()
                self._store(key, self._kept[key])
                self.solve_count += 1
                count += 1
                if progress is not None:
                    progress(count, total)
        results: list[Simulated | None] = []
        failures = []
        for request, key in zip(requests, keys, strict=True):
            found = self._kept[key]
            if isinstance(found, str):
                failures.append(f"{request.recording.name}: {found}")
                results.append(None)
            else:
                results.append(self._finished(request, found))
        return results, failures

    def _finished(self, request: Request, found: Simulated) -> Simulated:
        effects = _active(request, self._library)
        force = found.force_n * (request.values.youngs_modulus_pa / REFERENCE_MODULUS_PA)
        if not any(active.effect.response for active in effects):
            return Simulated(found.skin_position_m, force, found.converged)
        filtered = response_filters(effects)
        recording = request.recording
        begun_s = float(recording.press.stamp_s[0])
        answers = [
            filtered(
                Response(
                    stamp_s=float(stamp),
                    session_s=recording.session_s + float(stamp) - begun_s,
                    pose=pose,
                    depth_m=float(depth),
                    rest_position_m=self._rest_m,
                    skin_position_m=skin,
                    force_n=load,
                )
            )
            for stamp, pose, depth, skin, load in zip(
                recording.press.stamp_s,
                recording.press.poses,
                recording.depth_m,
                found.skin_position_m,
                force,
                strict=True,
            )
        ]
        return Simulated(
            np.stack([answer.skin_position_m for answer in answers]),
            np.stack([answer.force_n for answer in answers]),
            found.converged,
        )

    def _request_key(self, request: Request) -> str:
        """Return a key of what the gel's solve depends on: not Young's modulus, nor effects that
        only act on its result."""
        values = replace(request.values, youngs_modulus_pa=REFERENCE_MODULUS_PA)
        solved = [entry for entry in request.effects if self._library[entry[0]].needs_solve]
        press = request.recording.press
        digest = hashlib.sha256(
            repr((self._key, values, request.shift_m, solved, press.indenter)).encode()
        )
        for pose in press.poses:
            digest.update(pose.position_m.tobytes() + pose.quaternion_xyzw.tobytes())
        digest.update(press.stamp_s.tobytes())
        if solved and press.force_n is not None:
            digest.update(press.force_n.tobytes())
        return digest.hexdigest()[:24]

    def _store(self, key: str, found: Simulated | str) -> None:
        self._directory.mkdir(parents=True, exist_ok=True)
        path = self._directory / f"{key}.npz"
        temporary = path.with_name(f"{key}.part.npz")
        if isinstance(found, str):
            np.savez(temporary, error=np.array(found))
        else:
            np.savez(
                temporary,
                skin_position_m=found.skin_position_m.astype(np.float32),
                force_n=found.force_n,
                converged=np.array(found.converged),
            )
        os.replace(temporary, path)

    def _load(self, key: str) -> Simulated | str | None:
        path = self._directory / f"{key}.npz"
        if not path.is_file():
            return None
        with np.load(path, allow_pickle=False) as arrays:
            if "error" in arrays.files:
                return str(arrays["error"])
            return Simulated(
                arrays["skin_position_m"].astype(np.float64),
                arrays["force_n"],
                bool(arrays["converged"]),
            )


@contextmanager
def open_solver(
    specification: SensorSpecification,
    skin: SkinMesh,
    directory: Path,
    *,
    folders: Sequence[str | Path] = (),
    workers: int = 2,
) -> Iterator[Solver]:
    """Open a pool of processes that each hold the sensor's gel.

    Args:
        specification: the sensor.
        skin: the skin's markers.
        directory: where solves are kept.
        folders: of the user's effects.
        workers: processes.
    """
    names = tuple(str(Path(folder).resolve()) for folder in folders)
    key = hashlib.sha256(repr((specification.gel, specification.solver, TOLERANCE_M)).encode())
    key.update(skin.rest_position_m.tobytes())
    material = specification.material
    key.update(np.array([*material.prony_shares, *material.prony_times_s]).tobytes())
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=_begin, initargs=(specification, skin, names)
    ) as pool:
        try:
            library = load_effects(names)
            yield Solver(pool, directory, key.hexdigest(), skin.rest_position_m, library)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
