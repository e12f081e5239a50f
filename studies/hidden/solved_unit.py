# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A unit of a sensor as finite elements (CalculiX) solve it, what is wrong with it included.

Nothing of the gel that the finder knows takes part: the mesh is of hexahedra, the contact is of
surface on surface, and relaxation, stiffening, core and base are in the problem that is solved.
"""

from __future__ import annotations

import errno
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from dotsim_ros.data.motion import Motion
from dotsim_ros.data.scripted import Site, press_hold_release, slide
from dotsim_ros.data.trajectory import PoseChannel, SkinChannel, Trajectory, WrenchChannel
from dotsim_ros.gel.material import Yeoh, bulk_modulus_pa, shear_modulus_pa
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import SkinMesh
from dotsim_ros.io.arrays import FloatArray, IntArray
from dotsim_ros.specification import SensorSpecification
from studies.hidden.solved_draw import SolvedUnit
from studies.reference.blocks import StepControl
from studies.reference.mesh import DomeMesh, interpolate_skin, pressed_place
from studies.reference.press import ReferenceSettings, reference_deck
from studies.reference.run import CalculixError, Solution, solve
from studies.reference.unit_deck import MaxwellBranch, OgdenStiffening, StiffPart, UnitDeck

SKIN_NOISE_M, FORCE_NOISE_N, POSE_NOISE_M = 0.04e-3, 0.015, 0.015e-3
FIRST_STAMP_NS = 1_000_000_000
SURFACE_STEP_M = 0.8e-3
"""Edges of the indenter's surface: its chords lie 20 um inside a ball of 4 mm radius."""
BRANCHES = ((0.6, 0.6), (0.4, 3.0))
"""Of `two_branches`: parts of the share, and times in seconds."""
INCLUSION_RATIO = 10.0
INCLUSION_RADIUS_M = 11.0e-3
"""Where an inclusion lies: so far from the dome's centre."""
PLACE_SHARE = 1.0
"""Elements are at most so large, of the radius of the place that is pressed: under a cone those of
3 mm are 12 % off in force and 0.3 mm on the skin, against those of 1.7 mm; those of 2.3 mm 3 % and
0.08 mm."""
COARSER = 1.3
SAME_PLACE_M = 1e-9
TIME_LIMIT_S = 7200.0
"""Far beyond what any takes, so that how busy a machine is decides nothing."""

LEAST_FREE_BYTES = 100_000_000
"""CalculiX's files of a trajectory are some ten megabytes."""

EFFORTS = (
    (1.0, StepControl(first=1.0, smallest=0.02, count=40)),
    (1.0, StepControl(first=0.2, smallest=2e-3, largest=0.5, count=120)),
    (COARSER, StepControl(first=0.2, smallest=2e-3, largest=0.5, count=120)),
)
"""How a trajectory is tried, one after the other: elements so many times as large, and
increments."""


@dataclass(frozen=True)
class Protocol:
    """One trajectory as it is planned.

    Attributes:
        name: of the trajectory.
        indenter: name of the shape.
        motion: of the indenter's frame.
        time_s: (F,) when a frame is recorded.
    """

    name: str
    indenter: str
    motion: Motion
    time_s: FloatArray


class UnsolvedError(ValueError):
    """CalculiX could not finish a trajectory."""


def protocols(sensor: SensorSpecification, random: Generator) -> list[Protocol]:
    """Return two holds, four presses with three indenters and two slides, at drawn places."""
    found = []

    def site() -> Site:
        return Site(
            outer_radius_m=sensor.gel.outer_radius_m,
            tilt_rad=float(random.uniform(0.0, 0.45)),
            azimuth_rad=float(random.uniform(0.0, 2.0 * np.pi)),
            spin_rad=float(random.uniform(0.0, 2.0 * np.pi)),
            clearance_m=0.1e-3,
        )

    for number in range(2):
        held_s = 3.0
        motion = press_hold_release(site(), depth_m=2.0e-3, hold_s=held_s)
        down_s = 0.5 * (motion.duration_s - held_s)
        time = [np.linspace(0.0, down_s, 5), down_s + np.linspace(0.75, held_s, 4)]
        time.append(down_s + held_s + np.linspace(0.0, down_s, 4)[1:])
        found.append(Protocol(f"hold_{number}", "sphere_4mm", motion, np.concatenate(time)))
    for number, indenter in enumerate(("sphere_4mm", "sphere_4mm", "cone", "torus")):
        depth_m = float(random.uniform(1.7e-3, 2.1e-3))
        motion = press_hold_release(site(), depth_m=depth_m, hold_s=0.0)
        time_s = np.linspace(0.0, 0.5 * motion.duration_s, 6)
        found.append(Protocol(f"press_{indenter}_{number}", indenter, motion, time_s))
    for number in range(2):
        motion = slide(
            site(),
            depth_m=1.8e-3,
            distance_m=2.0e-3,
            heading_rad=float(random.uniform(0.0, 2.0 * np.pi)),
            slide_speed_m_s=0.005,
        )
        down_s = 1.9e-3 / 0.005
        time_s = np.concatenate([np.linspace(0.0, down_s, 5), down_s + np.linspace(0.1, 0.4, 4)])
        found.append(Protocol(f"slide_{number}", "sphere_4mm", motion, time_s))
    return found


