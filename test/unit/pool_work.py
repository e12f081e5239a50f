# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What workers do in the tests of pools; a module of its own, so that they can import it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

_given: np.ndarray | None = None


def begin(given: np.ndarray) -> None:
    global _given
    _given = given


def refuse() -> None:
    raise ValueError("no gel to press")


def die_at_the_beginning() -> None:
    die()


def total(number: int, added: np.ndarray) -> tuple[int, float]:
    return number, number + float(_given.sum() + added.sum())


def fail(number: int) -> None:
    raise KeyError(f"no press {number}")


def die() -> None:
    os.kill(os.getpid(), 9)


def place(number: int, seconds: float) -> tuple[int, str]:
    """Return the number and where it was worked on, after a while."""
    import ray

    time.sleep(seconds)
    return number, ray.get_runtime_context().get_node_id()


def large(number: int) -> np.ndarray:
    return np.full(200_000, float(number))


def is_there(pid: int) -> bool:
    """Return whether a process runs: it is neither gone nor waits for its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_until(happened: Callable[[], bool], patience_s: float) -> None:
    end_s = time.monotonic() + patience_s
    while not happened():
        assert time.monotonic() < end_s, "it has not happened"
        time.sleep(0.05)


def tell_and_sleep(_number: int, path: Path) -> None:
    path.write_text(str(os.getpid()), encoding="utf-8")
    time.sleep(600.0)
