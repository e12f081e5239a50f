# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Sensors that would silently give nonsense, or take all memory: refused by field, value, range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import load_sensor

FAULTS = {
    "an infinite stiffness": ("contact: {stiffness: .inf}", "contact.stiffness is inf"),
    "a modulus that is not a number": (
        "material: {youngs_modulus_pa: .nan}",
        "material.youngs_modulus_pa is nan",
    ),
    "an empty list for a section": ("gel: []", "section 'gel' is []"),
    "a number for a section": ("gel: 0", "section 'gel' is 0"),
    "part of a pixel": ("camera: {width: 640.7}", "camera.width is 640.7"),
    "text for a number": ('gel: {outer_radius_m: "0.01575"}', "gel.outer_radius_m is '0.01575'"),
    "a camera a metre away": (
        "camera: {position_m: [0, 0, -1]}",
        "camera.position_m is [0, 0, -1]",
    ),
    "a modulus of 1 TPa": (
        "material: {youngs_modulus_pa: 1.0e12}",
        "material.youngs_modulus_pa is 1000000000000",
    ),
    "a radius in millimetres": (
        "gel: {outer_radius_m: 15.75, core_radius_m: 6.0}",
        "did you mean 0.01575",
    ),
    "an image 20,000 pixels wide": ("camera: {width: 20000}", "camera.width is 20000"),
    "a grid of 1 um": ("solver: {grid_spacing_m: 1.0e-6}", "solver.grid_spacing_m is 1"),
    "a skin of 1 nm": ("gel: {skin_spacing_m: 1.0e-9}", "gel.skin_spacing_m is 1"),
    "a grid that takes 100 GB": (
        "solver: {grid_spacing_m: 0.0006, refined: false}",
        "GB",
    ),
    "a section with a slip of the pen": ("cameras: {width: 640}", "unknown sections ['cameras']"),
    "a field with a slip of the pen": ("gel: {radius_m: 0.01}", "'radius_m'"),
}


@pytest.mark.fault("sensor and YAML files", "")
@pytest.mark.parametrize("what", FAULTS)
def test_refused_by_field_value_and_range(
    what: str, tmp_path: Path, answered: Callable[..., None]
) -> None:
    text, expected = FAULTS[what]
    path = tmp_path / "sensor.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=r"sensor\.yaml") as refused:
        load_sensor(path)
    words = str(refused.value)
    assert expected in words
    assert "expected" in words or "known are" in words
    answered(words, what=what)


@pytest.fixture(scope="module")
def sensor() -> TactileSensor:
    """A small sensor under a ball."""
    coarse = load_sensor("flat_pad")
    solver = replace(coarse.solver, grid_spacing_m=1.6e-3, refined=False)
    return TactileSensor.load(replace(coarse, solver=solver), indenter="sphere_4mm")


POSES = {
    "a press a metre deep": (Pose.above_apex(depth_m=1.0), "is below the base of the gel"),
    "a press in millimetres": (Pose.above_apex(depth_m=0.5), "expected metres"),
    "an indenter 1,000 km away": (Pose([1e6, 0.0, 0.0]), "at most 100 m"),
    "an indenter at 1e300": (Pose([0.0, 0.0, 1e300]), "at most 100 m"),
}


@pytest.mark.fault("sensor and YAML files", "")
@pytest.mark.parametrize("what", POSES)
def test_poses_of_another_unit_are_refused(
    what: str, sensor: TactileSensor, answered: Callable[..., None]
) -> None:
    pose, expected = POSES[what]
    sensor.reset()
    with pytest.raises(ValueError, match=expected) as refused:
        sensor.press(pose)
    answered(refused.value, what=what)


def test_a_way_of_fifty_metres_takes_no_longer_than_the_gel_is_wide(sensor: TactileSensor) -> None:
    """It is followed only where it can touch the gel; there it is followed as any other."""
    sensor.reset()
    sensor.press(Pose([0.0, 0.0, 50.0]))
    frame = sensor.press(Pose.above_apex(depth_m=5e-4))
    force = frame.wrench.force_n
    sensor.reset()
    near = sensor.press(Pose.above_apex(depth_m=5e-4)).wrench.force_n
    assert force[2] > 0.05
    assert np.allclose(force, near, rtol=2e-3, atol=1e-5)
    # Across and below, where the way passes through the gel, it is refused as before.
    sensor.press(Pose([0.0, 0.0, 20.0]))
    with pytest.raises(ValueError, match="rigid core or base"):
        sensor.press(Pose([0.0, 0.0, -20.0]))
