# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A pool whose workers are those of a Ray cluster, and that loses nothing when one of them dies.

Python's thread pool has the queue: each of its threads takes a task, gives it to Ray and waits for
the answer. Ray finds a worker and keeps the large arrays. A task whose worker dies is given to Ray
again, a few times: Ray's own retries of what ran out of memory would never end.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import threading
import uuid
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from ray import cloudpickle

import dotsim_ros
from dotsim_ros.io.printable import cut, one_line
from dotsim_ros.io.provenance import source_hash
from dotsim_ros.io.worker_pool import ray_worker
from dotsim_ros.io.worker_pool.ray_worker import Expected

MOST_DEATHS = 3
"""A task that so many workers died of is not tried again."""
START_S = 120.0
"""So long no worker, and no CPU free for one: there will be none."""
LAST_WORDS = 400
CLOSED = "the pool of workers was closed before this was done"
LEAST_BYTES = 64 * 1024
"""Smaller arrays travel with the task: to find them elsewhere takes longer than to copy them."""
KEPT_BYTES = 1 << 30
"""Arrays that are kept for tasks to come; those which were used last stay."""
Packed = tuple[bytes, tuple[Any, ...]]
"""Pickled work with numbers in place of its large arrays, and what Ray knows these by."""
_log = logging.getLogger(__name__)


@contextmanager
def open_ray_pool(
    ray: Any,
    count: int,
    initialize: Callable[..., None],
    given: tuple[Any, ...],
    reads: Sequence[Path],
    writes: Sequence[Path],
) -> Iterator[RayPool]:
    """Open a pool of workers on Ray.

    Args:
        ray: the module, connected.
        count: of workers.
        initialize: called once in each.
        given: its arguments.
        reads: folders that the work reads.
        writes: folders that it writes into.
    """
    with _marked(writes) as marks:
        needed = (*(str(folder.resolve()) for folder in reads), *marks)
        pool = RayPool(ray, count, initialize, given, needed)
        try:
            yield pool
            pool.shutdown()
        finally:
            pool.end()


@contextmanager
def _marked(folders: Sequence[Path]) -> Iterator[tuple[str, ...]]:
    """Leave a file in each folder, by which workers see that it is the same on their machine."""
    name = f".shared-{uuid.uuid4().hex}"
    marks = [folder.resolve() / name for folder in folders]
    try:
        for mark in marks:
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.touch()
        yield tuple(map(str, marks))
    finally:
        for mark in marks:
            mark.unlink(missing_ok=True)


