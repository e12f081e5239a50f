# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The report of a calibration: its page by itself, and what it says."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from calibration_result import calibration

from dotsim_ros.calibration.parameters import PARAMETERS
from dotsim_ros.calibration.report import figures, page_of, summary_lines, write_report
from dotsim_ros.io.page import as_markdown, images_of


def test_the_page_needs_nothing_beside_it(tmp_path):
    path = write_report(tmp_path, calibration(), seed=3)
    text = path.read_text(encoding="utf-8")
    assert text.count("<img ") == text.count('src="data:image/png;base64,') == 5
    assert "http" not in text
    assert json.loads((tmp_path / "report.json").read_text())["seed"] == 3


@pytest.mark.fault("calibrate", "a force in another unit")
@pytest.mark.parametrize(("unit", "newtons"), [("grams", 9.80665e-3), ("millinewtons", 1e-3)])
def test_a_force_in_another_unit_is_said_where_the_modulus_is_far_off(unit, newtons, answered):
    found = calibration()
    start_pa = found.problem.start.youngs_modulus_pa
    # Of a gel that is a tenth stiffer than its file says.
    recorded_pa = 1.1 * start_pa / newtons
    values = replace(found.values, youngs_modulus_pa=recorded_pa)
    said = [line for line in summary_lines(replace(found, values=values)) if "times that" in line]
    assert f"were it in {unit}, E is {1.1 * start_pa:.3g} Pa" in said[0]
    answered(said[0], what=f"a force in {unit}")
    assert not any("times that" in line for line in summary_lines(found))


def test_the_page_says_what_the_figures_hold():
    found = calibration(4)
    numbers = figures(found, seed=0)
    page = page_of(found, numbers)
    text = as_markdown(page)
    for name in ("E", "nu", "friction"):
        joint = numbers["parameters"][name]["joint"]
        # What the model itself is off by comes on top of what the presses differ by.
        assert joint["material"][0] < joint["low"] < joint["high"] < joint["material"][1]
    nu, error = numbers["parameters"]["nu"]["joint"], PARAMETERS["nu"].model_error
    assert error is not None
    inside, outside = (
        np.log(0.5 - end) - np.log(0.5 - nu["value"]) for end in (nu["low"], nu["material"][0])
    )
    assert outside**2 == pytest.approx(inside**2 + (1.96 * error) ** 2)
    assert f"nu {numbers['parameters']['nu']['joint']['value']:.4g} (" in page.lead
    assert f"E, Pa {numbers['parameters']['E']['joint']['value'] / 100:.0f}00 (" in page.lead
    assert "no message on /indenter/pose" in text
    assert "The data identify all parameters that were asked for." in text
    alternatives = [image.alt for image in images_of(page)]
    assert alternatives[0].startswith("E of single presses")
    assert "E from skin alone 1," in alternatives[3]
