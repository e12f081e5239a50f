# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One way to open a pool, whether its workers are processes of this machine or of a Ray cluster.

Work is the same on both: a function of the pool's users, with arguments that can be pickled, whose
answer depends on nothing else. So an answer does not depend on who found it, and work that a dying
worker leaves behind can be given to another.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dotsim_ros.io.worker_pool.processes import open_worker_pool


@dataclass(frozen=True)
class RayWorkers:
    """Workers of a Ray cluster.

    Attributes:
        count: how many, at most; each takes one of the cluster's CPUs.
        address: HOST:PORT of the cluster's head, "auto" for the cluster that this machine is part
            of, "local" to start Ray on this machine alone.

    Raises:
        ValueError: no worker, or an address of another form.
    """

    count: int
    address: str

    def __post_init__(self) -> None:
        check_workers(self.count)
        if self.address in ("auto", "local"):
            return
        host, _, port = self.address.rpartition(":")
        if not host or "/" in host or not (port.isascii() and port.isdigit()):
            raise ValueError(
                f"the Ray address is {self.address!r}, expected HOST:PORT as `ray start --head` "
                "prints it, auto or local; a command runs on a machine of the cluster, so that "
                "there is no ray:// address to give"
            )


Crew = int | RayWorkers
"""A number stands for so many processes of this machine."""


def crew(count: int, ray_address: str | None = None) -> Crew:
    """Return workers: of a Ray cluster where its address is given, else of this machine.

    Raises:
        ValueError: no worker, or an address of another form.
    """
    check_workers(count)
    return count if ray_address is None else RayWorkers(count, ray_address)


def worker_count(workers: Crew) -> int:
    """Return how many workers there are at most."""
    return workers.count if isinstance(workers, RayWorkers) else workers


def check_workers(workers: Crew) -> None:
    """Refuse what no pool could be opened with.

    Raises:
        ValueError: no worker.
    """
    if worker_count(workers) < 1:
        raise ValueError(f"workers is {worker_count(workers)}, expected 1 or more")


@contextmanager
def open_pool(
    workers: Crew,
    initialize: Callable[..., None],
    *given: Any,
    reads: Sequence[Path] = (),
    writes: Sequence[Path] = (),
) -> Iterator[Executor]:
    """Open a pool of workers.

    Each is started when it is first needed. Where the block ends with an exception, Ctrl-C among
    them, what the workers are at is broken off.

    Args:
        workers: how many, and where.
        initialize: called once in each, at module level so that it can be sent.
        given: its arguments; on Ray all workers of a machine share their arrays.
        reads: folders that the work reads; on a cluster all machines must have them.
        writes: folders that the work writes into: the machines must share them.

    Raises:
        ValueError: no worker, or Ray is not installed.
        OSError: a process of this machine was ended from outside, most likely for want of memory;
            a cluster that cannot be reached, that has another Python, Ray or code of this package,
            that lacks the folders, or whose workers die again and again.
    """
    check_workers(workers)
    if isinstance(workers, RayWorkers):
        # Ray is optional, and takes seconds to load and to connect.
        from dotsim_ros.io.worker_pool.ray_cluster import connected_ray

        ray = connected_ray(workers.address, workers.count)
        # It needs Ray, as it was set up to connect.
        from dotsim_ros.io.worker_pool.ray_pool import open_ray_pool

        with open_ray_pool(ray, workers.count, initialize, given, reads, writes) as pool:
            yield pool
    else:
        with open_worker_pool(workers, initialize, *given) as pool:
            yield pool