class RayPool(ThreadPoolExecutor):
    """A `concurrent.futures.Executor` on Ray; use `open_pool`.

    Attributes:
        task_bytes: of all tasks, without the arrays that are shared.
    """

    def __init__(
        self,
        ray: Any,
        count: int,
        initialize: Callable[..., None],
        given: tuple[Any, ...],
        needed: tuple[str, ...],
    ) -> None:
        super().__init__(count, thread_name_prefix="ray pool")
        self._ray = ray
        # Machines of the cluster need not have this module for it to travel there.
        ray.cloudpickle.register_pickle_by_value(ray_worker)
        remote = ray.remote(num_cpus=1, max_retries=0)
        self._check, self._work = remote(ray_worker.check), remote(ray_worker.work)
        self._expected = ray.put(expected_of(needed))
        self._shelf = ArrayShelf(ray.put)
        data, arrays = self._shelf.pack((initialize, given))
        self._beginning = self._expected, uuid.uuid4().hex, ray.put(data), len(arrays)
        self._given_arrays = arrays
        self._lock, self._first_lock = threading.Lock(), threading.Lock()
        self._running: set[Any] = set()
        self._is_placed = self._is_ended = False
        self.task_bytes = 0

    @property
    def shared_bytes(self) -> int:
        """Bytes of the arrays that all workers share, each counted once."""
        return self._shelf.put_bytes

    def submit(self, function: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        """Return the future of a function's answer."""
        work = self._shelf.pack((function, given, named))
        self.task_bytes += len(work[0])
        return super().submit(self._do, work)

    def end(self) -> None:
        """Break off what the workers are at, and cancel what waits."""
        with self._lock:
            self._is_ended = True
            running = list(self._running)
        # Before any thread can take another task.
        self.shutdown(wait=False, cancel_futures=True)
        for asked in running:
            self._ray.cancel(asked, force=True)
        self.shutdown()

    def _do(self, work: Packed) -> Any:
        """Return the answer to a task.

        Raises:
            OSError: the pool has ended, there is no place for a worker, or worker after worker died
                of the task.
            Exception: of the task, or of the initializer.
        """
        data, arrays = work
        with self._first_lock:
            if not self._is_placed:
                self._answer(self._check, self._expected)
                self._is_placed = True
        return self._answer(self._work, *self._beginning, data, *self._given_arrays, *arrays)

    def _answer(self, function: Any, *given: Any) -> Any:
        """Return what a function gives on some worker, another one where the first dies."""
        exceptions = self._ray.exceptions
        for _ in range(MOST_DEATHS):
            with self._lock:
                if self._is_ended:
                    raise OSError(CLOSED)
                asked = function.remote(*given)
                self._running.add(asked)
            try:
                while not self._ray.wait([asked], timeout=START_S)[0]:
                    self._look_for_places()
                return self._ray.get(asked)
            except exceptions.RayTaskError as error:
                raise (error.cause if isinstance(error.cause, Exception) else error) from error
            except exceptions.RayError as error:
                if self._is_ended:
                    raise OSError(CLOSED) from None
                # Ray writes a page about each death.
                died = cut(one_line(error), LAST_WORDS)
                _log.warning("a worker on Ray died (%s); another takes its place", died)
            finally:
                self._running.discard(asked)
        raise OSError(
            f"{MOST_DEATHS} workers died of the same task on Ray ({died}); expected all to work to "
            "the end; most likely memory ran out: start Ray with fewer CPUs on each machine (`ray "
            "start --num-cpus`); the same command goes on from what is solved"
        )

    def _look_for_places(self) -> None:
        """Give up where no worker has found a machine, and none has a CPU for one.

        Raises:
            OSError: so it is.
        """
        total = self._ray.cluster_resources().get("CPU", 0.0)
        free = self._ray.available_resources().get("CPU", 0.0)
        if not self._is_placed and free < 1.0:
            raise OSError(
                f"no worker could be started on Ray in {START_S:.0f} s: the cluster has "
                f"{total:.0f} CPUs and {free:.0f} of them free, expected one at least; end what "
                "holds them, or add machines with `ray start --address=...`; the same command goes "
                "on from what is solved"
            )


class ArrayShelf:
    """Keeps the large arrays of tasks where all workers find them.

    A task is small, what it looks at may not be: the same measured press, mesh or skin is part of
    hundreds of tasks. Arrays are told apart by their content, not by their name, so that one which
    is read twice is kept once, and one which has changed in between is another.

    Args:
        put: places an array, and returns what Ray knows it by.

    Attributes:
        put_bytes: of all arrays that were placed.
    """

    def __init__(self, put: Callable[[Any], Any]) -> None:
        self._put = put
        self._kept: OrderedDict[bytes, tuple[Any, int]] = OrderedDict()
        self._kept_bytes = self.put_bytes = 0

    def pack(self, work: Any) -> Packed:
        """Return work whose large arrays are on the shelf."""
        out = io.BytesIO()
        packer = _Packer(out, self._place_of)
        packer.dump(work)
        return out.getvalue(), tuple(place for _, place in packer.found.values())

    def _place_of(self, key: bytes, array: np.ndarray[Any, Any]) -> Any:
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key][0]
        place = self._put(array)
        self.put_bytes += array.nbytes
        self._kept[key] = place, array.nbytes
        self._kept_bytes += array.nbytes
        while self._kept_bytes > KEPT_BYTES and len(self._kept) > 1:
            self._kept_bytes -= self._kept.popitem(last=False)[1][1]
        return place


class _Packer(cloudpickle.Pickler):
    """Writes a number in place of each large array; `ray_worker.unpack` reads them."""

    def __init__(self, out: io.BytesIO, place_of: Callable[[bytes, Any], Any]) -> None:
        super().__init__(out)
        self._place_of = place_of
        self.found: dict[bytes, tuple[int, Any]] = {}

    def persistent_id(self, thing: Any) -> int | None:
        if type(thing) is not np.ndarray or thing.nbytes < LEAST_BYTES or thing.dtype.hasobject:
            return None
        form = f"{thing.dtype}{thing.shape}{thing.flags.f_contiguous}".encode()
        key = hashlib.blake2b(thing.tobytes(order="A") + form, digest_size=16).digest()
        if key not in self.found:
            self.found[key] = len(self.found), self._place_of(key, thing)
        return self.found[key][0]


def expected_of(needed: tuple[str, ...]) -> Expected:
    """Return what a worker must find: this package, and some files and folders."""
    return Expected("dotsim_ros", dotsim_ros.__version__, source_hash("."), os.getcwd(), needed)
