# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Python programs in processes that need not import again what takes most of a node's start.

A server imports the sensor and makes one, but not ROS, whose import starts threads, and forks for
each program. The program ends as its own interpreter would: with all exit handlers, and with its
own status.
"""

from __future__ import annotations

import gc
import io
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from threading import Lock
from types import ModuleType

PRELOADED = "import cv2, scipy.optimize, scipy.spatial, dotsim_ros.sensor"
WARMED_UP = """
from dataclasses import replace
import cv2
from dotsim_ros import Pose, TactileSensor, load_sensor
sensor = load_sensor("densetact2")
solver = replace(sensor.solver, grid_spacing_m=0.0048)
# A pool of threads that OpenCV makes is none in a fork.
thread_count = cv2.getNumThreads()
cv2.setNumThreads(1)
TactileSensor.load(replace(sensor, solver=solver)).step(Pose.above_apex(0.0005))
cv2.setNumThreads(thread_count)
"""
"""Leaves the kernels loaded, which takes longer than the rest of a sensor's start."""
GPU = Path("/proc/driver/nvidia")
"""Where it is there, Warp opens it, and what is opened is of no use after a fork."""
LONGEST_REQUEST = 1 << 20


class Forked:
    """A running program, with those methods of `subprocess.Popen` that tests use.

    Args:
        program: `-m MODULE`, `-c CODE` or a script, and its arguments.
    """

    def __init__(self, program: Sequence[str]) -> None:
        output, written = os.pipe()
        statuses, status = os.pipe()
        request = {"program": [*program], "folder": os.getcwd(), "environment": {**os.environ}}
        server = _server(os.environ.get("PYTHONPATH", ""))
        socket.send_fds(server, [json.dumps(request).encode()], [written, status])
        os.close(written)
        os.close(status)
        self.stdout = os.fdopen(output, encoding="utf-8", errors="replace")
        self._statuses = os.fdopen(statuses, encoding="ascii")
        self.pid = int(self._statuses.readline())
        self.returncode: int | None = None
        self._reading = Lock()

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end and return the status: below zero the signal that ended it.

        Raises:
            subprocess.TimeoutExpired: it has not ended.
        """
        is_over = self.returncode is not None or select.select([self._statuses], [], [], timeout)[0]
        if not is_over:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        with self._reading:
            if self.returncode is None:
                self.returncode = int(self._statuses.readline())
        return self.returncode

    def poll(self) -> int | None:
        """Return the status, None while the program runs."""
        try:
            return self.wait(0.0)
        except subprocess.TimeoutExpired:
            return None

    def send_signal(self, number: int) -> None:
        """Send a signal to a program that has not ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End the program at once."""
        self.send_signal(signal.SIGKILL)


@cache
def _server(_path: str) -> socket.socket:
    """Start a server, one for each path that modules are imported from, and return the connection
    to it, with which it ends."""
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    here.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, LONGEST_REQUEST)
    subprocess.Popen([sys.executable, __file__, str(there.fileno())], pass_fds=[there.fileno()])
    there.close()
    return here


def _serve(connection: socket.socket) -> None:
    """Return, in a process of its own, for each program that is asked for, once it is set up."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        message, (*files,), _, _ = socket.recv_fds(connection, LONGEST_REQUEST, 2)
        if not message:
            os._exit(0)
        if os.fork() == 0:
            break
        for file in files:
            os.close(file)
    connection.close()
    written, status = files
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    if pid := os.fork():
        os.close(written)
        os.write(status, f"{pid}\n".encode())
        ended = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        os.write(status, f"{ended}\n".encode())
        os._exit(0)
    os.close(status)
    signal.signal(signal.SIGINT, handler)
    os.dup2(written, 1)
    os.dup2(written, 2)
    os.close(written)
    _run(**json.loads(message))


def _run(program: list[str], folder: str, environment: Mapping[str, str]) -> None:
    """Run a program as `python -u PROGRAM` does."""
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    # What the server found out from its own, or was started with.
    tempfile.tempdir = None
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(io.FileIO(number, "w", closefd=False), "utf-8", write_through=True)
        for number in (1, 2)
    )
    if program[0] == "-m":
        sys.argv = program[1:]
        sys.path.insert(0, folder)
        runpy.run_module(program[1], run_name="__main__", alter_sys=True)
    elif program[0] == "-c":
        sys.argv = ["-c", *program[2:]]
        sys.path.insert(0, folder)
        main = sys.modules["__main__"] = ModuleType("__main__")
        exec(program[1], main.__dict__)
    else:
        sys.argv = program
        sys.path.insert(0, str(Path(program[0]).parent))
        runpy.run_path(program[0], run_name="__main__")


if __name__ == "__main__":
    # The folder of this file is not one that a program imports from.
    del sys.path[0]
    exec(PRELOADED)
    if not GPU.exists():
        exec(WARMED_UP, {})
    # What was imported is shared with the programs as long as nothing counts or searches it.
    gc.freeze()
    _serve(socket.socket(fileno=int(sys.argv[1])))
