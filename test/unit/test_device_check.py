# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The check of a device, run with the CPU as the device."""

from __future__ import annotations

import numpy as np
import pytest

from studies.run import FAILED
from studies.speed.device_check import CASES, device_check, is_same


def test_the_cpu_computes_what_the_cpu_computes() -> None:
    figures = device_check(device="cpu", cases=("sensor",), timed=0)
    assert {row["difference"] for row in figures["rows"]} == {0.0}
    assert all(row["is_right"] for row in figures["rows"])
    assert figures[FAILED] == figures["not_run"] == []
    assert "dotsim_ros.gel.elastic_kernels.stress_tangent" in figures["ran"]


def test_a_result_that_differs_has_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter([np.ones(3), 1.01 * np.ones(3)])
    monkeypatch.setitem(CASES, "sensor", lambda device: {"skin, m": next(answers)})
    figures = device_check(device="cpu", cases=("sensor",), timed=0)
    assert figures[FAILED] == ["sensor: skin, m differs"]


def test_a_grey_level_is_no_fault_in_a_few_pixels_of_an_image_alone() -> None:
    expected = np.full((20, 20, 3), 240.0)
    few, two = expected.copy(), expected.copy()
    few[:5, 0] += 1.0
    two[0, 0] += 2.0
    assert is_same("image", few, expected)
    assert not is_same("image", two, expected)
    assert not is_same("image", expected - 1.0, expected)
    assert not is_same("image", expected[1:], expected)
    assert not is_same("depth, m", few, expected)
