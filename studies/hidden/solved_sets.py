# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Data sets with hidden effects that finite elements (CalculiX) have solved.

Each set is a unit of the sensor, measured along eight trajectories (two holds, four presses, two
slides), with constants, mesh and noise of its own. In some nothing is wrong, and two constants are
nearly out of tolerance; in some one effect is hidden, in some two, in some one that the library
does not know. The effect is part of what CalculiX solves: none of our own gel takes part. OUT has
index.json, which says of each set which half it belongs to, and set_NN in the layout of measured
data, with the sealed truth.json. A trajectory is saved once it is solved, so that an interrupted
run resumes with the same command; one that CalculiX cannot finish is tried again with smaller
steps, then with larger elements, and then listed as failed.

OUT/commissioning is the unit as declared, on three meshes, to calibrate the twin with and to learn
what it is off by: what a model calls friction or stiffness is an effective constant, and that of
another solver's units is not that of another sensor's.

    python -m studies hide --count 32 --seed 7 --out out/hidden
    dotsim_ros calibrate --data out/hidden/commissioning --sensor sensor_a --hold-out 0 \\
        --out out/sensor_a.yaml
    python -m studies gap_discrepancy --data out/hidden/commissioning --sensor out/sensor_a.yaml \\
        --out out/discrepancy.npz
    python -m studies gap_physics --sets out/hidden --sensor out/sensor_a.yaml \\
        --discrepancy out/discrepancy.npz

The folder:

    index.json                which sets there are, of which half, and what of them is made
    commissioning/...         the unit as declared, to calibrate the twin with
    set_00/dataset.yaml ...   a measured data set
    set_00/truth.json         sealed: for the scoring alone; its SHA-256 stands in the index
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.io.documents import read_json
from dotsim_ros.io.files import write_json, write_text
from dotsim_ros.io.provenance import provenance
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.hidden.solved_draw import (
    COMMISSIONED,
    COMMISSIONING,
    HALVES,
    SolvedUnit,
    commissioning_unit,
    draw_series,
)
from studies.hidden.solved_unit import (
    Protocol,
    UnsolvedError,
    measured,
    protocols,
)
from studies.reference.run import calculix_version

INDEX, TRUTH = "index.json", "truth.json"
VERSION = 1
"""Of what is drawn and how it is solved; a folder of another one is not continued."""
SKIN_SPACING_M = 1.6e-3
INDENTER_STEP_M = 0.3e-3
"""Edges of the indenters' meshes: 3 um off a ball of 4 mm, 11 um off the cone's tip."""
_KEYS = {"version", "seed", "count", "sensor", "trajectories", "coarseness", "sets"}


@dataclass(frozen=True)
class SeriesPlan:
    """What is to be made.

    Attributes:
        sensor: as declared.
        count: of sets.
        seed: of everything.
        trajectories: names of those that each set has; empty for all.
        coarseness: elements are so many times as large as the units'; 1 but for quick tests.
        hidden: what is wrong with each unit; empty where it is drawn.

    Raises:
        ValueError: one of them is out of range.
    """

    sensor: SensorSpecification
    count: int
    seed: int
    trajectories: tuple[str, ...] = ()
    coarseness: float = 1.0
    hidden: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, low, high in (("count", 1, 1000), ("seed", 0, None), ("coarseness", 1, 2)):
            value = getattr(self, name)
            if not (value >= low and (high is None or value <= high)):
                limits = f"from {low}" if high is None else f"{low} to {high}"
                raise ValueError(f"{name} is {value:g}, expected {limits}")

    def stated(self) -> dict[str, Any]:
        """Return what two runs that share a folder must agree on."""
        return {
            "version": VERSION,
            "seed": self.seed,
            "count": self.count,
            "sensor": self.sensor.name,
            "trajectories": list(self.trajectories),
            "coarseness": self.coarseness,
            **({"hidden": list(self.hidden)} if self.hidden else {}),
        }

    def units(self) -> list[SolvedUnit]:
        """Return the unit of each set."""
        return draw_series(self.sensor, self.count, self.seed, self.hidden)


@dataclass(frozen=True)
class SetRecord:
    """What the index says of a set.

    Attributes:
        name: of its folder.
        half: development or opened.
        truth_sha256: of its sealed truth.
        made: names of its trajectories.
        failures: why others are missing, by name.
        is_ready: whether all of its trajectories are made or given up.
    """

    name: str
    half: str
    truth_sha256: str
    made: tuple[str, ...]
    failures: dict[str, str]
    is_ready: bool


