# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pools of processes that never outlive who started them.

Each worker holds hundreds of megabytes. It reads a pipe whose other end its starter alone holds:
when the starter closes it, or ends, by whatever signal, the worker ends at once.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

from dotsim_ros.cores import keep_single_threaded


class Worker(SpawnProcess):
    """A process that the terminal's Ctrl-C does not reach: who started it ends it."""

    def start(self) -> None:
        # A mask is inherited; a handler would come too late for the seconds of the imports.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class WorkerContext(SpawnContext):
    """Spawns: forked children would share the threads and locks of Warp."""

    Process = Worker


def _begin(starter: Connection, initialize: Callable[..., None], given: tuple[Any, ...]) -> None:
    threading.Thread(target=_end_with, args=(starter,), daemon=True).start()
    initialize(*given)
    # By now the libraries are loaded whose threads are meant.
    keep_single_threaded()


def _end_with(starter: Connection) -> None:
    """Wait until the starter's end of the pipe is closed, and end this process."""
    try:
        starter.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)


@contextmanager
def open_worker_pool(
    count: int, initialize: Callable[..., None], *given: Any
) -> Iterator[ProcessPoolExecutor]:
    """Open a pool of processes.

    Where the block ends with an exception, Ctrl-C among them, what the workers are at is broken
    off.

    Args:
        count: of processes; each is started when it is first needed.
        initialize: called once in each, at module level so that it can be sent.
        given: its arguments.

    Raises:
        OSError: a worker was ended from outside, most likely for want of memory.
    """
    theirs, ours = multiprocessing.Pipe(duplex=False)
    try:
        with ProcessPoolExecutor(
            count,
            mp_context=WorkerContext(),
            initializer=_begin,
            initargs=(theirs, initialize, given),
        ) as pool:
            try:
                yield pool
            except BaseException:
                ours.close()
                pool.shutdown(wait=True, cancel_futures=True)
                raise
    except BrokenProcessPool as error:
        raise OSError(
            f"one of {count} worker processes was ended from outside, most likely because memory "
            "ran out; expected all to work to the end: give fewer with --workers; the same command "
            "goes on from what is solved"
        ) from error
    finally:
        ours.close()
        theirs.close()
