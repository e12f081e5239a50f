# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pools on Ray give what processes give, lose nothing with a worker, and say what is wrong."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pool_work
import pytest
from pool_work import is_there

from dotsim_ros.cli.main import main
from dotsim_ros.io.worker_pool.pool import RayWorkers, open_pool
from dotsim_ros.io.worker_pool.ray_cluster import ON_THIS_MACHINE, SETTINGS

pytest.importorskip("ray", reason="needs the extra scale: pip install '.[scale]'")

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
QUICK = {
    # So that a machine that is gone is soon known to be.
    "health_check_initial_delay_ms": 0,
    "health_check_period_ms": 300,
    # What is gone answers with a refusal at once; a busy machine may take its time.
    "health_check_timeout_ms": 10_000,
    "health_check_failure_threshold": 2,
}
SUM = 100_000.0
PATIENCE_S = 240.0


@pytest.fixture(scope="module", autouse=True)
def settings():
    """Set what Ray reads when it is loaded, and what its workers find modules with."""
    with pytest.MonkeyPatch.context() as patch:
        paths = [str(ROOT), str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])]
        patch.setenv("PYTHONPATH", os.pathsep.join(paths))
        for name, value in (SETTINGS | ON_THIS_MACHINE).items():
            patch.setenv(name, value)
        yield


class TwoNodes:
    """A Ray cluster of two machines of one CPU each, both of them this one."""

    def __init__(self, folder: Path) -> None:
        # Once the settings are made that this needs, which a cluster reads where it is started.
        from ray._private.utils import get_ray_address_file
        from ray.cluster_utils import Cluster

        # A cluster of a test writes its address below Ray's usual folder, whatever `temp_dir`.
        Path(get_ray_address_file(None)).parent.mkdir(parents=True, exist_ok=True)
        self._cluster = Cluster()
        self._cluster.add_node(
            num_cpus=1,
            include_dashboard=False,
            _system_config=QUICK,
            temp_dir=str(folder),
        )
        self.address = self._cluster.address
        self.second = self.add()

    def add(self):
        return self._cluster.add_node(num_cpus=1)

    def kill_second(self) -> None:
        self._cluster.remove_node(self.second, allow_graceful=False)

    def close(self) -> None:
        import ray

        ray.shutdown()
        self._cluster.shutdown()


@pytest.mark.fault("scale-out", "an address at which no Ray cluster answers")
@pytest.mark.parametrize(
    ("address", "told", "fault"),
    [
        ("HOST", "expected HOST:PORT", "a Ray address of another form"),
        ("ray://HOST:10001", "expected HOST:PORT", "a Ray address of another form"),
        ("", "nobody answers at", "an address at which no Ray cluster answers"),
    ],
)
def test_an_address_without_a_cluster_is_one_line(address, told, fault, tmp_path, capsys, answered):
    with socket.socket() as taken:
        # Bound, so that nobody else listens there.
        taken.bind(("127.0.0.1", 0))
        given = address or f"127.0.0.1:{taken.getsockname()[1]}"
        line = ["demonstrate", "--episodes", "1", "--frames", "10", "--out", f"{tmp_path}/out"]
        assert main([*line, "--ray-address", given]) == 1
    errors = capsys.readouterr().err
    assert told in errors
    assert errors.count("\n") == 1
    answered(errors.replace(given, address or "HOST:PORT"), what=fault)


@pytest.mark.fault("scale-out", "a Ray address is given, and Ray is not installed")
def test_ray_is_asked_for_where_it_is_missing(tmp_path, capsys, monkeypatch, answered):
    monkeypatch.setitem(sys.modules, "ray", None)
    line = ["demonstrate", "--episodes", "1", "--frames", "10", "--out", f"{tmp_path}/out"]
    assert main([*line, "--ray-address", "auto"]) == 1
    told = capsys.readouterr().err
    assert "Ray is not installed" in told
    assert "dotsim_ros[scale]" in told
    assert told.count("\n") == 1
    answered(told)


@pytest.fixture(scope="module")
def nodes():
    # Its sockets lie there, whose paths may have 107 characters.
    with tempfile.TemporaryDirectory(prefix="ray", dir="/tmp", ignore_cleanup_errors=True) as short:
        nodes = TwoNodes(Path(short))
        try:
            yield nodes
        finally:
            nodes.close()


