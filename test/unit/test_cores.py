# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Linear algebra on one thread while the gel is solved, and as before afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from importlib import import_module

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from dotsim_ros import Pose, TactileSensor
from dotsim_ros.gel.implicit.gel import World
from dotsim_ros.gel.implicit.newton import Point
from dotsim_ros.gel.make import SingleImplicitGel
from dotsim_ros.io.cores import available_core_count, keep_single_threaded, single_threaded
from dotsim_ros.io.worker_pool.processes import open_worker_pool

pytestmark = pytest.mark.skipif(
    os.cpu_count() == 1, reason="a single core has one thread, whatever is asked for"
)


def threads() -> set[int]:
    """Return the numbers of threads of the libraries that NumPy and SciPy have: OpenCV brings one,
    too, which solves nothing here."""
    return {
        one["num_threads"]
        for one in threadpool_info()
        if one["user_api"] == "blas"
        and "cv2" not in one["filepath"]
        and "opencv" not in one["filepath"]
    }


@pytest.fixture
def _two_threads():
    # Tests run with one, which would show nothing.
    with threadpool_limits(limits=2, user_api="blas"):
        assert threads() == {2}
        yield


@pytest.mark.usefixtures("_two_threads")
def test_the_gel_is_solved_on_one_thread_and_the_number_of_before_comes_back():
    sensor = TactileSensor.load("flat_pad", indenter="sphere_4mm")
    assert threads() == {2}
    seen = []
    gel = sensor._gel
    assert isinstance(gel, SingleImplicitGel)

    def observe(_world: World, _pose: Pose | None, point: Point, *_: object) -> Point:
        seen.append(threads())
        return point

    gel.gel.observer = observe
    sensor.press(Pose.above_apex(depth_m=0.0005))
    assert seen
    assert all(one == {1} for one in seen)
    assert threads() == {2}


@pytest.mark.usefixtures("_two_threads")
def test_blocks_of_several_threads_may_overlap():
    begun, end = threading.Event(), threading.Event()

    @single_threaded()
    def work() -> None:
        begun.set()
        end.wait(10.0)

    other = threading.Thread(target=work)
    with single_threaded():
        other.start()
        assert begun.wait(10.0)
    # The other one is within its block.
    assert threads() == {1}
    end.set()
    other.join(10.0)
    assert threads() == {2}


@pytest.mark.usefixtures("_two_threads")
def test_a_block_that_fails_gives_the_threads_back():
    with pytest.raises(ValueError, match="wrong"), single_threaded():
        raise ValueError("wrong")
    assert threads() == {2}


@pytest.mark.skipif(available_core_count() < 2, reason="one core has one thread anyway")
def test_a_command_and_what_it_starts_have_one_thread():
    program = (
        "from dotsim_ros.cli import calibrate, main\n"
        "def run(*, data: str, out: str):\n"
        "    import numpy, scipy.linalg, subprocess, sys\n"
        "    from threadpoolctl import threadpool_info\n"
        "    print([one['num_threads'] for one in threadpool_info()])\n"
        "    inner = 'import numpy; from threadpoolctl import threadpool_info as i; "
        'print([one["num_threads"] for one in i()])\'\n'
        "    subprocess.run([sys.executable, '-c', inner], check=True)\n"
        "    return 0\n"
        "calibrate.run = run\n"
        "main.main(['calibrate', '--data', 'd', '--out', 'o.yaml'])\n"
    )
    unset = {name: value for name, value in os.environ.items() if "NUM_THREADS" not in name}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=unset, check=True
    )
    own, started = done.stdout.splitlines()
    assert set(own) - set("[], ") == {"1"}
    assert set(started) - set("[], ") == {"1"}


@pytest.mark.usefixtures("_two_threads")
def test_what_keeps_one_thread_for_good_keeps_it_where_a_block_is_open():
    with single_threaded():
        keep_single_threaded()
    assert threads() == {1}


@pytest.mark.usefixtures("_two_threads")
def test_workers_have_one_thread_each():
    unset = {name: value for name, value in os.environ.items() if "NUM_THREADS" not in name}
    with pytest.MonkeyPatch.context() as patch:
        for name in set(os.environ) - set(unset):
            patch.delenv(name)
        with open_worker_pool(1, import_module, "scipy.linalg") as pool:
            assert pool.submit(threads).result() == {1}
