# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The cores of the machine that this process may use, and on how many linear algebra runs.

The threads of one BLAS call wait for each other in a loop. The gel's matrices are too small to gain
by more than one: a frame takes twice as long on two idle cores, and thirty times as long next to
other processes. And another number of threads makes sums in another order, with other last digits.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any


def available_core_count() -> int:
    """Return on how many cores this process may run."""
    # Linux and some others alone tell it.
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


@cache
def _libraries() -> Any:
    """Return what controls the libraries that are loaded: a look for them takes milliseconds."""
    # Those that the gel uses must be there by now.
    import numpy as np  # noqa: F401
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas").lib_controllers


def _set(counts: Sequence[int]) -> None:
    for library, count in zip(_libraries(), counts, strict=True):
        # One thread may set the number for all, the first that did, until another takes that over
        # (threadpoolctl 3.8); the one that ends the last block need not be the one that began.
        take_over = getattr(library, "clear_controlling_thread", lambda **_: None)
        take_over(force=True)
        library.set_num_threads(count)
        take_over(force=True)


_LOCK = threading.Lock()
_blocks = 0
_before: list[int] = []


@contextmanager
def single_threaded() -> Iterator[None]:
    """Keep NumPy's and SciPy's linear algebra on one thread within the block, or the function that
    this decorates; the number of before comes back when the last block, of any thread, ends.

    It is one number for the whole process: other threads have one, too, while a block lasts. An
    OpenBLAS that was built with OpenMP, as the wheels' are not, has a number for each thread.
    """
    global _blocks, _before
    with _LOCK:
        if _blocks == 0:
            _before = [library.num_threads for library in _libraries()]
            _set([1] * len(_before))
        _blocks += 1
    try:
        yield
    finally:
        with _LOCK:
            _blocks -= 1
            if _blocks == 0:
                _set(_before)


def keep_single_threaded() -> None:
    """Keep the linear algebra of this process on one thread for good: for what holds nothing else,
    such as a node, or a worker once it has loaded all that it works with."""
    global _before
    with _LOCK:
        _before = [1] * len(_libraries())
        _set(_before)
