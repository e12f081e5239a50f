# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Worker processes that serve the pools of many tests: what takes seconds is to start one.

The pools are as the package opens them, with work that is sent to a process of their own;
test/unit/test_worker_pool.py starts and ends the processes themselves.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any

from dotsim_ros.worker_pool.processes import open_worker_pool


class WarmWorkers:
    """A stock of pools of one worker, each of which has imported what its last users needed."""

    def __init__(self) -> None:
        self._all = ExitStack()
        self._free: list[ProcessPoolExecutor] = []

    def close(self) -> None:
        """End all workers."""
        self._all.close()

    @contextmanager
    def open_pool(
        self, count: int, initialize: Callable[..., None], *given: Any
    ) -> Iterator[ProcessPoolExecutor]:
        """See `open_worker_pool`; a pool of several workers is opened anew.

        A worker that an exception interrupts serves nobody any more.
        """
        if count > 1:
            with open_worker_pool(count, initialize, *given) as pool:
                yield pool
            return
        pool = self._free.pop() if self._free else self._started()
        pool.submit(begin_anew, dict(os.environ), initialize, given).result()
        yield pool
        self._free.append(pool)

    def _started(self) -> ProcessPoolExecutor:
        return self._all.enter_context(open_worker_pool(1, begin))


def begin() -> None:
    """Start a worker that nothing is asked of yet."""


def begin_anew(
    environment: Mapping[str, str], initialize: Callable[..., None], given: tuple[Any, ...]
) -> None:
    """Prepare a worker for a pool, as a process that is started for it would be."""
    os.environ.clear()
    os.environ.update(environment)
    initialize(*given)