def hide(
    *,
    count: int = 32,
    seed: int = 0,
    out: Path = Path("out/hidden"),
    sensor: str = "sensor_a",
    trajectories: tuple[str, ...] = (),
    retry: bool = False,
    coarseness: float = 1.0,
    hidden: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Make data sets with hidden effects that CalculiX solves, for the gap finder.

    Args:
        count: sets.
        seed: of everything that is drawn.
        out: folder of the sets.
        sensor: name or file of what is declared.
        trajectories: which of each set (all).
        retry: whether trajectories that failed before are tried again.
        coarseness: factor on the size of elements, for a quick look.
        hidden: names of what is wrong with each set, or `nothing`, in place of what the seed draws;
            without the unit as declared.

    Raises:
        CalculixMissingError, OSError, ValueError: as `SeriesPlan` and `make_sets`.
    """
    plan = SeriesPlan(load_sensor(sensor), count, seed, trajectories, coarseness, hidden)
    make_sets(out, plan, failed_again=retry)
    index, records = read_series(out)
    made = {record.name: record.made for record in records}
    failures = {record.name: record.failures for record in records}
    if COMMISSIONING in index:
        made[COMMISSIONING] = tuple(index[COMMISSIONING]["made"])
        failures[COMMISSIONING] = index[COMMISSIONING]["failures"]
    return {
        "sets": len(records),
        "trajectories": sum(map(len, made.values())),
        "megabytes": round(1e-6 * size_bytes(out), 1),
        "failed": {
            f"{name}/{trajectory}": reason
            for name, of_set in failures.items()
            for trajectory, reason in of_set.items()
        },
    }


def make_sets(directory: Path, plan: SeriesPlan, *, failed_again: bool = False) -> None:
    """Make the sets of a plan, or those that a run before has left.

    Args:
        directory: of the sets.
        plan: what to make.
        failed_again: whether trajectories that failed before are tried again.

    Raises:
        CalculixMissingError: it is not installed.
        FileExistsError: something else lies in the folder.
        ValueError: the folder was made by another plan, or the plan has no such trajectory.
        OSError: a disk that is full, where the same command goes on from there, or a folder that
            another run is filling.
    """
    version = calculix_version()
    units = plan.units()
    index = _begin(directory, plan, units, version)
    with _alone(directory):
        if failed_again:
            for of_unit in (index[COMMISSIONING],) if COMMISSIONING in index else ():
                of_unit["failures"] = {}
            for record in index["sets"]:
                record["ready"] = record["ready"] and not record["failures"]
                record["failures"] = {}
        save = partial(write_json, directory / INDEX, index)
        if not plan.hidden:
            _commission(directory, plan, index, save)
        for unit, record in zip(units, index["sets"], strict=True):
            if record["ready"]:
                print(f"{unit.name}: there already")
                continue
            write_text(directory / unit.name / TRUTH, unit.sealed())
            _make_set(directory, plan, unit, _protocols(plan, unit), record, save)
            record["ready"] = True
            save()
            ready = sum(entry["ready"] for entry in index["sets"])
            print(f"{unit.name}: ready, {ready} of {len(units)}")


def _commission(
    directory: Path, plan: SeriesPlan, index: dict[str, Any], save: Callable[[], None]
) -> None:
    """Make the trajectories of the unit as declared that are missing."""
    record = index.setdefault(COMMISSIONING, {"made": [], "failures": {}})
    declared = [commissioning_unit(plan.sensor, plan.seed, mesh) for mesh in range(COMMISSIONED)]
    # The meshes differ in nothing else that the truth says.
    write_text(directory / COMMISSIONING / TRUTH, declared[0].sealed())
    for mesh, unit in enumerate(declared):
        _make_set(directory, plan, unit, _repeated(plan, unit, mesh), record, save)
    print(f"{COMMISSIONING}: ready")


def _repeated(plan: SeriesPlan, unit: SolvedUnit, repeat: int) -> list[Protocol]:
    """Return a unit's protocols, numbered behind those of the repeats before."""
    planned = _protocols(plan, unit)
    result = []
    for protocol in planned:
        stem, number = protocol.name.rsplit("_", 1)
        name = f"{stem}_{int(number) + repeat * len(planned)}"
        result.append(replace(protocol, name=name))
    return result


@contextmanager
def _alone(directory: Path) -> Iterator[None]:
    """Keep other runs out of a folder.

    Raises:
        BlockingIOError: one is at work there.
    """
    handle = os.open(directory, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BlockingIOError(
                f"another run is making sets in {directory}; wait for it, or give another folder "
                "with --out"
            ) from error
        yield
    finally:
        os.close(handle)


def read_series(directory: Path) -> tuple[dict[str, Any], list[SetRecord]]:
    """Return what a folder's index states, and its sets.

    Raises:
        FileNotFoundError: there is no index.
        ValueError: it is another program's, or of another version.
    """
    path = directory / INDEX
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} is not there; make the sets with python -m studies hide --out {directory}"
        )
    index = _checked_index(path)
    records = [
        SetRecord(
            entry["name"],
            entry["half"],
            entry["truth_sha256"],
            tuple(entry["made"]),
            dict(entry["failures"]),
            bool(entry["ready"]),
        )
        for entry in index["sets"]
    ]
    return index, records