@pytest.fixture(params=["processes", "ray"])
def crew(request):
    if request.param == "processes":
        return 2
    return RayWorkers(2, request.getfixturevalue("nodes").address)


def test_answers_come_in_order_and_exceptions_as_they_are(crew):
    given = np.ones(int(SUM))
    with open_pool(crew, pool_work.begin, given) as pool:
        found = list(pool.map(pool_work.total, range(8), [given] * 8))
        assert found == [(number, number + 2.0 * SUM) for number in range(8)]
        broken = pool.submit(pool_work.fail, 7)
        with pytest.raises(KeyError, match="no press 7"):
            broken.result()
        # It goes on after that, and an answer may be large.
        np.testing.assert_array_equal(pool.submit(pool_work.large, 3).result(), np.full(200_000, 3))
        # Arrays are put once, equal ones too; another content is another array.
        list(pool.map(pool_work.total, range(4), [given.copy(), 2.0 * given] * 2))
        assert getattr(pool, "shared_bytes", 2 * given.nbytes) == 2 * given.nbytes
        given[:] = 5.0
        assert pool.submit(pool_work.total, 0, given).result() == (0, 6.0 * SUM)


def places_until(pool: Executor, count: int) -> set[str]:
    """Return the machines that work is done on, once there are so many."""
    places: set[str] = set()
    end_s = time.monotonic() + PATIENCE_S
    while len(places) < count:
        assert time.monotonic() < end_s, f"work is done on {places} alone"
        places |= {place for _, place in pool.map(pool_work.place, range(4), [0.05] * 4)}
    return places


def test_a_machine_that_is_killed_loses_nothing(nodes):
    count = 10
    with open_pool(RayWorkers(2, nodes.address), pool_work.begin, None) as pool:
        both = places_until(pool, 2)
        running = [pool.submit(pool_work.place, number, 0.3) for number in range(count)]
        assert {future.result(timeout=PATIENCE_S)[1] for future in running[:2]} == both
        nodes.kill_second()
        found = [future.result(timeout=PATIENCE_S) for future in running]
        assert [number for number, _ in found] == list(range(count))
        # One that joins later gets work as well.
        nodes.second = nodes.add()
        assert len(places_until(pool, 2) - both) == 1


@pytest.mark.fault("scale-out", "a task of which every worker on Ray dies")
def test_a_task_that_kills_workers_is_given_up(nodes, answered):
    with open_pool(RayWorkers(2, nodes.address), pool_work.begin, None) as pool:
        deadly = pool.submit(pool_work.die)
        with pytest.raises(OSError, match="3 workers died of the same task") as told:
            deadly.result(timeout=PATIENCE_S)
        # The others' work goes on.
        assert pool.submit(abs, -3).result(timeout=PATIENCE_S) == 3
    text = str(told.value)
    assert "--num-cpus" in text
    assert "\n" not in text
    answered(re.sub(r"\(.*?\);", "(what Ray knows of it);", text))


def test_an_initializer_that_fails_or_kills_is_told(nodes):
    for initialize, error, told in (
        (pool_work.refuse, ValueError, "no gel to press"),
        (pool_work.die_at_the_beginning, OSError, "3 workers died of the same task"),
    ):
        with open_pool(RayWorkers(1, nodes.address), initialize) as pool:
            asked = pool.submit(abs, 1)
            with pytest.raises(error, match=told):
                asked.result(timeout=PATIENCE_S)


def test_what_is_not_begun_is_cancelled_where_the_block_fails(nodes):
    opened = open_pool(RayWorkers(2, nodes.address), pool_work.begin, None)
    pool = opened.__enter__()
    running = [pool.submit(pool_work.place, number, 60.0) for number in range(9)]
    assert not opened.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert all(future.done() for future in running)
    assert any(future.cancelled() for future in running)


