# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A frame's kernels on two cores: rows are cut into bands, which threads share.

Warp runs a kernel of a CPU in the thread that launches it, and lets go of Python's lock meanwhile,
so two threads run two launches at once. The calling thread takes a band itself, and every band that
the other thread has not begun: where that one gets no core, the caller waits for nobody. What a
band writes depends on no other band, so any number of them gives the same to the last bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from itertools import pairwise

from dotsim_ros.io import tracing
from dotsim_ros.io.cores import available_core_count
from dotsim_ros.io.warp_runtime import wp

MOST_THREADS = 2
"""The simulator is made for two cores; more threads have not been measured."""


def thread_count() -> int:
    """Return how many threads share a frame's work on a CPU."""
    return min(MOST_THREADS, available_core_count())


def cut(size: int, count: int, *, smallest: int = 1) -> list[tuple[int, int]]:
    """Return bands from one number to before another, in order and nearly equal.

    Args:
        size: of the whole.
        count: of bands; fewer where they would become too small.
        smallest: size of a band.
    """
    count = max(1, min(count, size // smallest))
    ends = [size * band // count for band in range(count + 1)]
    return list(pairwise(ends))


def launch_bands(bands: list[tuple[int, int]], record: Callable[[int, int], wp.Launch]) -> None:
    """Launch a kernel on every band, and return once all have ended.

    Args:
        bands: of `cut`.
        record: gives the launch of the band from one number to before another, not yet run
            (`record_cmd` of `warp.launch`).
    """
    own, *others = bands
    # Warp loads a kernel's module while a launch is recorded: here, where one thread does it.
    shared = [_share(record(*band)) for band in others]
    record(*own).launch()
    for launch, future in reversed(shared):
        if future is None or future.cancel():
            launch.launch()
        else:
            future.result()


def _share(launch: wp.Launch) -> tuple[wp.Launch, Future[None] | None]:
    """Return a launch and what the other thread makes of it; None where there is no such thread."""
    try:
        return launch, _other_thread(os.getpid()).submit(_run, launch)
    except RuntimeError:
        # No thread can be started, or none any more: the interpreter is ending.
        return launch, None


def _run(launch: wp.Launch) -> None:
    with tracing.span("band"):
        launch.launch()


@cache
def _other_thread(process: int) -> ThreadPoolExecutor:
    """Return the second thread of a process; a fork has none, and starts its own."""
    return ThreadPoolExecutor(MOST_THREADS - 1, thread_name_prefix=f"bands of {process}")
