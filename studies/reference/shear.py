# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Both gels against CalculiX where the way there matters: slides, corners, a lift and a twist.

A ball is pressed on the dome's apex and moved on six ways. OUT keeps those that CalculiX has
solved; what it holds is not solved again. One way is solved on a finer mesh and in shorter
increments too: they tell the reference's own error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.trajectory import Trajectory, read_trajectory
from dotsim_ros.gel.batched.memory import Grid
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import ApexPose, Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.twin.follow import GelAnswer
from studies.geometry.batched_model import GelsOfBatch
from studies.reference.blocks import StepControl
from studies.reference.comparison import compare, implicit_step
from studies.reference.deck import Deck
from studies.reference.press import ReferenceSettings, notes_of, reference_deck
from studies.reference.results import solved_deck
from studies.reference.run import CalculixError, calculix_version
from studies.reference.study import sensor
from studies.run import FAILED, expect_known

SENSOR = sensor("neo_hookean")
BALL = load_indenter("sphere_4mm")
HELD_GOAL = 0.08
NORMAL_GOAL = 0.05
ENERGY_GOAL = 0.05

JUDGED_SHARE = 0.2
"""Errors are shares of the reference's own value, in frames where it is at least this share of its
largest in the motion."""

AIR, DEEP = -0.02, 1.0

Knot = tuple[int, float, float, float, float]
"""Frames from the knot before; there, x, y and depth below the apex in mm, and the turn about the
indenter's axis in degrees."""

MOTIONS: dict[str, Sequence[Knot]] = {
    "press_then_slide": [
        (0, -0.5, 0, AIR, 0),
        (3, -0.5, 0, DEEP, 0),
        (4, 0.5, 0, DEEP, 0),
    ],
    "slide_then_press": [
        (0, -0.5, 0, AIR, 0),
        (2, -0.5, 0, 0.4, 0),
        (3, 0.5, 0, 0.4, 0),
        (2, 0.5, 0, DEEP, 0),
    ],
    "square": [
        (0, -0.5, -0.5, AIR, 0),
        (3, -0.5, -0.5, DEEP, 0),
        (3, 0.5, -0.5, DEEP, 0),
        (3, 0.5, 0.5, DEEP, 0),
        (3, -0.5, 0.5, DEEP, 0),
        (3, -0.5, -0.5, DEEP, 0),
    ],
    "lift_while_sliding": [
        (0, -0.75, 0, AIR, 0),
        (3, -0.75, 0, DEEP, 0),
        (2, -0.25, 0, DEEP, 0),
        (4, 0.75, 0, 0.1, 0),
    ],
    "drag": [
        (0, -0.5, 0, AIR, 0),
        (3, -0.5, 0, DEEP, 0),
        (5, 0.75, 0, DEEP, 0),
        (4, -0.25, 0, DEEP, 0),
    ],
    "twist": [
        (0, 0, 0, AIR, 0),
        (3, 0, 0, DEEP, 0),
        *((1, 0, 0, DEEP, turn) for turn in (5, 10, 15, 20, 15, 10, 5, 0)),
    ],
}

COARSE = ReferenceSettings(
    spacing_m=2.0e-3,
    surface_step_m=0.3e-3,
    reach_m=0.5e-3,
    control=StepControl(first=0.2, largest=0.4),
    growth=2.0,
)
CASES: dict[str, tuple[str, ReferenceSettings]] = {
    **{motion: (motion, COARSE) for motion in MOTIONS},
    "finer_mesh": (
        "press_then_slide",
        replace(COARSE, spacing_m=1.4e-3, surface_step_m=0.2e-3),
    ),
    "shorter_increments": (
        "press_then_slide",
        replace(COARSE, drag_increment_m=0.5 * COARSE.drag_increment_m),
    ),
}
"""What CalculiX solves: each motion, and one in two ways more for its own error."""

Step = Callable[[Pose, float], GelAnswer]


def batched_step(grid: Grid, skin: SkinMesh) -> Step:
    """Return what moves the indenter of a batch of one gel to a pose."""
    gel = GelsOfBatch(SENSOR, grid, [BALL], skin)
    return lambda pose, dt_s: gel.step([pose], dt_s)[0]


