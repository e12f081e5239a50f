# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs of the tests next to each other: no node of one may hear those of another."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

CODE = "from domains import take_domain; print(take_domain(last=2), flush=True); input()"


@contextmanager
def taker(folder: Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Run a process that takes one of two domains; give what it says, and the process."""
    process = subprocess.Popen(
        [sys.executable, "-c", CODE],
        cwd=Path(__file__).parent,
        env={**os.environ, "TMPDIR": str(folder)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip(), process
    finally:
        process.kill()
        process.communicate()


def test_a_domain_is_taken_once_and_free_again_when_its_taker_is_killed(tmp_path: Path) -> None:
    with taker(tmp_path) as (first, killed), taker(tmp_path) as (second, _):
        assert {first, second} == {"1", "2"}
        with taker(tmp_path) as (said, refused):
            assert said.startswith("Traceback")
            # Not `communicate`, which does not see what came with the first line.
            assert refused.stdout is not None
            assert "all 2 ROS domains are in use" in refused.stdout.read()
        killed.kill()
        killed.wait()
        with taker(tmp_path) as (again, _):
            assert again == first
