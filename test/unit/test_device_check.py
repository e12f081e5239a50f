# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The check of a device, run with the CPU as the device."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
COMMAND = [sys.executable, str(ROOT / "benchmarks" / "device_check.py")]


def test_the_cpu_computes_what_the_cpu_computes(tmp_path: Path) -> None:
    file = tmp_path / "check.json"
    command = [*COMMAND, "--device", "cpu", "--cases", "sensor", "explicit", "--timed", "1"]
    command += ["--json", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    figures = json.loads(file.read_text())
    assert [row["difference"] for row in figures["rows"]] == [0.0] * 7
    assert all(row["is_right"] for row in figures["rows"])
    assert figures["not_run"] == []
    assert figures["frame_ms"].keys() == {"explicit"}
    assert figures["frame_ms"]["explicit"]["cpu"] > 0.0
    assert "dotsim_ros.gel.elastic_kernels.stress_tangent" in figures["ran"]


def test_a_device_that_is_not_there_is_named() -> None:
    command = [*COMMAND, "--device", "cuda:9"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 2
    assert "there is no device cuda:9 here; choose from cpu" in done.stderr
