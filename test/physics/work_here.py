# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A pool whose work is done at once in this process, as it would be in one of its own.

What is sent and what comes back is pickled all the same, so that work which could not be sent fails
here too. For work whose length a test must set: a process of its own would know nothing of that.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any


class WorkHere(Executor):
    """Does each task when it is submitted."""

    def submit(self, task: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        """See `Executor.submit`."""
        done: Future[Any] = Future()
        sent, arguments, keywords = pickle.loads(pickle.dumps((task, given, named)))
        try:
            done.set_result(pickle.loads(pickle.dumps(sent(*arguments, **keywords))))
        except Exception as error:
            done.set_exception(error)
        return done


@contextmanager
def open_pool_here(_count: int, initialize: Callable[..., None], *given: Any) -> Iterator[Executor]:
    """See `open_worker_pool`."""
    initialize(*given)
    yield WorkHere()
