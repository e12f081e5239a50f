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
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

from dotsim_ros.io.cores import keep_single_threaded


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


_failure: Exception | None = None
"""What this worker's initializer raised."""


def _begin(
    starter: Connection, begun: Connection, initialize: Callable[..., None], given: tuple[Any, ...]
) -> None:
    global _failure
    threading.Thread(target=_end_with, args=(starter,), daemon=True).start()
    begun.send_bytes(b"begun")
    try:
        initialize(*given)
    except Exception as error:
        _failure = error
        return
    # By now the libraries are loaded whose threads are meant.
    keep_single_threaded()


def _work(function: Callable[..., Any], /, *given: Any, **named: Any) -> Any:
    if _failure is not None:
        raise _failure
    return function(*given, **named)


class _Pool(ProcessPoolExecutor):
    """Answers each task with what its worker's initializer raised, where it did: raised there, it
    would break the pool without a word of what it was."""

    def submit(self, function: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        """See `Executor.submit`."""
        return super().submit(_work, function, *given, **named)


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
    off. What `initialize` raises in a worker is what its tasks raise.

    Args:
        count: of processes; each is started when it is first needed.
        initialize: called once in each, at module level so that it can be sent.
        given: its arguments.

    Raises:
        OSError: a worker was ended from outside, most likely for want of memory, or all ended
            before any had begun, most likely because the script that opens the pool has no
            `if __name__ == "__main__":`.
    """
    theirs, ours = multiprocessing.Pipe(duplex=False)
    heard, begun = multiprocessing.Pipe(duplex=False)
    try:
        with _Pool(
            count,
            mp_context=WorkerContext(),
            initializer=_begin,
            initargs=(theirs, begun, initialize, given),
        ) as pool:
            try:
                yield pool
            except BaseException:
                ours.close()
                pool.shutdown(wait=True, cancel_futures=True)
                raise
    except BrokenProcessPool as error:
        if not heard.poll():
            raise OSError(
                "the worker processes ended before one had begun, most likely because the script "
                'that starts them has no `if __name__ == "__main__":`: each worker imports the '
                "script, and would start workers again; expected it around all that the script "
                "does. Otherwise see what they said above, or memory ran out for "
                f"{count} of them: give fewer"
            ) from error
        raise OSError(
            f"one of {count} worker processes was ended from outside, most likely because memory "
            "ran out; expected all to work to the end: give fewer with --workers; the same command "
            "goes on from what is solved"
        ) from error
    finally:
        for end in (ours, theirs, heard, begun):
            end.close()
