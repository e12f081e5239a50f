# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`make canary` notices what changes by 2 %, and a sign of a kernel."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
from programs import ROOT, program
from scipy.spatial.transform import Rotation

from dotsim_ros.specification import SensorSpecification


@pytest.fixture(scope="module")
def canary() -> ModuleType:
    return program("tools/canary.py")


def with_friction(sensor: SensorSpecification) -> SensorSpecification:
    contact = sensor.contact
    friction = 1.02 * contact.friction_coefficient
    return replace(sensor, contact=replace(contact, friction_coefficient=friction))


def with_stiffness(sensor: SensorSpecification) -> SensorSpecification:
    material = sensor.material
    youngs_modulus_pa = 1.02 * material.youngs_modulus_pa
    return replace(sensor, material=replace(material, youngs_modulus_pa=youngs_modulus_pa))


def with_tilt(sensor: SensorSpecification) -> SensorSpecification:
    tilt = Rotation.from_quat(sensor.camera.quaternion_xyzw).as_rotvec()
    x, y, z, w = Rotation.from_rotvec(1.02 * tilt).as_quat().tolist()
    return replace(sensor, camera=replace(sensor.camera, quaternion_xyzw=(x, y, z, w)))


@pytest.mark.parametrize(
    ("motion", "change", "noticed"),
    [
        ("slide", with_friction, {"force", "skin", "image", "seen"}),
        ("ball", with_stiffness, {"force"}),
        ("flat_face", with_tilt, {"image", "seen", "markers"}),
    ],
    ids=["friction", "stiffness", "tilt"],
)
def test_a_change_of_two_percent_is_noticed(
    canary: ModuleType,
    motion: str,
    change: Callable[[SensorSpecification], SensorSpecification],
    noticed: set[str],
) -> None:
    kept = canary.read_kept()[motion]
    entry = canary.MOTIONS[motion]
    sensor = entry.specification()
    same = canary.compare(canary.observe(entry, sensor), kept)
    assert {name for name, (_, words) in same.items() if words} == set()
    changed = canary.compare(canary.observe(entry, change(sensor)), kept)
    assert {name for name, (_, words) in changed.items() if words} == noticed


def test_the_sign_of_a_kernel_is_noticed(tmp_path: Path) -> None:
    for folder in ("dotsim_ros", "msg_adapters", "params", "tools", "test/canary"):
        skipped = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=skipped)
    kernels = tmp_path / "dotsim_ros" / "gel" / "implicit" / "contact_kernels.py"
    text = kernels.read_text(encoding="utf-8")
    friction = "                f -= (a * law.tangential_stiffness) * s\n"
    assert text.count(friction) == 1
    kernels.write_text(text.replace(friction, friction.replace("-=", "+=")), encoding="utf-8")
    # What the changed code computes is kept apart.
    environment = {
        **os.environ,
        "PYTHONPATH": str(tmp_path),
        "DOTSIM_ROS_CACHE": str(tmp_path / "cache"),
    }
    done = subprocess.run(
        [sys.executable, tmp_path / "tools" / "canary.py", "learned_image"],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert "learned_image: force is" in done.stdout
    assert "make canary KEEP=1" in done.stdout
