# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""CalculiX as a separate process: found, run, and its printed results read."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.io.arrays import FloatArray
from studies.reference.axisymmetric import WEDGE_COUNT, AxisymmetricDeck
from studies.reference.blocks import MM
from studies.reference.deck import Deck

EXECUTABLES = ("ccx", "ccx_2.21", "ccx_2.22", "ccx_2.20")
INSTALL = "apt-get install calculix-ccx"
JOB = "press"
SAME_TIME = 1e-4
"""Times that are nearer are one: CalculiX prints seven digits."""

_HEADING = re.compile(r"^ (displacements|forces).* for set (\w+) and time\s+(\S+)")
_ERROR = re.compile(r"\*ERROR.*")


class CalculixMissingError(OSError):
    """CalculiX is not installed."""


class CalculixError(ValueError):
    """CalculiX failed before the first step was done."""


@dataclass(frozen=True)
class SolvedStep:
    """The end of one step.

    Attributes:
        displacement_m: (N, 3) of the gel's nodes; only those on the skin are filled in.
        force_n: (3,) of the gel on the indenter.
        torque_nm: (3,) about the base frame's origin.
        increments, iterations: what it took.
    """

    displacement_m: FloatArray
    force_n: FloatArray
    torque_nm: FloatArray
    increments: int
    iterations: int


@dataclass(frozen=True)
class Solution:
    """What a run gave.

    Attributes:
        steps: those that were solved, in order.
        failure: why the others were not, empty where all were.
    """

    steps: tuple[SolvedStep, ...]
    failure: str = ""


def calculix_path() -> str:
    """Return the path of CalculiX's executable.

    Raises:
        CalculixMissingError: there is none on the PATH; the message says how to install it.
    """
    for name in EXECUTABLES:
        path = shutil.which(name)
        if path is not None:
            return path
    raise CalculixMissingError(
        f"CalculiX is not installed: no {EXECUTABLES[0]} on the PATH. On Debian and Ubuntu: "
        f"{INSTALL}"
    )


def calculix_version() -> str:
    """Return the version that CalculiX reports.

    Raises:
        CalculixMissingError: it is not installed.
    """
    done = subprocess.run([calculix_path(), "-v"], capture_output=True, text=True, check=False)
    found = re.search(r"Version\s+(\S+)", done.stdout)
    return found.group(1) if found else "unknown"


@dataclass(frozen=True)
class Printed:
    """What a run has printed at the end of each step that it has solved.

    Attributes:
        moved: rows (node, x, y, z) of the displacements of the skin, mm.
        held: rows of the forces that hold or move the other body, N.
        effort: increments and iterations.
        reason: why it ended before its end; empty where it did not.
    """

    moved: list[FloatArray]
    held: list[FloatArray]
    effort: list[tuple[int, int]]
    reason: str

    def failure(self, step_count: int) -> str:
        """Return why some of so many steps were not solved, empty where all were.

        Raises:
            CalculixError: no step was solved.
        """
        solved = len(self.held)
        if solved == 0:
            raise CalculixError(f"CalculiX solved no step: {self.reason}")
        if solved == step_count:
            return ""
        return f"CalculiX stopped after {solved} of {step_count} frames: {self.reason}"


def run(
    text: str,
    *,
    held: str,
    thread_count: int = 1,
    times: FloatArray | None = None,
    keep: Path | None = None,
    time_limit_s: float | None = None,
) -> Printed:
    """Run CalculiX.

    Args:
        text: of the input file.
        held: set of nodes whose forces are printed; the displacements are those of SKIN.
        thread_count: of CalculiX's equation solver.
        times: whose tables are kept; None for all that are printed.
        keep: folder for its files; without it they are removed.
        time_limit_s: it is ended after this long, and what it has solved by then is returned.

    Raises:
        CalculixMissingError: it is not installed.
    """
    with tempfile.TemporaryDirectory(prefix="dotsim_reference_") as temporary:
        folder = Path(temporary) if keep is None else keep
        reason = execute(text, folder, thread_count=thread_count, time_limit_s=time_limit_s)
        tables = read_tables(folder / f"{JOB}.dat")
        efforts = read_efforts(folder / f"{JOB}.sta")
    moved, forces = (
        _at(times, [(time, rows) for *of, time, rows in tables if of == asked])
        for asked in (["displacements", "SKIN"], ["forces", held])
    )
    count = min(len(moved), len(forces)) if moved else len(forces)
    effort = [efforts.get(number, (0, 0)) for number in range(1, count + 1)]
    return Printed(moved[:count], forces[:count], effort, reason)


def _at(times: FloatArray | None, tables: list[tuple[float, FloatArray]]) -> list[FloatArray]:
    """Return the tables at times, as far as there are any; all of them without times."""
    if times is None or not tables:
        return [rows for _, rows in tables]
    apart = np.abs(times[:, None] - np.array([time for time, _ in tables]))
    return [
        tables[k][1]
        for k, left in zip(apart.argmin(1), apart.min(1), strict=True)
        if left < SAME_TIME
    ]