def _checked_index(path: Path) -> dict[str, Any]:
    index = read_json(path)
    if not isinstance(index, dict) or not set(index) >= _KEYS:
        raise ValueError(
            f"{path} is no index of hidden sets (it needs {', '.join(sorted(_KEYS))}); give "
            "another folder"
        )
    if index["version"] != VERSION:
        raise ValueError(
            f"{path} is of version {index['version']}, expected {VERSION}; make the sets again in "
            "another folder"
        )
    return index


def _begin(
    directory: Path, plan: SeriesPlan, units: Sequence[SolvedUnit], version: str
) -> dict[str, Any]:
    """Return the index, that of a run before where there was one."""
    path = directory / INDEX
    if path.is_file():
        index = _checked_index(path)
        for key, wanted in plan.stated().items():
            if index.get(key) != wanted:
                raise ValueError(
                    f"{directory} holds sets of {key} {index.get(key)!r}, asked for were "
                    f"{wanted!r}; "
                    "give that value to continue them, or another folder with --out"
                )
        if index.get("calculix") != version:
            raise ValueError(
                f"{directory} holds sets that CalculiX {index.get('calculix')} solved, installed "
                f"is {version}; give another folder with --out"
            )
        sealed = [entry["truth_sha256"] for entry in index["sets"]]
        if sealed != [unit.digest() for unit in units]:
            raise ValueError(
                f"{directory} holds sets with other truths than this version draws; give another "
                "folder with --out"
            )
        return index
    if directory.exists() and any(directory.iterdir()):
        raise FileExistsError(
            f"{directory} holds files, and no {INDEX} that says they are hidden sets; give an "
            "empty folder or a new one with --out"
        )
    every = replace(plan, trajectories=())
    known = {protocol.name for unit in units for protocol in _protocols(every, unit)}
    unknown = sorted(set(plan.trajectories) - known)
    if unknown:
        raise ValueError(
            f"no trajectory {', '.join(unknown)}, expected of {', '.join(sorted(known))}"
        )
    entries = [
        {
            "name": unit.name,
            "half": unit.half,
            "seed": list(unit.seed),
            "truth_sha256": unit.digest(),
            "made": [],
            "failures": {},
            "ready": False,
        }
        for unit in units
    ]
    origin = {"calculix": version, "provenance": provenance(), "halves": list(HALVES)}
    made = plan.stated() | origin | {"sets": entries}
    write_json(path, made)
    return made


def _protocols(plan: SeriesPlan, unit: SolvedUnit) -> list[Protocol]:
    """Return the trajectories of a unit that are asked for, all where none is named."""
    every = protocols(plan.sensor, np.random.default_rng([*unit.seed, 2]))
    return [p for p in every if not plan.trajectories or p.name in plan.trajectories]


def _make_set(
    directory: Path,
    plan: SeriesPlan,
    unit: SolvedUnit,
    planned: Sequence[Protocol],
    record: dict[str, Any],
    save: Callable[[], None],
) -> None:
    """Make the planned trajectories of a set that are missing; its entry is kept up to date."""
    folder = directory / unit.name
    skin = dome_skin(plan.sensor.gel.outer_radius_m, SKIN_SPACING_M)
    data_set = DataSetWriter(folder, skin, indenter_step_m=INDENTER_STEP_M)
    for number, protocol in enumerate(planned):
        name = protocol.name
        if name in record["failures"]:
            continue
        notes = {"truth_sha256": unit.digest()}
        if data_set.holds(name, notes):
            if name not in record["made"]:
                record["made"].append(name)
            continue
        indenter = replace(load_indenter(protocol.indenter), name=protocol.indenter)
        try:
            trajectory, tries = measured(
                unit,
                plan.sensor,
                skin,
                protocol,
                indenter,
                np.random.default_rng([*unit.seed, 3, number]),
                coarseness=plan.coarseness,
            )
        except UnsolvedError as error:
            record["failures"][name] = str(error)
            print(f"{unit.name}/{name}: {error}")
        else:
            data_set.add(trajectory, indenter, notes | {"tries": tries})
            record["made"].append(name)
            print(f"{unit.name}/{name}: {len(protocol.time_s)} frames, {tries} tries")
        save()


def size_bytes(directory: Path) -> int:
    """Return how large all files below a folder are together."""
    total = 0
    for path in directory.rglob("*"):
        # Another process may be replacing it.
        with suppress(FileNotFoundError):
            total += path.stat().st_size if path.is_file() else 0
    return total