GELS: dict[str, Callable[[SkinMesh], Step]] = {
    "implicit": lambda skin: implicit_step(SENSOR, skin, BALL),
    "batched": lambda skin: batched_step("default", skin),
    "batched, fine": lambda skin: batched_step("fine", skin),
}


def deck_of(motion: str, settings: ReferenceSettings, skin: SkinMesh) -> Deck:
    """Return what CalculiX is to compute for a motion, straight between its knots."""
    apex_m = np.array([0.0, 0.0, SENSOR.gel.outer_radius_m])
    poses = [
        ApexPose(1e-3 * depth, 1e-3 * x, 1e-3 * y, np.radians(turn)).on(apex_m)
        for _, x, y, depth, turn in MOTIONS[motion]
    ]
    deck = reference_deck(SENSOR, skin, BALL, poses, settings)
    return replace(deck, frames=[knot[0] for knot in MOTIONS[motion][1:]])


@dataclass(frozen=True)
class Run:
    """A motion, and what a gel does to its indenter in each frame.

    Attributes:
        position_m, quaternion_xyzw: (F, 3), (F, 4) of the indenter's frame in the base frame.
        force_n, torque_nm: (F, 3) of the gel on the indenter, about the base frame's origin.
    """

    position_m: FloatArray
    quaternion_xyzw: FloatArray
    force_n: FloatArray
    torque_nm: FloatArray

    @property
    def rotation(self) -> Rotation:
        """From the indenter's frame to the base frame."""
        return Rotation.from_quat(self.quaternion_xyzw)

    @property
    def tip_torque_nm(self) -> FloatArray:
        """(F, 3) about the indenter's origin, along the axes of the base frame."""
        return self.torque_nm - np.cross(self.position_m, self.force_n)

    def dissipated_j(self) -> float:
        """Return the work of the indenter's moves across its axis and turns. That of moves along
        it is the gel's elasticity: over a way back to the same depth nothing of it is left."""
        moved = np.diff(self.position_m, axis=0)
        axis = self.rotation.apply([0.0, 0.0, 1.0])[1:]
        moved -= np.sum(moved * axis, axis=1, keepdims=True) * axis
        turned = (self.rotation[1:] * self.rotation[:-1].inv()).as_rotvec()
        return -float(np.sum(_middle(self.force_n) * moved + _middle(self.tip_torque_nm) * turned))

    def normal_n(self) -> FloatArray:
        """Return the force along the indenter's axis (F, 1)."""
        return self.rotation.apply(self.force_n, inverse=True)[:, 2:]

    def held(self) -> FloatArray:
        """Return what holds the indenter: the torque about its axis (F, 1) in N m if it turns, the
        force across the axis (F, 2) in N otherwise."""
        if np.ptp(self.quaternion_xyzw, axis=0).any():
            return self.rotation.apply(self.tip_torque_nm, inverse=True)[:, 2:]
        return self.rotation.apply(self.force_n, inverse=True)[:, :2]


def _middle(values: FloatArray) -> FloatArray:
    return 0.5 * (values[1:] + values[:-1])


def score(ours: Run, true: Run) -> dict[str, Any]:
    """Return how far the forces and the energy of one run of a motion are from those of another."""
    our_energy_j, true_energy_j = ours.dissipated_j(), true.dissipated_j()
    return {
        "held": _spread(ours.held(), true.held()),
        "normal": _spread(ours.normal_n(), true.normal_n()),
        "dissipated_mj": 1e3 * our_energy_j,
        "reference_dissipated_mj": 1e3 * true_energy_j,
        "energy_error": our_energy_j / true_energy_j - 1.0,
    }


def _spread(ours: FloatArray, true: FloatArray) -> dict[str, float]:
    size = np.linalg.norm(true, axis=1)
    judged = size >= JUDGED_SHARE * size.max()
    error = np.linalg.norm(ours - true, axis=1)[judged] / size[judged]
    return {
        "median": float(np.median(error)),
        "p95": float(np.percentile(error, 95.0)),
        "worst": float(error.max()),
    }


