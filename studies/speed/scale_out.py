# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presses a second against workers, as processes and on Ray, what a task costs by itself, and
touches a second against the nodes of a cluster.

Each task presses a ball, as a mesh, into the gel of the sensor at its own grid, as the gap finder
and the calibration do. Before the clock starts every worker has its gel. All workers are of this
machine: more of them than it has cores show what is lost to crowding, not what a cluster gives.
"""

from __future__ import annotations

import os
import pickle
import tempfile
import time
from concurrent.futures import Executor, as_completed
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.material import PronySeries
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import Indenter, IndenterKind, IndenterMesh
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.cache import content_key
from dotsim_ros.io.cores import available_core_count
from dotsim_ros.io.worker_pool.pool import Crew, RayWorkers, open_pool, worker_count
from dotsim_ros.io.worker_pool.ray_cluster import ON_THIS_MACHINE, SETTINGS, connected_ray
from dotsim_ros.learning.touches.plan import read_plan
from dotsim_ros.learning.touches.run import make_touches
from dotsim_ros.specification import load_sensor
from dotsim_ros.twin import solver
from dotsim_ros.twin.solver import SolveRequest
from studies.run import FAILED, expect_positive

BALL_M = 4.0e-3
FRAMES = 12
DEEPEST_M = 2.0e-3
EMPTY_TASKS = 200
ARRAY_BYTES = 1 << 20
TOUCHES_A_TASK = 5
NODE: dict[str, Any] = {
    "num_cpus": 1,
    "include_dashboard": False,
    "object_store_memory": 200_000_000,
}
AT_FULL_SPEED = {"RAY_worker_niceness": "0"}
"""By default Ray's workers give way to whatever else runs, which would be measured too."""


def ball() -> Indenter:
    """Return a ball as a mesh of 20480 triangles, its tip at the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=BALL_M)
    vertices = np.asarray(mesh.vertices) + np.array([0.0, 0.0, BALL_M])
    surface = IndenterMesh(vertices, np.asarray(mesh.faces, dtype=np.int32))
    return Indenter(IndenterKind.MESH, (), mesh=surface, name="ball")


def requests_of(sensor_name: str, count: int) -> list[SolveRequest]:
    """Return presses at places all over the dome."""
    sensor = load_sensor(sensor_name)
    apex_m = skin_of(sensor.gel).apex_m
    shape, material = ball(), sensor.material
    relaxation = PronySeries(material.prony_shares, material.prony_times_s)
    random = np.random.default_rng(0)
    requests = []
    for number in range(count):
        aside_m = random.uniform(-3.0e-3, 3.0e-3, 2)
        depths_m = np.linspace(0.0, random.uniform(0.7, 1.0) * DEEPEST_M, FRAMES)
        poses = tuple(Pose(apex_m + np.array([*aside_m, -depth_m])) for depth_m in depths_m)
        stamps = 0.1 * np.arange(FRAMES, dtype=np.float64)
        requests.append(
            SolveRequest(f"press {number}", shape, poses, stamps, values_of(sensor), relaxation)
        )
    return requests


def timed_solve(request: SolveRequest) -> tuple[Any, float]:
    """Return the answer to a request, and the processor's time for it."""
    from dotsim_ros.twin.solver import solve

    begun_s = time.process_time()
    answer = solve(request)
    return answer, time.process_time() - begun_s


def nothing(_given: Any) -> None:
    """Do no work."""