def measured(
    unit: SolvedUnit,
    sensor: SensorSpecification,
    skin: SkinMesh,
    protocol: Protocol,
    indenter: Indenter,
    random: Generator,
    *,
    coarseness: float = 1.0,
) -> tuple[Trajectory, int]:
    """Return a trajectory as instruments record it, and how many tries its solution took.

    Args:
        unit: what is measured.
        sensor: as declared.
        skin: whose vertices the clouds list.
        protocol: what is done.
        indenter: the shape of the protocol's name.
        random: of the noise.
        coarseness: elements are so many times as large as the unit's, for a quick test.

    Raises:
        UnsolvedError: no try was solved to its end; the text says why the last was not.
        CalculixMissingError: it is not installed.
        OSError: it failed where its folder has no room left.
    """
    own, time_s = unit.constants, protocol.time_s
    late_s = own.clock_s + (unit.size_of("late") or 0.0)
    raised_m = np.array([0.0, 0.0, unit.size_of("mounted_off") or 0.0])
    poses = [protocol.motion.at(float(t) - late_s) for t in time_s]
    poses = [Pose(pose.position_m + raised_m, pose.quaternion_xyzw) for pose in poses]
    skin_m, force_n, tries = _solved(
        unit, sensor, skin, indenter, poses, time_s, coarseness=coarseness
    )
    recorded = [protocol.motion.at(float(t)) for t in time_s]
    position = np.stack([pose.position_m for pose in recorded]) + own.pose_bias_m
    position = position + POSE_NOISE_M * random.standard_normal(position.shape)
    load = own.force_gain * force_n + FORCE_NOISE_N * random.standard_normal(force_n.shape)
    seen = skin_m + SKIN_NOISE_M * random.standard_normal(skin_m.shape)
    stamp = FIRST_STAMP_NS + np.round(1e9 * time_s).astype(np.int64)
    trajectory = Trajectory(
        pose=PoseChannel(stamp, position, np.stack([pose.quaternion_xyzw for pose in recorded])),
        wrench=WrenchChannel(stamp, load, np.zeros_like(load)),
        skin=SkinChannel(stamp, seen.astype(np.float32)),
        name=protocol.name,
    )
    return trajectory, tries


def _solved(
    unit: SolvedUnit,
    sensor: SensorSpecification,
    skin: SkinMesh,
    indenter: Indenter,
    poses: Sequence[Pose],
    time_s: FloatArray,
    *,
    coarseness: float,
) -> tuple[FloatArray, FloatArray, int]:
    """Return skin (F, V, 3) and force (F, 3) along poses, and the number of tries."""
    relaxes = unit.size_of("two_branches") is not None
    # A gel that does not creep stays as it is while nothing moves.
    kept = [0]
    for frame in range(1, len(poses)):
        way = poses[frame].position_m - poses[kept[-1]].position_m
        if relaxes or np.linalg.norm(way) > SAME_PLACE_M:
            kept.append(frame)
    reason = ""
    place = pressed_place(skin.rest_position_m, indenter, poses)
    finest_m = min(unit.constants.spacing_m, PLACE_SHARE * place.radius_m)
    for tries, (size, control) in enumerate(EFFORTS, start=1):
        spacing_m = coarseness * size * finest_m
        deck = _deck(
            unit, sensor, skin, indenter, [poses[k] for k in kept], time_s[kept], spacing_m, control
        )
        try:
            solution = solve(deck, time_limit_s=TIME_LIMIT_S)
        except CalculixError as error:
            solution = Solution((), str(error))
        if not solution.failure:
            break
        reason = solution.failure
        _check_room()
        print(f"{unit.name}: try {tries} of {len(EFFORTS)}: {reason}")
    else:
        raise UnsolvedError(f"CalculiX did not finish it in {len(EFFORTS)} tries: {reason}")
    at = interpolate_skin(deck.gel, skin.rest_position_m)
    moved = [np.zeros_like(skin.rest_position_m)]
    force = [np.zeros(3)]
    for step in solution.steps:
        # The skin is seen from the base, which the indenter has pushed away.
        base_m = -deck.base_compliance_m_n * step.force_n
        moved.append(at.of(step.displacement_m) - base_m)
        force.append(step.force_n)
    frame_step = np.searchsorted(kept, np.arange(len(poses)), side="right") - 1
    skin_m = skin.rest_position_m + np.stack(moved)[frame_step]
    return np.asarray(skin_m), np.stack(force)[frame_step], tries