@pytest.mark.fault("scale-out", "the machines of a cluster do not share a folder")
def test_a_folder_that_is_not_there_is_told(nodes, tmp_path, answered):
    crew = RayWorkers(1, nodes.address)
    with open_pool(crew, pool_work.begin, None, reads=(tmp_path / "data",)) as pool:
        asked = pool.submit(abs, 1)
        with pytest.raises(OSError, match=r"does not see .*/data; expected a file system") as told:
            asked.result(timeout=PATIENCE_S)
    answered(f"the worker on HOST {str(told.value).partition(') ')[2]}")
    kept = tmp_path / "kept"
    with open_pool(crew, pool_work.begin, None, writes=(kept,)) as pool:
        assert pool.submit(abs, -1).result() == 1
        assert len(list(kept.iterdir())) == 1
    assert not list(kept.iterdir())


@pytest.mark.fault("scale-out", "a machine of the cluster has another dotsim_ros, or none")
def test_other_code_on_a_machine_is_told(monkeypatch, answered):
    from dotsim_ros.io.worker_pool.ray_pool import expected_of
    from dotsim_ros.io.worker_pool.ray_worker import check

    expected = expected_of(())
    check(expected)
    for other, what in (
        (replace(expected, release="0.0.9"), "another version; expected dotsim_ros 0.0.9"),
        (replace(expected, code="0" * 64), "other code; expected"),
        (expected, "cannot load dotsim_ros"),
    ):
        if other is expected:
            monkeypatch.setitem(sys.modules, "dotsim_ros.io.provenance", None)
        with pytest.raises(OSError, match=what) as refused:
            check(other)
        told = str(refused.value)
        assert "install the same" in told
        answered(f"the worker on HOST {told.partition(') ')[2]}")


def test_the_cluster_must_have_the_same_ray(nodes):
    program = (
        "import ray; ray.__version__ = '2.1.0'\n"
        "from dotsim_ros.io.worker_pool.ray_cluster import connected_ray\n"
        f"connected_ray({nodes.address!r}, 1)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert "has another Ray or Python than this process" in last
    assert "install the same" in last


PROGRAM = """
import sys
from pathlib import Path
import pool_work
from dotsim_ros.cli import calibrate, main
from dotsim_ros.io.worker_pool.pool import RayWorkers, open_pool

def run(*, data: str, out: str):
    with open_pool(RayWorkers(1, "local"), pool_work.begin, None) as pool:
        pool.submit(pool_work.tell_and_sleep, 0, Path(sys.argv[1])).result()

calibrate.run = run
sys.exit(main.main(["calibrate", "--data", "d", "--out", "o.yaml"]))
"""


def test_no_process_of_ray_is_left(tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(HERE)])}
    # Side by side: they wait for Ray most of the time.
    signals = (signal.SIGTERM, signal.SIGKILL)
    told = {number: tmp_path / number.name for number in signals}
    processes = {
        number: subprocess.Popen(
            [sys.executable, str(tmp_path / "program.py"), str(told[number])],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for number in signals
    }
    families: dict[int, list[int]] = {}
    try:
        for number, process in processes.items():
            pool_work.wait_until(
                lambda n=number: told[n].is_file() and bool(told[n].read_text()), PATIENCE_S
            )
            families[number] = descendants(process.pid)
            process.send_signal(number)
        terminated, killed = processes.values()
        _, errors = terminated.communicate(timeout=PATIENCE_S)
        assert (terminated.returncode, errors) == (143, "dotsim_ros calibrate: terminated\n")
        family = families[signal.SIGTERM]
        assert int(told[signal.SIGTERM].read_text()) in family
        pool_work.wait_until(lambda: not any(map(is_there, family)), PATIENCE_S)
        killed.communicate(timeout=PATIENCE_S)
        family, worker = families[signal.SIGKILL], int(told[signal.SIGKILL].read_text())
        assert worker in family
        # Two of Ray's own, which do no work, look only now and then whether it is there.
        pool_work.wait_until(
            lambda: sum(map(is_there, family)) <= 2 and not is_there(worker), PATIENCE_S
        )
    finally:
        left = [pid for family in families.values() for pid in family]
        for pid in filter(is_there, [*left, *(process.pid for process in processes.values())]):
            os.kill(pid, signal.SIGKILL)


def descendants(pid: int) -> list[int]:
    import psutil

    return [child.pid for child in psutil.Process(pid).children(recursive=True)]
