# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The check of a device, run with the CPU as the device."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
SCRIPT = str(ROOT / "studies" / "speed" / "device_check.py")
COMMAND = [sys.executable, SCRIPT]


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


def test_a_grey_level_is_no_fault_in_a_few_pixels_of_an_image_alone() -> None:
    is_same = runpy.run_path(SCRIPT)["is_same"]
    expected = np.full((20, 20, 3), 240.0)
    few, two = expected.copy(), expected.copy()
    few[:5, 0] += 1.0
    two[0, 0] += 2.0
    assert is_same("image", few, expected)
    assert not is_same("image", two, expected)
    assert not is_same("image", expected - 1.0, expected)
    assert not is_same("image", expected[1:], expected)
    assert not is_same("depth, m", few, expected)
