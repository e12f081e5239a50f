# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many environments of one gel on all cores: each process solves its share of them.

Python's lock keeps threads from it: they gained 10 % on two cores. The processes share nothing, so
a step gives what single gels give, to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

from dotsim_ros.gel.implicit.gel import GelState
from dotsim_ros.gel.make import make_gel_batch
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.cores import available_core_count, keep_single_threaded
from dotsim_ros.io.exclusive_use import ExclusiveUse, exclusive
from dotsim_ros.io.worker_pool.processes import WorkerContext
from dotsim_ros.specification import SensorSpecification

END_S = 10.0
"""A process that has not ended so long after it was told to is killed."""


class GelWorkerError(RuntimeError):
    """A process of the batch has ended; the state of its environments is lost."""


@dataclass
class _Share:
    """A process, the pipe to it, and the environments that it solves."""

    process: Any
    pipe: Connection
    first: int
    count: int

    @property
    def environments(self) -> slice:
        return slice(self.first, self.first + self.count)

    def send(self, *message: Any) -> None:
        try:
            self.pipe.send(message)
        except OSError as error:
            raise self.ended() from error

    def receive(self) -> Any:
        """Return the answer.

        Raises:
            GelWorkerError: the process has ended.
            Exception: what the process could not do.
        """
        try:
            failure, answer = self.pipe.recv()
        except (EOFError, OSError) as error:
            raise self.ended() from error
        if failure is not None:
            raise failure
        return answer

    def ended(self) -> GelWorkerError:
        self.process.join(END_S)
        last = self.first + self.count - 1
        return GelWorkerError(
            f"the process of environments {self.first} to {last} has ended with status "
            f"{self.process.exitcode}, and what they remember is lost; memory may have run out: "
            "close the batch and make it again, with fewer environments or workers"
        )


class GelBatch:
    """Independent worlds of one gel, spread over processes; close it, or use it in a `with` block.

    It starts processes, so a script makes it below `if __name__ == "__main__":`.

    Args:
        specification: of the sensor; its camera has no part in it.
        indenter: what presses in all of them.
        environment_count: number of worlds.
        worker_count: processes; None for as many as there are cores, at most one a world.

    Raises:
        ValueError: no environment or no worker, or a sensor without the implicit gel.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        *,
        indenter: Indenter,
        environment_count: int,
        worker_count: int | None = None,
    ) -> None:
        if environment_count < 1 or (worker_count is not None and worker_count < 1):
            raise ValueError(
                f"{environment_count} environments in {worker_count} processes, expected at least "
                "one of each"
            )
        count = min(environment_count, worker_count or available_core_count())
        self.exclusive_use = ExclusiveUse("batch of gels")
        self.environment_count = environment_count
        self._shares: list[_Share] = []
        self._lost: GelWorkerError | None = None
        context = WorkerContext()
        bounds = [environment_count * k // count for k in range(count + 1)]
        try:
            for first, end in pairwise(bounds):
                ours, theirs = context.Pipe()
                process = context.Process(
                    target=_work,
                    args=(theirs, specification, indenter, end - first),
                    daemon=True,
                )
                process.start()
                theirs.close()
                self._shares.append(_Share(process, ours, first, end - first))
                # The first one leaves the tables on disk that the others read.
                self._shares[-1].receive()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> GelBatch:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @exclusive()
    def step(self, poses: Sequence[Pose | None], dt_s: float) -> list[GelState]:
        """Move the indenter of every environment to its pose (None: away) and find the gel.

        Args:
            poses: one pose of the indenter in the base frame per environment.
            dt_s: duration of the step.

        Raises:
            PressTooDeepError, ValueError: as `ImplicitGel.step`; no environment has moved.
            GelWorkerError: a process has ended.
        """
        if len(poses) != self.environment_count:
            raise ValueError(f"{len(poses)} poses for {self.environment_count} environments")
        poses = list(poses)
        self._ask(lambda share: ("plan", poses[share.environments], dt_s))
        found = self._ask(lambda _share: ("follow",))
        return [state for states in found for state in states]

    @exclusive(begins=True)
    def reset(self) -> None:
        """Return every environment to rest."""
        self._ask(lambda _share: ("reset",))

    @exclusive(begins=True)
    def set_indenter(self, indenter: Indenter) -> None:
        """Replace the indenter of every environment and forget their states."""
        self._ask(lambda _share: ("set_indenter", indenter))

    def close(self) -> None:
        """End the processes; a second time does nothing."""
        for share in self._shares:
            share.pipe.close()
        for share in self._shares:
            share.process.join(END_S)
            if share.process.is_alive():
                share.process.kill()
                share.process.join()
        self._shares = []

    def _ask(self, message: Any) -> list[Any]:
        """Send every process a message of its own and return their answers.

        Raises:
            ValueError: the batch is closed.
            GelWorkerError: a process has ended, now or before.
            Exception: the first that a process could not do, after all have answered.
        """
        if self._lost is not None:
            raise self._lost
        if not self._shares:
            raise ValueError("the batch of gels is closed; make another one")
        answers, failures = [], []
        try:
            for share in self._shares:
                share.send(*message(share))
            for share in self._shares:
                try:
                    answers.append(share.receive())
                except GelWorkerError:
                    raise
                except Exception as error:
                    failures.append(error)
        except GelWorkerError as error:
            self._lost = error
            raise
        if failures:
            raise failures[0]
        return answers


def _work(
    pipe: Connection, specification: SensorSpecification, indenter: Indenter, count: int
) -> None:
    """Solve some environments until the pipe is closed."""
    keep_single_threaded()
    try:
        _serve(pipe, specification, indenter, count)
    except (EOFError, BrokenPipeError, KeyboardInterrupt):
        return


def _serve(
    pipe: Connection, specification: SensorSpecification, indenter: Indenter, count: int
) -> None:
    try:
        gel = make_gel_batch(specification, indenter=indenter, environment_count=count)
    except Exception as error:
        pipe.send((error, None))
        return
    pipe.send((None, None))
    paths: list[Any] = []
    dt_s = 0.0
    while True:
        name, *given = pipe.recv()
        answer = None
        try:
            match name:
                case "plan":
                    paths, dt_s = gel.plan(*given), given[1]
                case "follow":
                    answer = gel.follow(paths, dt_s)
                case "reset":
                    gel.reset()
                case "set_indenter":
                    gel.set_indenter(*given)
        except Exception as error:
            pipe.send((error, None))
            continue
        pipe.send((None, answer))
