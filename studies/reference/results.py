# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presses that CalculiX has solved: trajectories of a data set with what they were solved for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.data.data_set import INDEX, find_indenter, read_data_set
from dotsim_ros.data.motion import at_speed
from dotsim_ros.data.trajectory import (
    PoseChannel,
    SkinChannel,
    Trajectory,
    WrenchChannel,
    read_trajectory,
)
from dotsim_ros.gel.make import law_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import read_yaml
from dotsim_ros.specification import SensorSpecification, sensor_from
from studies.reference.axisymmetric import AxisymmetricDeck, AxisymmetricSettings, dome_section
from studies.reference.deck import Deck
from studies.reference.mesh import interpolate_skin
from studies.reference.press import ReferencePress, reference_deck
from studies.reference.run import Solution, SolvedStep, solve, solve_section

FINE_STEP_M = 50e-6
"""Length of the edges in an indenter's mesh, so that it is none of what two solvers differ by."""

SPEED_M_S = 0.005
TURN_RATE_RAD_S = 0.5
FIRST_STAMP_NS = 1_000_000_000


def stamps_ns(poses: Sequence[Pose]) -> NDArray[np.int64]:
    """Return (F,) stamps of poses that follow each other at 5 mm/s, or 0.5 rad/s, from 1 s."""
    motion = at_speed(poses, speed_m_s=SPEED_M_S, rotation_rate_rad_s=TURN_RATE_RAD_S)
    return FIRST_STAMP_NS + np.round(1e9 * motion.time_s).astype(np.int64)


def _trajectory(
    poses: Sequence[Pose],
    displacement_m: Sequence[FloatArray],
    steps: Sequence[SolvedStep],
    skin: SkinMesh,
    name: str,
) -> Trajectory:
    """Return solved frames, displacements (V, 3) of the skin, behind a first without contact."""
    poses = poses[: len(steps) + 1]
    stamp_ns = stamps_ns(poses)
    rest, nothing = skin.rest_position_m, np.zeros(3)
    position = [rest, *(rest + moved for moved in displacement_m)]
    return Trajectory(
        pose=PoseChannel(
            stamp_ns,
            np.array([pose.position_m for pose in poses]),
            np.array([pose.quaternion_xyzw for pose in poses]),
        ),
        wrench=WrenchChannel(
            stamp_ns,
            np.array([nothing, *(step.force_n for step in steps)]),
            np.array([nothing, *(step.torque_nm for step in steps)]),
        ),
        skin=SkinChannel(stamp_ns, np.array(position, dtype=np.float32)),
        name=name,
    )


def solved_press(
    press: ReferencePress,
    skin: SkinMesh,
    *,
    thread_count: int = 1,
    keep: Path | None = None,
    time_limit_s: float | None = None,
) -> tuple[Trajectory, Solution]:
    """Run CalculiX on a press; return the frames it solved and what it took.

    Args:
        press: what to solve.
        skin: of the sensor; the trajectory lists its vertices.
        thread_count, keep, time_limit_s: see `solve`.

    Raises:
        CalculixMissingError: it is not installed.
        CalculixError: it solved no frame at all.
        ValueError: the gel is no dome around a core, or is not touched.
    """
    if isinstance(press.settings, AxisymmetricSettings):
        return _solved_section(press, press.settings, skin, thread_count, keep, time_limit_s)
    deck = reference_deck(press.specification, skin, press.indenter, press.poses(), press.settings)
    return solved_deck(
        deck,
        skin,
        press.name,
        thread_count=thread_count,
        keep=keep,
        time_limit_s=time_limit_s,
    )


def solved_deck(
    deck: Deck, skin: SkinMesh, name: str, **effort: Any
) -> tuple[Trajectory, Solution]:
    """Run CalculiX on any deck; return the frames it solved, under a name, and what it took.

    Further arguments and errors are those of `solve`.
    """
    solution = solve(deck, **effort)
    at = interpolate_skin(deck.gel, skin.rest_position_m)
    moved = [at.of(step.displacement_m) for step in solution.steps]
    return _trajectory(deck.frame_poses(), moved, solution.steps, skin, name), solution


def _solved_section(
    press: ReferencePress,
    settings: AxisymmetricSettings,
    skin: SkinMesh,
    thread_count: int,
    keep: Path | None,
    time_limit_s: float | None,
) -> tuple[Trajectory, Solution]:
    """As `solved_press`, in two dimensions."""
    poses = press.poses()
    apex_m = press.specification.gel.outer_radius_m
    section = dome_section(press.specification.gel, settings)
    deck = AxisymmetricDeck(
        section=section,
        indenter=press.indenter,
        apex_m=apex_m,
        depth_m=[apex_m - float(pose.position_m[2]) for pose in poses],
        law=law_of(press.specification.material),
        contact=press.specification.contact,
        settings=settings,
    )
    solution = solve_section(deck, thread_count=thread_count, keep=keep, time_limit_s=time_limit_s)
    rest = skin.rest_position_m
    across = np.linalg.norm(rest[:, :2], axis=1)
    angle = np.arctan2(across, rest[:, 2])
    direction = rest[:, :2] / np.maximum(across, 1e-12)[:, None]
    skin_angle = np.arctan2(*section.node_m[section.skin_node].T)
    moved = []
    for step in solution.steps:
        sideways, up = (
            np.interp(angle, skin_angle, step.displacement_m[section.skin_node, axis])
            for axis in (0, 2)
        )
        moved.append(np.concatenate([sideways[:, None] * direction, up[:, None]], axis=1))
    return _trajectory(poses, moved, solution.steps, skin, press.name), solution


@dataclass(frozen=True)
class SolvedPress:
    """A trajectory with what it was solved for.

    Attributes:
        specification: the sensor: name, gel, material and contact.
        indenter: of the mesh that the data set holds.
        trajectory: its frames; fewer than asked for where CalculiX stopped.
        notes: of the index.
    """

    specification: SensorSpecification
    indenter: Indenter
    trajectory: Trajectory
    notes: Mapping[str, Any]


def read_solved_presses(directory: Path) -> tuple[SkinMesh, list[SolvedPress]]:
    """Return skin and presses of a data set that `python -m studies reference_presses` wrote.

    Raises:
        FileNotFoundError: there is no data set.
        ValueError: an entry does not state what it was solved for, so it is not a reference's.
    """
    data_set = read_data_set(directory)
    content = read_yaml(directory / INDEX)
    indenters: dict[str, Indenter] = {}
    presses = []
    for entry, record in zip(data_set.entries, content["trajectories"], strict=True):
        if "sensor" not in record:
            raise ValueError(
                f"{directory / INDEX}: {entry.name} names no sensor that it was solved for; "
                "expected a data set that python -m studies reference_presses wrote"
            )
        sensor = sensor_from(record["sensor"], f"{directory / INDEX}, {entry.name}")
        if entry.indenter not in indenters:
            indenters[entry.indenter] = find_indenter(data_set, entry.indenter)
        # A spacing's decimal point in the name is no suffix.
        trajectory = replace(read_trajectory(entry.bag), name=entry.name)
        presses.append(SolvedPress(sensor, indenters[entry.indenter], trajectory, record))
    return data_set.skin_mesh(), presses