def _check_room() -> None:
    """Refuse to blame a trajectory for a full disk.

    Raises:
        OSError: where CalculiX writes there is hardly any room.
    """
    folder = tempfile.gettempdir()
    free = shutil.disk_usage(folder).free
    if free < LEAST_FREE_BYTES:
        raise OSError(
            errno.ENOSPC,
            f"CalculiX failed with {1e-6 * free:.0f} MB left for its files, expected "
            f"{1e-6 * LEAST_FREE_BYTES:.0f} MB or more; make room or set TMPDIR, and give "
            "the same command again",
            folder,
        )


def _deck(
    unit: SolvedUnit,
    sensor: SensorSpecification,
    skin: SkinMesh,
    indenter: Indenter,
    poses: Sequence[Pose],
    time_s: FloatArray,
    spacing_m: float,
    control: StepControl,
) -> UnitDeck:
    """Return what CalculiX is to solve."""
    own = unit.constants
    thickness_m = sensor.gel.outer_radius_m - sensor.gel.core_radius_m
    share = (1.0 + own.thickness_share) * (1.0 - (unit.size_of("larger_core") or 0.0))
    gel = replace(sensor.gel, core_radius_m=sensor.gel.outer_radius_m - share * thickness_m)
    contact = replace(
        sensor.contact,
        friction_coefficient=own.friction * (unit.size_of("slippery") or 1.0),
        stiffness=own.contact_stiffness,
    )
    settings = ReferenceSettings(spacing_m, SURFACE_STEP_M, control=control, drag_control=control)
    plain = reference_deck(
        replace(sensor, gel=gel, contact=contact), skin, indenter, poses, settings
    )
    young_pa, poisson = own.youngs_modulus_pa, unit.size_of("compressible") or own.poisson_ratio
    c10 = 0.5 * shear_modulus_pa(young_pa, poisson)
    law = Yeoh(c10, own.c20_ratio * c10, 0.0, bulk_modulus_pa(young_pa, poisson))
    stiffer, relaxing = unit.size_of("ogden_stiffening"), unit.size_of("two_branches")
    return UnitDeck(
        plain.gel,
        plain.surface,
        poses,
        law,
        contact,
        plain.controls,
        duration_s=tuple(np.diff(time_s).tolist()),
        branches=tuple(MaxwellBranch(part * (relaxing or 0.0), time) for part, time in BRANCHES)
        if relaxing is not None
        else (),
        stiffening=None if stiffer is None else OgdenStiffening.like(own.c20_ratio + stiffer),
        stiff=_stiff_part(unit, plain.gel),
        slipping=_slipping(unit, plain.gel, gel.core_radius_m),
        base_compliance_m_n=unit.size_of("soft_base") or 0.0,
    )


def _direction(unit: SolvedUnit, largest_tilt_rad: float) -> FloatArray:
    """Return the (3,) direction in which something is wrong with a unit."""
    random = np.random.default_rng([*unit.seed, 4])
    tilt, azimuth = random.uniform(0.0, largest_tilt_rad), random.uniform(0.0, 2.0 * np.pi)
    sine = np.sin(tilt)
    return np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(tilt)])


def _stiff_part(unit: SolvedUnit, mesh: DomeMesh) -> StiffPart | None:
    """Return which elements are stiffer; None where none are."""
    centre_m = mesh.node_m[mesh.element].mean(axis=1)
    radius_m = unit.size_of("stiff_inclusion")
    if radius_m is not None:
        middle_m = INCLUSION_RADIUS_M * _direction(unit, 0.25)
        away_m = np.linalg.norm(centre_m - middle_m, axis=1)
        # Of a ball smaller than an element at least that one.
        inside = np.flatnonzero((away_m < radius_m) | (away_m == away_m.min()))
        return StiffPart(inside, INCLUSION_RATIO)
    ratio = unit.size_of("stiff_outer_layer")
    if ratio is not None:
        return StiffPart(mesh.skin_element, ratio)
    ratio = unit.size_of("uneven_cure")
    if ratio is not None:
        sideways = _direction(unit, 0.5 * np.pi)[:2]
        return StiffPart(np.flatnonzero(centre_m[:, :2] @ sideways > 0.0), ratio)
    return None


def _slipping(unit: SolvedUnit, mesh: DomeMesh, core_radius_m: float) -> IntArray:
    """Return the nodes that slide along the core: about the apex, none of the base plane."""
    angle_rad = unit.size_of("slipping_core") or 0.0
    node_m = mesh.node_m[mesh.bonded]
    radius_m = np.linalg.norm(node_m, axis=1)
    on_core = radius_m < core_radius_m * (1.0 + 1e-6)
    angle = np.arccos(np.clip(node_m[:, 2] / radius_m, -1.0, 1.0))
    return np.asarray(mesh.bonded[on_core & (angle < min(angle_rad, 1.5))], dtype=np.int64)
