# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A unit of a sensor with a hidden effect, measured along protocols: a data set as an owner records
it, with the errors that a unit, a model and instruments have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.motion import Motion
from dotsim_ros.data.presses import Press
from dotsim_ros.data.scripted import Site, press_hold_release, slide
from dotsim_ros.data.trajectory import PoseChannel, SkinChannel, Trajectory, WrenchChannel
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SolveError
from dotsim_ros.twin.simulator import GelSimulator
from studies.hidden.reality import Truth, answer_of
from studies.reference.results import FINE_STEP_M

UNIT_STIFFNESS = 0.03
"""Units differ by so much, one deviation."""
SKIN_NOISE_M, FORCE_NOISE_N, POSE_NOISE_M = 0.04e-3, 0.015, 0.015e-3
MODEL_FORCE, MODEL_SKIN = 0.03, 0.02
"""What a model of the gel is off by: a share of the force, and of the depth over the skin."""
BUMP_M = 2.5e-3
FIRST_STAMP_NS = 1_000_000_000


def protocols(random: np.random.Generator) -> list[tuple[str, str, Motion, FloatArray]]:
    """Return name, indenter, motion and (F,) times of the frames of each trajectory: holds, presses
    with two indenters, and slides, at drawn places."""
    found = []
    for number in range(2):
        motion = press_hold_release(_site(random), depth_m=2.4e-3, hold_s=3.0)
        found.append(
            (f"hold_{number}", "sphere_4mm", motion, np.linspace(0.0, motion.duration_s, 12))
        )
    for number, indenter in enumerate(("sphere_4mm", "sphere_4mm", "cone")):
        motion = press_hold_release(_site(random), depth_m=2.4e-3, hold_s=0.0)
        half = motion.duration_s / 2.0
        times = np.linspace(0.0, motion.duration_s, 12)
        found.append((f"press_{indenter}_{number}", indenter, motion, times[times <= half]))
    for number in range(2):
        motion = slide(
            _site(random),
            depth_m=2.2e-3,
            distance_m=2.0e-3,
            heading_rad=float(random.uniform(0.0, 2.0 * np.pi)),
            slide_speed_m_s=0.005,
        )
        times = np.linspace(0.0, motion.duration_s, 13)
        found.append((f"slide_{number}", "sphere_4mm", motion, times[: len(times) - 3]))
    return found


def _site(random: np.random.Generator) -> Site:
    return Site(
        tilt_rad=float(random.uniform(0.0, 0.4)),
        azimuth_rad=float(random.uniform(0.0, 2.0 * np.pi)),
        clearance_m=0.1e-3,
    )


def measure_unit(
    directory: Path,
    sensor: SensorSpecification,
    skin: SkinMesh,
    truth: Truth,
    *,
    seed: int,
    only: Sequence[str] = (),
) -> None:
    """Write a data set of a unit.

    Args:
        directory: of the data set, which must not exist.
        sensor: that the unit is one of.
        skin: whose vertices the clouds list.
        truth: what is wrong with the unit.
        seed: of places, of the unit's constants and of all errors.
        only: names of the protocols to measure; none for all.

    Raises:
        FileExistsError: there is a data set.
    """
    if directory.exists():
        raise FileExistsError(f"{directory} exists; name a folder that does not")
    random = np.random.default_rng(seed)
    values = values_of(sensor)
    stiffness = values.youngs_modulus_pa * (1.0 + UNIT_STIFFNESS * random.standard_normal())
    values = replace(values, youngs_modulus_pa=stiffness)
    simulator = GelSimulator(sensor, skin, tolerance_m=5.0e-6)
    data_set = DataSetWriter(directory, skin, indenter_step_m=FINE_STEP_M)
    planned = [p for p in protocols(random) if not only or p[0] in only]
    session_s = 0.0
    for number, (name, indenter_name, motion, time_s) in enumerate(planned):
        indenter = replace(load_indenter(indenter_name), name=indenter_name)
        poses = [motion.at(float(t)) for t in time_s]
        press = Press(name, indenter_name, poses, time_s + 1.0)
        solve = partial(answer_of, simulator, values, indenter, seed=seed, number=number)
        try:
            _, without = solve(press, Truth(()), session_s=0.0)
            press = replace(press, force_n=without)
            skin_m, force_n = solve(press, truth, session_s=session_s)
        except SolveError:
            continue
        session_s += float(np.ptp(time_s))
        data_set.add(_measured(press, skin_m, force_n, skin.rest_position_m, random), indenter)


def _measured(
    press: Press,
    skin_m: FloatArray,
    force_n: FloatArray,
    rest_m: FloatArray,
    random: np.random.Generator,
) -> Trajectory:
    """Return a trajectory as instruments give it, with what a model is off by."""
    stamp = FIRST_STAMP_NS + np.round(1e9 * (press.stamp_s - press.stamp_s[0])).astype(np.int64)
    depth = np.linalg.norm(skin_m - rest_m, axis=2).max(axis=1)
    contact = rest_m[int(np.argmax(np.linalg.norm(skin_m - rest_m, axis=2).max(axis=0)))]
    off = np.zeros_like(skin_m)
    for _ in range(4):
        middle = contact + 3.0e-3 * random.standard_normal(3)
        bump = np.exp(-np.sum((rest_m - middle) ** 2, axis=1) / (2.0 * BUMP_M**2))
        off += depth[:, None, None] * bump[:, None] * (MODEL_SKIN * random.standard_normal(3))
    seen = skin_m + off + SKIN_NOISE_M * random.standard_normal(skin_m.shape)
    load = force_n * (1.0 + MODEL_FORCE * random.standard_normal())
    load = load * (1.0 + 0.3 * MODEL_FORCE * random.standard_normal((len(load), 1)))
    load = load + FORCE_NOISE_N * random.standard_normal(load.shape)
    position = np.stack([pose.position_m for pose in press.poses])
    position = position + POSE_NOISE_M * random.standard_normal(position.shape)
    quaternion = np.stack([pose.quaternion_xyzw for pose in press.poses])
    return Trajectory(
        pose=PoseChannel(stamp, position, quaternion),
        wrench=WrenchChannel(stamp, load, np.zeros_like(load)),
        skin=SkinChannel(stamp, seen.astype(np.float32)),
        name=press.name,
    )
