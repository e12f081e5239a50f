# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Indenter classification in small: a unit is filmed, and its images are classified."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from work_here import open_pool_here

from dotsim_ros import TactileSensor, load_sensor
from dotsim_ros.data.data_set_writer import trajectory_of_frames, write_data_set
from dotsim_ros.gel.distance_field import indenter_field
from dotsim_ros.gel.implicit import contact
from dotsim_ros.geometry.indenter import cone, flat_punch, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.worker_pool import pool
from dotsim_ros.specification import SensorSpecification, write_sensor
from studies.classification.domains import DOMAINS
from studies.classification.study import classification

SIZE = (96, 72)
INDENTERS = {
    "1_ball": sphere(0.004),
    "2_cone": cone(0.6, 0.01, 0.001),
    "3_punch": flat_punch(0.003, 0.01, 0.0005),
}
DEPTHS_M = (-0.2e-3, 0.8e-3, 1.6e-3)


def small(image: ImageArray) -> ImageArray:
    return np.asarray(cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA))


@pytest.fixture(autouse=True)
def quick_presses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Press with distances of the meshes that are as coarse as the gel; to sample them as finely as
    a gel of full resolution needs took longer than all presses."""
    monkeypatch.setattr(pool, "open_worker_pool", open_pool_here)
    monkeypatch.setattr(contact, "indenter_field", partial(indenter_field, spacing_m=0.4e-3))


@pytest.fixture(scope="module")
def sensor() -> SensorSpecification:
    sensor = load_sensor("densetact2")
    return replace(
        sensor,
        gel=replace(sensor.gel, skin_spacing_m=1.2e-3),
        solver=replace(sensor.solver, refined=False, grid_spacing_m=3.6e-3),
    )


@pytest.fixture(scope="module")
def unit(sensor: SensorSpecification, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the unit's data set and its sensor's file."""
    folder = tmp_path_factory.mktemp("unit")
    write_sensor(folder / "small.yaml", sensor, "A coarse sensor.")
    film = TactileSensor(sensor, indenter=INDENTERS["1_ball"])
    presses = []
    for name, indenter in INDENTERS.items():
        film.set_indenter(indenter)
        for number in range(2):
            film.reset()
            apex = film.skin.apex_m
            poses = [
                Pose.above_apex(depth, x_m=1e-3 * number, yaw_rad=0.7 * number).on(apex)
                for depth in DEPTHS_M
            ]
            frames = [film.step(pose) for pose in poses]
            frames = [replace(frame, image=small(frame.image)) for frame in frames]
            presses.append((trajectory_of_frames(frames, name=f"{name}_{number}"), indenter))
    write_data_set(
        folder / "data",
        presses,
        skin=film.skin,
        idle_images=[small(film.idle_image)] * 2,
        indenter_step_m=0.5e-3,
    )
    return folder


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of what was made before: the models of a domain share its presses."""
    return tmp_path_factory.mktemp("kept")


def rows_in(kept: Path) -> dict[Path, int]:
    """Return when each row that is kept was written."""
    return {path: path.stat().st_mtime_ns for path in kept.rglob("*.json")}


def classify(unit: Path, images: Path, kept: Path, **given: Any) -> dict[str, Any]:
    few: dict[str, Any] = {"classifiers": 2, "presses": 2, "epochs": 1, "real_ball": False}
    source = {"data": unit / "data", "sensor": str(unit / "small.yaml")}
    return classification(**{**source, **few, "images": images, "cache": kept, **given})


def test_rows_are_made_once(unit: Path, tmp_path: Path, kept: Path) -> None:
    found = classify(unit, tmp_path, kept, models=("bound", "idle"))
    assert cv2.imread(str(tmp_path / "classification.png")) is not None
    assert set(DOMAINS) < set(found)
    for name in DOMAINS:
        rows = found[name]
        classes = 3 if name == "all_six" else 2
        for model, row in rows.items():
            # Each indenter was filmed twice, with two frames in contact.
            assert row["frames"] == 4 * classes
            assert row["trajectories"] == 2 * classes
            assert np.sum(row["confusion"]) == 2 * row["frames"]
            told_right = np.trace(row["confusion"]) / (2 * row["frames"])
            assert row["mean"] == pytest.approx(told_right)
            assert (row["simulated"] is None) == (model == "bound")
        # The idle image shows no touch, so whatever is learnt from it tells nothing apart.
        assert rows["idle"]["balanced"]["mean"] == pytest.approx(1.0 / classes)
    # Out of the domain nothing measured of the classes is there to learn from: the same bound.
    bounds = [found[name]["bound"] for name in ("in_domain", "out_of_domain")]
    assert bounds[0]["seeds"] == bounds[1]["seeds"]
    before = rows_in(kept)
    assert len(before) == 2 * len(DOMAINS)
    assert classify(unit, tmp_path, kept, models=("bound", "idle")) == found
    assert rows_in(kept) == before
