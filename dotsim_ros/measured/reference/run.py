"""CalculiX as a separate process: found, run, and its printed results read."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.measured.reference.deck import MM, Deck

FloatArray = NDArray[np.float64]

EXECUTABLES = ("ccx", "ccx_2.21", "ccx_2.22", "ccx_2.20")
INSTALL = "apt-get install calculix-ccx"
JOB = "press"

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
    """Return the version that CalculiX tells of itself.

    Raises:
        CalculixMissingError: it is not installed.
    """
    done = subprocess.run([calculix_path(), "-v"], capture_output=True, text=True, check=False)
    found = re.search(r"Version\s+(\S+)", done.stdout)
    return found.group(1) if found else "unknown"


def solve(
    deck: Deck,
    *,
    thread_count: int = 1,
    keep: Path | None = None,
    time_limit_s: float | None = None,
) -> Solution:
    """Run CalculiX on a deck.

    Args:
        deck: what to compute.
        thread_count: of CalculiX's equation solver.
        keep: folder for its files; without it they are removed.
        time_limit_s: it is ended after this long, and what it has solved by then is returned.

    Raises:
        CalculixMissingError: it is not installed.
        CalculixError: it solved no step at all.
    """
    executable = calculix_path()
    with tempfile.TemporaryDirectory(prefix="dotsim_reference_") as temporary:
        folder = Path(temporary) if keep is None else keep
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{JOB}.inp").write_text(deck.text(), encoding="ascii")
        environment = os.environ | {"OMP_NUM_THREADS": str(thread_count)}
        log_path = folder / f"{JOB}.log"
        late = ""
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
                status, late = -1, f"it was ended after {time_limit_s:.0f} s"
        steps = read_steps(folder, deck)
        if status == 0 and len(steps) == len(deck.poses) - 1:
            return Solution(steps)
        told = _ERROR.findall(log_path.read_text(encoding="utf-8", errors="replace"))
        failure = late or (told[-1].strip() if told else f"it ended with status {status}")
        if not steps:
            raise CalculixError(f"CalculiX solved no step: {failure}")
        return Solution(steps, failure)


def read_steps(folder: Path, deck: Deck) -> tuple[SolvedStep, ...]:
    """Return the steps whose results are in the folder of a run."""
    efforts = _efforts(folder / f"{JOB}.sta")
    skin: list[FloatArray] = []
    forces: list[FloatArray] = []
    for quantity, name, rows in _tables(folder / f"{JOB}.dat"):
        if quantity == "displacements" and name == "SKIN":
            skin.append(rows)
        elif quantity == "forces" and name == "INDENTER":
            forces.append(rows)
    local = deck.indenter_nodes_m()
    steps = []
    for index, (moved, reaction) in enumerate(zip(skin, forces, strict=False)):
        displacement = np.zeros((deck.gel_node_count, 3))
        displacement[moved[:, 0].astype(np.int64) - 1] = moved[:, 1:] / MM
        node = reaction[:, 0].astype(np.int64) - 1 - deck.gel_node_count
        # The force that holds the indenter is opposite to the one that the gel exerts.
        force = -reaction[:, 1:]
        arm = deck.poses[index + 1].apply(local[node])
        increments, iterations = efforts.get(index + 1, (0, 0))
        steps.append(
            SolvedStep(
                displacement,
                force.sum(axis=0),
                np.cross(arm, force).sum(axis=0),
                increments,
                iterations,
            )
        )
    return tuple(steps)


def _tables(path: Path) -> list[tuple[str, str, FloatArray]]:
    """Return quantity, set and rows (node, x, y, z) of each table in a .dat file."""
    if not path.is_file():
        return []
    tables: list[tuple[str, str, list[str]]] = []
    for line in path.read_text(encoding="ascii").splitlines():
        heading = _HEADING.match(line)
        if heading:
            tables.append((heading.group(1), heading.group(2), []))
        elif line.strip() and tables:
            tables[-1][2].append(line)
    return [
        (quantity, name, np.array([row.split() for row in rows], dtype=np.float64))
        for quantity, name, rows in tables
        if rows
    ]


def _efforts(path: Path) -> dict[int, tuple[int, int]]:
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
