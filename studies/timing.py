# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What studies that take times have in common: percentiles, and a machine that others use."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager

import numpy as np

from dotsim_ros.io.arrays import FloatArray

BUSY = """
import os, sys
os.sched_setaffinity(0, {int(sys.argv[1])})
starter = os.getppid()
while os.getppid() == starter:
    for _ in range(1_000_000):
        pass
"""
"""Ends by itself where its starter has ended."""


def percentiles_ms(
    times_s: Sequence[float] | FloatArray, percents: Sequence[int] = (50, 95, 99)
) -> dict[str, float]:
    """Return percentiles of times as milliseconds: `p50_ms` and so on, and `max_ms` for 100."""
    values = np.percentile(1e3 * np.asarray(times_s), percents).round(2).tolist()
    names = ["max_ms" if percent == 100 else f"p{percent}_ms" for percent in percents]
    return dict(zip(names, values, strict=True))


def competition(is_wanted: bool) -> AbstractContextManager[None]:
    """Keep each core busy with a process of the usual priority, where wanted."""
    return busy_cores(sorted(os.sched_getaffinity(0)) if is_wanted else [])


@contextmanager
def busy_cores(cores: Sequence[int]) -> Iterator[None]:
    """Keep cores busy with a process each."""
    busy = [subprocess.Popen([sys.executable, "-c", BUSY, str(core)]) for core in cores]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()
