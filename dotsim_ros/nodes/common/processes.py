# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Executables of this package as child processes, for programs that use several. Needs no ROS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

STOP_TIMEOUT_S = 30.0


class NodeProcess:
    """A node in a process of its own, its log passed on line by line.

    It gets no signal from the terminal: who starts it stops it.

    Args:
        executable: its name, which is that of its module in `dotsim_ros.nodes`.
        parameters: ROS parameters, as on the command line.
        environment: variables to set next to those of this process.
        arguments: further ROS arguments, such as remappings.
        code: Python code to run in the module's place.
        command: a program with its arguments to run instead; ROS arguments are added.
    """

    def __init__(
        self,
        executable: str,
        parameters: Mapping[str, Any],
        *,
        environment: Mapping[str, str] | None = None,
        arguments: Sequence[str] = (),
        code: str = "",
        command: Sequence[str] = (),
    ) -> None:
        self.executable = executable
        program = ["-c", code] if code else ["-m", f"dotsim_ros.nodes.{executable}.node"]
        started = [*(command or [sys.executable, "-u", *program]), "--ros-args", *arguments]
        for name, value in parameters.items():
            started += ["-p", f"{name}:={value}"]
        self._process = subprocess.Popen(
            started,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            env={**os.environ, **(environment or {})},
        )
        self._lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.append(line)
            print(line, end="", file=sys.stderr)

    @property
    def pid(self) -> int:
        """The process's number, to watch its memory by."""
        return self._process.pid

    def wait_for_line(self, text: str, *, timeout_s: float) -> None:
        """Wait until the node has logged a line that holds `text`.

        Raises:
            OSError: it ended before, or the time is over.
        """
        end_s = time.monotonic() + timeout_s
        while not self.has_logged(text):
            if not self._reader.is_alive() or time.monotonic() > end_s:
                raise OSError(f"{self.executable} did not get as far as {text!r}")
            time.sleep(0.02)

    def has_logged(self, text: str) -> bool:
        """Return whether a line of the log holds `text`."""
        return any(text in line for line in list(self._lines))

    def signal(self, number: int) -> None:
        """Send a signal to the node."""
        self._process.send_signal(number)

    def wait(self) -> int:
        """Wait for the node to end by itself and return its exit status."""
        status = self._process.wait()
        self._reader.join()
        return status

    def stop(self) -> int:
        """Stop the node with SIGINT, as a user does, and return its exit status.

        One that does not end in time is killed.
        """
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
        return self.wait()