def array_of(size: int) -> Any:
    """Return an answer of so many bytes."""
    return np.zeros(size // 8)


def wait_here(seconds: float) -> int:
    """Return the process, after a while."""
    time.sleep(seconds)
    return os.getpid()


def wake(pool: Executor, count: int) -> None:
    """Return once so many workers are there."""
    known: set[int] = set()
    while len(known) < count:
        known |= set(pool.map(wait_here, [0.2] * count))


def task_s(pool: Executor, function: Any, given: Any) -> float:
    """Return the time a task takes that does next to nothing, many of them under way."""
    begun_s = time.perf_counter()
    for _ in pool.map(function, [given] * EMPTY_TASKS):
        pass
    return (time.perf_counter() - begun_s) / EMPTY_TASKS


def measured(crew: Crew, requests: list[SolveRequest], sensor_name: str) -> dict[str, Any]:
    """Return the figures of some workers, and a digest of all answers."""
    sensor = load_sensor(sensor_name)
    count = worker_count(crew)
    begun_s = time.perf_counter()
    with open_pool(crew, solver.begin, sensor, skin_of(sensor.gel)) as pool:
        wake(pool, count)
        started_s = time.perf_counter() - begun_s
        # Each worker makes its gel in its first press.
        list(pool.map(timed_solve, requests[: 2 * count]))
        sent = getattr(pool, "task_bytes", 0)
        begun_s = time.perf_counter()
        running = {pool.submit(timed_solve, request): n for n, request in enumerate(requests)}
        ends_s = {}
        for done in as_completed(running):
            ends_s[running[done]] = time.perf_counter() - begun_s
        answers = {number: future.result() for future, number in running.items()}
        seconds = max(ends_s.values())
        ordered = [answers[number] for number in range(len(requests))]
        skin_m, force_n = ordered[0][0].skin_position_m, ordered[0][0].force_n
        figures: dict[str, Any] = {
            "workers": count,
            "start_s": round(started_s, 2),
            "presses_per_s": round(len(requests) / seconds, 3),
            "seconds_per_press": round(count * seconds / len(requests), 4),
            "processor_s_per_press": round(float(np.mean([cpu for _, cpu in ordered])), 4),
            "answer_bytes": skin_m.nbytes + force_n.nbytes,
            "digest": content_key((), [(a.skin_position_m, a.force_n) for a, _ in ordered]),
        }
        if isinstance(crew, RayWorkers):
            figures["task_bytes"] = (pool.task_bytes - sent) // len(requests)  # type: ignore[attr-defined]
            figures["shared_bytes"] = pool.shared_bytes  # type: ignore[attr-defined]
        else:
            figures["task_bytes"] = len(pickle.dumps((timed_solve, requests[0])))
        for name, function, given in (
            ("empty_task_ms", nothing, None),
            ("empty_task_with_1_MiB_ms", nothing, array_of(ARRAY_BYTES)),
            ("empty_task_with_an_answer_ms", array_of, figures["answer_bytes"]),
        ):
            figures[name] = round(1e3 * task_s(pool, function, given), 3)
    return figures


def touches_on(nodes: int, touches: int, *, kill: bool = False) -> dict[str, Any]:
    """Return touches a second on a cluster of so many nodes, and a digest of the data set.

    Args:
        nodes: of one CPU each; the first is the head.
        touches: of the default plan. Each node's first task is not timed: it loads the kernels.
        kill: whether the last node is killed when a third of them is written.
    """
    os.environ.update(SETTINGS | ON_THIS_MACHINE)
    import ray
    from ray.cluster_utils import Cluster

    ray.shutdown()
    cluster = Cluster()
    added = [cluster.add_node(**NODE) for _ in range(nodes)]
    cluster.wait_for_nodes()
    moments: list[tuple[int, float]] = []

    def note(_what: str, done: int, _of: int) -> None:
        moments.append((done, time.perf_counter()))
        if kill and len(added) > 1 and done >= touches / 3:
            cluster.remove_node(added.pop(), allow_graceful=False)

    plan = replace(read_plan(None), touches_a_gel=TOUCHES_A_TASK)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        crew = RayWorkers(nodes, cluster.address)
        try:
            make_touches(plan, folder, count=touches, workers=crew, progress=note)
        finally:
            ray.shutdown()
            cluster.shutdown()
        files = sorted([*folder.rglob("file-*.parquet"), *folder.rglob("*.mp4")])
        digest = sha256(b"".join(path.read_bytes() for path in files)).hexdigest()
    (before, begun_s), (done, ended_s) = moments[nodes], moments[-1]
    return {
        "nodes": nodes,
        "killed": int(kill),
        "touches_per_s": round((done - before) / (ended_s - begun_s), 3),
        "digest": digest,
    }


def scale_out(
    *,
    workers: tuple[int, ...] = (1, 2, 4),
    presses: int = 32,
    touches: int = 60,
    sensor: str = "densetact2",
    ray_address: str = "local",
) -> dict[str, Any]:
    """Presses a second against workers, as processes and on Ray, and touches against nodes.

    Args:
        workers: numbers of them.
        presses: timed for each number.
        touches: made on each cluster.
        sensor: name or file.
        ray_address: of a cluster; local for this machine.
    """
    expect_positive(fewest_workers=min(workers), presses=presses)
    os.environ.update(AT_FULL_SPEED)
    requests = requests_of(sensor, presses)
    # The tables of the gel are made once and kept on disk.
    solver.begin(load_sensor(sensor), skin_of(load_sensor(sensor).gel))
    solver.solve(requests[0])
    load_before = os.getloadavg()[0]
    begun_s = time.perf_counter()
    connected_ray(ray_address, max(workers))
    ray_start_s = time.perf_counter() - begun_s
    rows = [
        {"where": where, **measured(crew, requests, sensor)}
        for count in workers
        for where, crew in (("processes", count), ("Ray", RayWorkers(count, ray_address)))
    ]
    digests = {row.pop("digest") for row in rows}
    clusters = [
        touches_on(1, touches),
        touches_on(2, touches),
        touches_on(2, touches, kill=True),
    ]
    data_sets = {row.pop("digest") for row in clusters}
    failed = ["workers gave different answers"] if len(digests) > 1 else []
    failed += ["clusters made different data sets"] if len(data_sets) > 1 else []
    return {
        "cores": available_core_count(),
        "load_before": round(load_before, 2),
        "presses": presses,
        "frames_per_press": FRAMES,
        "ray_start_s": round(ray_start_s, 2),
        "rows": rows,
        "answers_are_the_same": not failed,
        "clusters": clusters,
        "two_nodes_over_one": round(clusters[1]["touches_per_s"] / clusters[0]["touches_per_s"], 2),
        "load_after": round(os.getloadavg()[0], 2),
        FAILED: failed,
    }
