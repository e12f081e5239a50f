# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The check of a device and its speed with many sensors, with the CPU as the device."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros import TactileArray, TactileSensor
from studies.run import FAILED
from studies.speed.device_check import CASES, coarse, device_check, is_same
from studies.speed.many_on_device import differing, on_device


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


def test_many_sensors_on_a_device_are_compared_timed_counted_and_bounded(capsys):
    figures = on_device("cpu", coarse(), (1, 10**9), 1000.0, shapes=("sphere_4mm",))
    assert figures[FAILED] == []
    assert {row["motion"]: row["skin_um"] for row in figures["compared"]} == {
        "press": 0.0,
        "press with fixed counts": 0.0,
        "slide": 0.0,
        "slide with fixed counts": 0.0,
    }
    found = figures["1"]
    kinds = {"with_images", "gel", "gel_fixed", "large_image"}
    assert found.keys() == kinds | {"gel_frames_per_second"}
    for kind in kinds:
        assert 0.0 < found[kind]["gel_frames_per_second"] <= found[kind]["bound"]
    refused = figures["1000000000"]["with_images"]["refused"]
    assert "at most" in refused
    assert refused in capsys.readouterr().out


def test_an_answer_that_is_not_the_cpus_has_failed():
    row = {"motion": "press", "shape": "ball", "skin_um": 1.0, "force_percent": 0.1}
    assert not differing([row])
    for wrong in ({"skin_um": 20.0}, {"force_percent": float("nan")}):
        assert len(differing([row | wrong])) == 1


@pytest.mark.parametrize(
    "make",
    [
        lambda device: TactileSensor.load(device=device),
        lambda device: TactileArray("densetact2", 2, device=device),
        lambda device: on_device(device, coarse(), (1,), 1.0),
    ],
)
def test_a_device_that_is_not_there_is_refused_in_a_line(make):
    with pytest.raises(ValueError, match=r"^there is no device 'cuda:99' .*, expected .*cpu"):
        make("cuda:99")
