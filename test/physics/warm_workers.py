# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Worker processes that serve the pools of many tests: what takes seconds is to start one.

The pools are as the package opens them, with work that is sent to a process of their own;
test/unit/test_worker_pool.py starts and ends the processes themselves.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
from shared_work import share

from dotsim_ros.io.worker_pool.processes import open_worker_pool


class WarmWorkers:
    """A stock of workers, each of which has imported what its last users needed."""

    def __init__(self) -> None:
        self._all = ExitStack()
        self._free: list[Executor] = []

    def close(self) -> None:
        """End all workers."""
        self._all.close()

    def take(self) -> Executor:
        """Return a worker that nobody uses, or start one."""
        return (
            self._free.pop() if self._free else self._all.enter_context(open_worker_pool(1, begin))
        )

    @contextmanager
    def open_pool(
        self, count: int, initialize: Callable[..., None], *given: Any
    ) -> Iterator[Executor]:
        """See `open_worker_pool`; a pool of several workers is opened again.

        A worker that an exception interrupts serves nobody any more.
        """
        if count > 1:
            with open_worker_pool(count, initialize, *given) as pool:
                yield pool
            return
        borrowed = Borrowed(self.take, initialize, given)
        yield borrowed
        if borrowed.worker is not None:
            self._free.append(borrowed.worker)


class Borrowed(Executor):
    """A worker of the stock, taken and prepared when it is first needed.

    Args:
        take: gives the worker.
        initialize: called in it first.
        given: its arguments.

    Attributes:
        worker: None before it is needed.
    """

    def __init__(
        self, take: Callable[[], Executor], initialize: Callable[..., None], given: tuple[Any, ...]
    ) -> None:
        self._take, self._initialize, self._given = take, initialize, given
        self.worker: Executor | None = None

    def submit(self, task: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        """See `Executor.submit`."""
        if self.worker is None:
            self.worker = self._take()
            environment = dict(os.environ)
            self.worker.submit(restart, environment, self._initialize, self._given).result()
        return self.worker.submit(task, *given, **named)


def begin() -> None:
    """Start a worker that nothing is asked of yet, whose tasks share their work as tests do."""
    share(pytest.MonkeyPatch())


def restart(
    environment: Mapping[str, str], initialize: Callable[..., None], given: tuple[Any, ...]
) -> None:
    """Prepare a worker for a pool, as a process that is started for it would be."""
    os.environ.clear()
    os.environ.update(environment)
    initialize(*given)