def solve(deck: Deck, **effort: Any) -> Solution:
    """Run CalculiX on a deck; further arguments are those of `run`.

    Raises:
        CalculixMissingError: it is not installed.
        CalculixError: it solved no step at all.
    """
    poses, times = deck.frame_poses(), deck.frame_times() if deck.frames else None
    printed = run(deck.text(), held="INDENTER", times=times, **effort)
    local = deck.indenter_nodes_m()
    steps = []
    for moved, held, pose, spent in zip(
        printed.moved, printed.held, poses[1:], printed.effort, strict=False
    ):
        displacement = np.zeros((deck.gel_node_count, 3))
        displacement[moved[:, 0].astype(np.int64) - 1] = moved[:, 1:] / MM
        node = held[:, 0].astype(np.int64) - 1 - deck.gel_node_count
        # The force that holds the indenter is opposite to the one that the gel exerts.
        force = -held[:, 1:]
        torque = np.cross(pose.apply(local[node]), force).sum(axis=0)
        steps.append(SolvedStep(displacement, force.sum(axis=0), torque, *spent))
    return Solution(tuple(steps), printed.failure(len(poses) - 1))


def solve_section(deck: AxisymmetricDeck, **effort: Any) -> Solution:
    """As `solve`, for a problem of two dimensions: node displacements have no y."""
    printed = run(deck.text(), held="INDENTER", **effort)
    steps = []
    for moved, held, spent in zip(printed.moved, printed.held, printed.effort, strict=True):
        displacement = np.zeros((len(deck.section.node_m), 3))
        node = moved[:, 0].astype(np.int64) - 1
        displacement[node, 0], displacement[node, 2] = moved[:, 1] / MM, moved[:, 2] / MM
        force = np.array([0.0, 0.0, -WEDGE_COUNT * float(held[:, 2].sum())])
        steps.append(SolvedStep(displacement, force, np.zeros(3), *spent))
    return Solution(tuple(steps), printed.failure(len(deck.depth_m) - 1))


def execute(text: str, folder: Path, *, thread_count: int, time_limit_s: float | None) -> str:
    """Run CalculiX on an input file in a folder, which is made; return why it ended before its end.

    Args:
        text: of the input file.
        folder: its files are left there.
        thread_count: of CalculiX's equation solver.
        time_limit_s: it is ended after this long.

    Raises:
        CalculixMissingError: it is not installed.
    """
    executable = calculix_path()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{JOB}.inp").write_text(text, encoding="ascii")
    environment = os.environ | {"OMP_NUM_THREADS": str(thread_count)}
    log_path = folder / f"{JOB}.log"
    with log_path.open("w", encoding="utf-8") as log:
        try:
            status = subprocess.run(
                [executable, "-i", JOB],
                cwd=folder,
                env=environment,
                stdout=log,
                stderr=subprocess.STDOUT,
                timeout=time_limit_s,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            return f"it was ended after {time_limit_s:.0f} s"
    errors = _ERROR.findall(log_path.read_text(encoding="utf-8", errors="replace"))
    if errors:
        return str(errors[-1]).strip()
    return "" if status == 0 else f"it ended with status {status}"


def read_tables(path: Path) -> list[tuple[str, str, float, FloatArray]]:
    """Return quantity, set, time and rows (node, x, y, z) of each table in a .dat file.

    Raises:
        ValueError: a row is not four numbers, as where the file ends early.
    """
    if not path.is_file():
        return []
    tables: list[tuple[str, str, float, list[list[float]]]] = []
    for number, line in enumerate(path.read_text(encoding="ascii").splitlines(), start=1):
        heading = _HEADING.match(line)
        if heading:
            tables.append((heading.group(1), heading.group(2), float(heading.group(3)), []))
        elif line.strip() and tables:
            tables[-1][3].append(_row_of(line, f"{path}, line {number}"))
    return [
        (quantity, name, time, np.array(rows, dtype=np.float64))
        for quantity, name, time, rows in tables
        if rows
    ]


def _row_of(line: str, place: str) -> list[float]:
    try:
        row = [float(cell) for cell in line.split()]
    except ValueError:
        row = []
    if len(row) != 4:
        raise ValueError(
            f"{place}: {line.strip()[:80]!r} is not a node and three numbers; solve the press again"
        )
    return row


def read_efforts(path: Path) -> dict[int, tuple[int, int]]:
    """Return increments and iterations of each step, by its number, from a .sta file."""
    efforts: dict[int, tuple[int, int]] = {}
    if not path.is_file():
        return efforts
    for line in path.read_text(encoding="ascii").splitlines():
        entries = line.split()
        if len(entries) == 7 and entries[0].isdigit():
            increments, iterations = efforts.get(int(entries[0]), (0, 0))
            efforts[int(entries[0])] = (increments + 1, iterations + int(entries[3]))
    return efforts