def solved_cases(
    out: Path, names: Sequence[str], skin: SkinMesh, processes: int
) -> tuple[dict[str, Trajectory], list[str]]:
    """Return the cases as far as CalculiX solved them, by name, and why not to their end.

    Args:
        out: of the data set.
        names: of cases.
        skin: of the sensor.
        processes: of CalculiX at a time, for those that the data set does not hold; 0 for none.
    """
    data_set = DataSetWriter(out, skin)
    version = calculix_version()
    notes = {}
    for name in names:
        motion, settings = CASES[name]
        knots = [list(knot) for knot in MOTIONS[motion]]
        notes[name] = notes_of(SENSOR, settings) | {"motion": knots, "calculix": version}

    def solve(name: str) -> tuple[str, Trajectory | None, str]:
        motion, settings = CASES[name]
        try:
            trajectory, solution = solved_deck(deck_of(motion, settings, skin), skin, name)
        except CalculixError as error:
            return name, None, str(error)
        return name, trajectory, solution.failure

    failures = []
    missing = [name for name in names if not data_set.holds(name, notes[name])]
    if processes == 0:
        failures, missing = [f"{name}: not solved to its end" for name in missing], []
    with ThreadPoolExecutor(max(1, processes)) as pool:
        for name, trajectory, failure in pool.map(solve, missing):
            print(f"{name}: {failure or 'solved'}", flush=True)
            if failure:
                failures.append(f"{name}: {failure}")
            if trajectory is not None:
                data_set.add(trajectory, BALL, notes[name], failure=failure)
    found = {name: data_set.notes(name) or {} for name in names}
    asked = [name for name in names if found[name].items() >= notes[name].items()]
    return {name: read_trajectory(data_set.bag(name)) for name in asked}, failures


def run_of(solved: Trajectory) -> Run:
    """Return what CalculiX found."""
    assert solved.pose is not None
    assert solved.wrench is not None
    pose, wrench = solved.pose, solved.wrench
    return Run(pose.position_m, pose.quaternion_xyzw, wrench.force_n, wrench.torque_nm)


def shear(
    *,
    out: Path = Path("out/shear"),
    motions: tuple[str, ...] = tuple(MOTIONS),
    gels: tuple[str, ...] = tuple(GELS),
    processes: int = 2,
) -> dict[str, Any]:
    """Both gels against CalculiX in slides, corners, lifts and a twist, and what they dissipate.

    Args:
        out: folder of the solved motions.
        motions: that are solved and judged.
        gels: that are judged.
        processes: of CalculiX at a time; 0 to judge what OUT holds.
    """
    expect_known("motion", motions, MOTIONS)
    expect_known("gel", gels, GELS)
    skin = skin_of(SENSOR.gel)
    names = [name for name, (motion, _) in CASES.items() if motion in motions]
    solved, failures = solved_cases(out, names, skin, processes)
    runs = {name: run_of(trajectory) for name, trajectory in solved.items()}
    scores: dict[str, dict[str, Any]] = {}
    rows: list[dict[str, Any]] = []
    for motion in [name for name in motions if name in solved]:
        true = runs[motion]
        for gel in gels:
            frames = compare(GELS[gel](skin), skin, BALL, solved[motion])
            force_n, torque_nm = (
                np.array([np.zeros(3), *(frame[key] for frame in frames)])
                for key in ("our_force_n", "our_torque_nm")
            )
            ours = replace(true, force_n=force_n, torque_nm=torque_nm)
            scores.setdefault(motion, {})[gel] = score(ours, true)
            rows += [{"motion": motion, "gel": gel, **frame} for frame in frames]
    own = {}
    for name in runs.keys() - MOTIONS.keys():
        coarse = runs.get(CASES[name][0])
        if coarse is not None and len(coarse.force_n) == len(runs[name].force_n):
            own[name] = score(coarse, runs[name])
    return {
        "calculix": calculix_version(),
        "goals": {"held": HELD_GOAL, "normal": NORMAL_GOAL, "energy": ENERGY_GOAL},
        "motions": scores,
        "own_errors": own,
        "rows": rows,
        FAILED: failures,
    }
