# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real presses of a ball told by classifiers, in small: a pad's touches, and what is reported."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import Delaunay

from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import GelSpecification, SolverSpecification
from studies.classification.classifier import ClassifierSettings
from studies.classification.real_ball import (
    BALL,
    SHAPES,
    BallStudy,
    evaluate_real_ball,
    laid,
)
from studies.optics.gelsight import SENSOR

COARSE = replace(
    SENSOR,
    gel=GelSpecification(shape="flat_pad", pad_size_m=(0.012, 0.012, 0.004), skin_spacing_m=0.6e-3),
    solver=SolverSpecification(grid_spacing_m=2.0e-3, refined=False),
)
PRESSES = 20


def grid() -> FloatArray:
    x, y = np.meshgrid(np.linspace(-5e-3, 5e-3, 41), np.linspace(-5e-3, 5e-3, 41))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def test_a_press_is_laid_elsewhere_with_its_turn() -> None:
    rest = grid()
    # A ridge along y, whose sides are pushed along x.
    field = np.zeros_like(rest)
    field[:, 2] = -np.exp(-((rest[:, 0] / 1e-3) ** 2) - (rest[:, 1] / 3e-3) ** 2)
    field[:, 0] = rest[:, 0]
    place, turn = np.array([1e-3, -0.5e-3]), 0.5 * np.pi
    moved = laid(Delaunay(rest[:, :2]), field, rest, place, turn) - rest
    deepest = rest[np.argmin(moved[:, 2]), :2]
    assert np.allclose(deepest, place, atol=1e-9)
    beside = np.argmin(np.linalg.norm(rest[:, :2] - place - [0.0, 1e-3], axis=1))
    # A quarter turn takes x to y.
    assert moved[beside, :2] == pytest.approx([0.0, 1e-3], abs=1e-6)
    along = np.argmin(np.linalg.norm(rest[:, :2] - place - [1e-3, 0.0], axis=1))
    assert moved[along, 2] < moved[beside, 2]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Return a folder of images that show a disc."""
    idle = np.full((80, 64, 3), 120, dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "idle.png"), idle)
    lines = ["img_names,center_x,center_y,radius"]
    for number in range(PRESSES):
        image = cv2.circle(idle.copy(), (20 + number % 5, 30), 12, (160, 90, 130), -1)
        cv2.imwrite(str(tmp_path / f"{number:04d}.png"), image)
        lines.append(f"{number:04d}.png,{20 + number % 5},30,12")
    (tmp_path / "contact_circles.csv").write_text("\n".join(lines), encoding="utf-8")
    return tmp_path


def test_every_real_press_is_classified_once_a_seed(recording: Path, tmp_path: Path) -> None:
    study = BallStudy(
        recording,
        models=("taxim",),
        touches=5,
        seeds=1,
        classifier=ClassifierSettings(side_px=32, epochs=1),
    )
    found = evaluate_real_ball(study, tmp_path / "state", sensor=COARSE)
    assert found["presses"] == PRESSES
    assert found["classes"] == list(SHAPES)
    (row,) = found["rows"].values()
    assert sum(row["told"]) == PRESSES
    # A classifier of each half is shown the untouched image.
    assert sum(row["idle_told"]) == 2
    assert row["called_ball"]["mean"] == pytest.approx(
        row["told"][list(SHAPES).index(BALL)] / PRESSES
    )
