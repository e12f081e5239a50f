# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs targets in processes that may hang, grow or die, and keeps what was found."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

from fuzz.target import Target

HANG_S = 30.0
GROWTH_BYTES = 2 * 2**30
_FORKING = threading.Lock()


@dataclass(frozen=True)
class Found:
    """A case that went wrong.

    Attributes:
        target, case: which.
        words: what went wrong, its last line first.
    """

    target: str
    case: int
    words: str


@dataclass(frozen=True)
class TargetSummary:
    """What became of a target: how many cases were tried, and the findings."""

    target: str
    case_count: int
    found: tuple[Found, ...]


def prepare_in(target: Target, folder: Path) -> tuple[object, Path]:
    """Prepare a target in a folder; return what it prepared, and a folder for its cases."""
    prepared, cases = folder / "prepared", folder / "cases"
    for each in (prepared, cases):
        each.mkdir(exist_ok=True)
    return target.prepare(prepared), cases


def attempt(target: Target, prepared: object, case: int, parent: Path) -> str | None:
    """Run one case in an empty folder of `parent`; return what went wrong, or None."""
    folder = Path(tempfile.mkdtemp(prefix=f"fuzz_{target.name}_", dir=parent))
    try:
        target.attempt(prepared, Random(f"{target.name} {case}"), folder)
    except MemoryError:
        return f"MemoryError: more than {GROWTH_BYTES} bytes\n{traceback.format_exc()}"
    except Exception as error:
        return f"{type(error).__name__}: {error}\n{traceback.format_exc()}"
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return None


def run_target(target: Target, *, seconds: float, first_case: int) -> TargetSummary:
    """Try cases until the time is over; a case that hangs or dies costs one process."""
    begun = time.monotonic()
    case, count = first_case, 0
    found: list[Found] = []
    # A process that is killed leaves its case's folder, which goes with this one.
    with tempfile.TemporaryDirectory(prefix="fuzz_run_") as folder:
        while (left_s := seconds - (time.monotonic() - begun)) > 0.0:
            case, tried, more = _run_process(target, Path(folder), case, left_s)
            count += tried
            found += more
    return TargetSummary(target.name, count, tuple(found))


def _run_process(
    target: Target, folder: Path, case: int, seconds: float
) -> tuple[int, int, list[Found]]:
    """Return the next case, how many were tried, and what was found, until a process ends."""
    context = multiprocessing.get_context("fork")
    # Another process forked in between would keep this one's pipe open beyond its end.
    with _FORKING:
        ours, theirs = multiprocessing.Pipe(duplex=False)
        process = context.Process(target=_work, args=(target, folder, case, seconds, theirs))
        process.start()
        theirs.close()
    found: list[Found] = []
    tried = 0
    # The first answer says that all is prepared.
    current: int | None = None
    while True:
        try:
            if not ours.poll(HANG_S if current is not None else 20 * HANG_S):
                os.kill(process.pid or 0, signal.SIGKILL)
                process.join()
                words = f"no answer within {HANG_S:g} s"
                found.append(Found(target.name, case if current is None else current, words))
                break
            started, wrong = ours.recv()
        except EOFError:
            process.join()
            if process.exitcode:
                words = f"the process died ({process.exitcode})"
                found.append(Found(target.name, case if current is None else current, words))
                tried += 1
            break
        if wrong is not None:
            found.append(Found(target.name, started, wrong))
        tried += started is not None and current is not None
        current = case if started is None else started + 1
    return (case if current is None else current) + 1, tried, found


def _work(target: Target, folder: Path, case: int, seconds: float, out: Connection) -> None:
    # What readers print must not hide what was found.
    with contextlib.suppress(OSError):
        quiet = os.open(os.devnull, os.O_WRONLY)
        os.dup2(quiet, 1)
        os.dup2(quiet, 2)
        sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    prepared, cases = prepare_in(target, folder)
    limit_growth()
    out.send((None, None))
    begun = time.monotonic()
    while time.monotonic() - begun < seconds:
        out.send((case, attempt(target, prepared, case, cases)))
        case += 1
    os._exit(0)


def limit_growth() -> None:
    """Let this process take `GROWTH_BYTES` more than it has; beyond, it meets MemoryError."""
    sizes = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    data_bytes = 1024 * int(sizes["VmData"].split()[0])
    resource.setrlimit(resource.RLIMIT_DATA, (data_bytes + GROWTH_BYTES,) * 2)
