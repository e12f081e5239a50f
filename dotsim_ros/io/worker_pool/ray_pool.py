# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A pool whose workers are actors of a Ray cluster, and lose nothing when one of them dies.

Each worker has one task at a time, and the rest wait here, not in the cluster: a worker that dies
takes nothing along but what it was at, which another does again. Ray would bind that task to the
place where the same worker may start again, and if its machine is gone there may never be one.
"""

from __future__ import annotations

import logging
import os
import threading
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import dotsim_ros
from dotsim_ros.io.printable import cut, one_line
from dotsim_ros.io.provenance import source_hash
from dotsim_ros.io.worker_pool import ray_worker
from dotsim_ros.io.worker_pool.ray_worker import Expected, RayWorker
from dotsim_ros.io.worker_pool.sharing import ArrayShelf, Packed

MOST_DEATHS = 3
"""A task that so many workers died of is not tried again, nor are workers started again where so
many times their number died at their beginning."""
START_S = 120.0
"""So long no worker, and no CPU free for one: there will be none."""
LAST_WORDS = 400
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
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


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


@dataclass(eq=False)
class _Task:
    future: Future[Any]
    work: Packed
    deaths: int = 0


@dataclass(eq=False)
class _Member:
    """A worker.

    Attributes:
        actor: in the cluster.
        is_placed: whether a machine has room for it.
        task: that it is at; None while it begins, or is idle.
    """

    actor: Any
    is_placed: bool = False
    task: _Task | None = None


@dataclass(frozen=True)
class _Heard:
    """News of a worker: the answer to one of its methods, or its death."""

    member: _Member
    method: str
    answer: Future[Any]


@dataclass(frozen=True)
class _End:
    """Word that no task comes any more."""

    breaks_off: bool


class RayPool(Executor):
    """A `concurrent.futures.Executor` on Ray; use `open_pool`.

    Attributes:
        deaths: workers that died.
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
        self._ray, self._count = ray, count
        # Machines of the cluster need not have this module for it to travel there.
        ray.cloudpickle.register_pickle_by_value(ray_worker)
        self._worker_class = ray.remote(num_cpus=1, max_restarts=0)(RayWorker)
        self._expected = ray.put(_expected(needed))
        self._shelf = ArrayShelf(ray.put)
        beginning = self._shelf.pack((initialize, given))
        self._beginning = ray.put(beginning.data), *beginning.arrays
        self._events: SimpleQueue[_Task | _Heard | _End] = SimpleQueue()
        self._waiting: deque[_Task] = deque()
        self._members: set[_Member] = set()
        self._starting: set[_Member] = set()
        self._idle: deque[_Member] = deque()
        self._broken: BaseException | None = None
        self._is_closed = False
        self._submitting = threading.Lock()
        self.deaths = self.task_bytes = self._false_starts = 0
        self._thread = threading.Thread(target=self._run, name="ray pool", daemon=True)
        self._thread.start()

    @property
    def shared_bytes(self) -> int:
        """Bytes of the arrays that all workers share, each counted once."""
        return self._shelf.put_bytes

    def submit(self, function: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        """Return the future of a function's answer.

        Raises:
            RuntimeError: the pool is closed.
        """
        task = _Task(Future(), self._shelf.pack((function, given, named)))
        self.task_bytes += len(task.work.data)
        with self._submitting:
            if self._is_closed:
                raise RuntimeError("the pool is closed; open another one") from self._broken
            self._events.put(task)
        return task.future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Do what was submitted, or break it off, and end the workers."""
        with self._submitting:
            self._is_closed = True
            self._events.put(_End(cancel_futures))
        if wait:
            self._thread.join()

    def _run(self) -> None:
        """Hand out tasks until the end; all but `submit` and `shutdown` is done in this thread."""
        is_ending = False
        try:
            while not (is_ending and self._is_done()):
                try:
                    event = self._events.get(timeout=START_S if self._lacks_place() else None)
                except Empty:
                    self._look_for_places()
                    continue
                match event:
                    case _Task():
                        self._waiting.append(event)
                    case _Heard():
                        self._hear(event)
                    case _End():
                        is_ending = True
                        if event.breaks_off:
                            break
                self._hand_out()
        except BaseException as error:
            self._broken = error
        finally:
            self._end()

    def _is_done(self) -> bool:
        working = len(self._members) - len(self._starting) - len(self._idle)
        return not self._waiting and not working

    def _lacks_place(self) -> bool:
        """Return whether tasks wait and no worker has found a machine."""
        return bool(self._waiting) and not any(member.is_placed for member in self._members)

    def _hand_out(self) -> None:
        while self._waiting and self._idle:
            task = self._waiting.popleft()
            # A future whose worker died is running already.
            if not task.deaths and not task.future.set_running_or_notify_cancel():
                continue
            member = self._idle.popleft()
            member.task = task
            self._ask(member, "work", task.work.data, *task.work.arrays)
        wanted = len(self._waiting) - len(self._starting)
        for _ in range(min(wanted, self._count - len(self._members))):
            member = _Member(self._worker_class.remote())
            self._members.add(member)
            self._starting.add(member)
            self._ask(member, "check", self._expected)
            self._ask(member, "begin", *self._beginning)

    def _ask(self, member: _Member, method: str, *given: Any) -> None:
        answer = getattr(member.actor, method).remote(*given)
        answer.future().add_done_callback(
            lambda found: self._events.put(_Heard(member, method, found))
        )

    def _hear(self, heard: _Heard) -> None:
        """Take an answer of a worker, or the news of its death.

        Raises:
            OSError: its machine is not as expected, or workers die again and again.
            Exception: of the initializer.
        """
        member, error = heard.member, heard.answer.exception()
        if member not in self._members:
            return
        if isinstance(error, self._ray.exceptions.RayTaskError):
            # An initializer that fails, or an answer that cannot be sent.
            error = error.cause if isinstance(error.cause, Exception) else error
            if member.task is None:
                raise error
            member.task.future.set_exception(error)
        elif error is not None:
            self._lose(member, error)
            return
        elif heard.method == "check":
            if heard.answer.result():
                raise OSError(heard.answer.result())
            member.is_placed = True
            return
        elif member.task is not None:
            is_done, answer = heard.answer.result()
            (member.task.future.set_result if is_done else member.task.future.set_exception)(answer)
        if heard.method == "begin":
            self._starting.discard(member)
            self._false_starts = 0
        member.task = None
        self._idle.append(member)

    def _lose(self, member: _Member, error: BaseException) -> None:
        """Go on without a worker.

        Raises:
            OSError: workers die before they have begun, again and again.
        """
        self._members.discard(member)
        with suppress(ValueError):
            self._idle.remove(member)
        # It may live on where only its answer was lost.
        self._kill(member)
        self.deaths += 1
        task, has_begun = member.task, member not in self._starting
        self._starting.discard(member)
        _log.warning(
            "a worker on Ray died (%s); %s",
            _last_words(error),
            "what it was at is done by another" if task else "another takes its place",
        )
        if task is None:
            self._false_starts += not has_begun
            if self._false_starts >= MOST_DEATHS * self._count:
                what = f"{self._false_starts} workers died before they had begun"
                raise OSError(_deadly(what, error))
            return
        task.deaths += 1
        if task.deaths < MOST_DEATHS:
            self._waiting.appendleft(task)
        else:
            what = f"{task.deaths} workers died of the same task"
            task.future.set_exception(OSError(_deadly(what, error)))

    def _look_for_places(self) -> None:
        """Give up where no worker has found a machine, and none has a CPU for one.

        Raises:
            OSError: so it is.
        """
        total = self._ray.cluster_resources().get("CPU", 0.0)
        free = self._ray.available_resources().get("CPU", 0.0)
        if free < 1.0:
            raise OSError(
                f"no worker could be started on Ray in {START_S:.0f} s: the cluster has "
                f"{total:.0f} CPUs and {free:.0f} of them free, expected one at least; end what "
                "holds them, or add machines with `ray start --address=...`; the same command "
                "goes on from what is solved"
            )

    def _end(self) -> None:
        with self._submitting:
            self._is_closed = True
        while not self._events.empty():
            event = self._events.get()
            if isinstance(event, _Task):
                self._waiting.append(event)
        for task in (*self._waiting, *(m.task for m in self._members if m.task is not None)):
            if self._broken is None and task.future.cancel():
                continue
            if task.future.running() or task.future.set_running_or_notify_cancel():
                closed = OSError("the pool of workers was closed before this was done")
                task.future.set_exception(self._broken or closed)
        for member in self._members:
            self._kill(member)

    def _kill(self, member: _Member) -> None:
        with suppress(Exception):
            self._ray.kill(member.actor)


def _expected(needed: tuple[str, ...]) -> Expected:
    return Expected("dotsim_ros", dotsim_ros.__version__, source_hash("."), os.getcwd(), needed)


def _deadly(what: str, error: BaseException) -> str:
    return (
        f"{what} on Ray ({_last_words(error)}); expected all to work to the end; most likely "
        "memory ran out: start Ray with fewer CPUs on each machine (`ray start --num-cpus`); the "
        "same command goes on from what is solved"
    )


def _last_words(error: BaseException) -> str:
    """Return what Ray knows of a death, in short: it writes a page about each."""
    return cut(one_line(error), LAST_WORDS)
