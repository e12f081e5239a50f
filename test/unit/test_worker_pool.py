# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Worker processes end with who started them, whatever ends it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pool_work
import pytest
from pool_work import is_there, wait_until

from dotsim_ros.io.worker_pool.processes import open_worker_pool

PROGRAM = """
import os, sys, time
from concurrent.futures import wait
from dotsim_ros.cli import calibrate, main
from dotsim_ros.io.worker_pool.pool import open_pool

def begin(_given):
    pass

def work(_number):
    os.write(1, b"worker %d\\n" % os.getpid())
    time.sleep(600.0)

def end(_number):
    os.kill(os.getpid(), 9)

def run(*, data: str, out: str):
    with open_pool(2, begin, None) as pool:
        task = end if sys.argv[1] == "end" else work
        for future in [pool.submit(task, number) for number in range(2)]:
            future.result()

if __name__ == "__main__":
    calibrate.run = run
    sys.exit(main.main(["calibrate", "--data", "d", "--out", "o.yaml"]))
"""

PATIENCE_S = 60.0
GONE_S = 5.0


@pytest.fixture
def program(tmp_path):
    path = tmp_path / "program.py"
    path.write_text(PROGRAM, encoding="utf-8")
    return path


def started(program: Path, what: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(program), what],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


@pytest.mark.fault("calibrate", "SIGKILL, SIGTERM or Ctrl-C while worker processes solve")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_no_worker_is_left(program, number, answered):
    process = started(program, "work")
    workers = [int(process.stdout.readline().split()[1]) for _ in range(2)]
    assert all(is_there(pid) for pid in workers)
    if number == signal.SIGINT:
        os.killpg(process.pid, number)  # as a terminal does: the workers get it, too
    else:
        process.send_signal(number)
    _, errors = process.communicate(timeout=PATIENCE_S)
    # Workers end at once; the rest is left to a machine that is busy.
    wait_until(lambda: not any(map(is_there, workers)), GONE_S)
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert errors == "dotsim_ros calibrate: interrupted\n"
        answered(errors, what="Ctrl-C while worker processes solve")
    elif number == signal.SIGTERM:
        assert process.returncode == 143
        assert errors == "dotsim_ros calibrate: terminated\n"
        answered(errors, what="SIGTERM while worker processes solve")
    else:
        answered(
            f"0 of the {len(workers)} worker processes are left after {GONE_S:g} s",
            what="SIGKILL while worker processes solve",
        )


@pytest.mark.fault("calibrate", "a worker process is killed, as where memory runs out")
def test_a_worker_that_is_killed_is_one_line(program, answered):
    process = started(program, "end")
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 1
    assert errors.count("\n") == 1
    assert "ended from outside" in errors
    assert "fewer with --workers" in errors
    answered(errors)


def test_what_the_initializer_raises_is_raised_here():
    with (
        pytest.raises(ValueError, match="no gel to press") as caught,
        open_worker_pool(1, pool_work.refuse) as pool,
    ):
        pool.submit(len, [1]).result()
    assert "in refuse" in str(caught.value.__cause__)  # where it was raised in the worker


UNGUARDED = """
import os
from dotsim_ros.io.worker_pool.pool import open_pool

with open_pool(2, os.getpid) as pool:
    print(pool.submit(len, [1]).result())
"""


def test_a_script_without_a_guard_is_told_of_it(tmp_path):
    path = tmp_path / "unguarded.py"
    path.write_text(UNGUARDED, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(path)], capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert done.returncode == 1
    assert done.stdout == ""
    last = done.stderr.splitlines()[-1]
    assert last.startswith("OSError: the worker processes ended before one had begun")
    assert 'no `if __name__ == "__main__":`' in last


def test_a_worker_that_is_killed_as_it_begins_has_no_missing_guard():
    with (
        pytest.raises(OSError, match="ended from outside, most likely because memory ran out"),
        open_worker_pool(1, pool_work.die_at_the_beginning) as pool,
    ):
        pool.submit(len, [1]).result()
