# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel against CalculiX: every kind of indenter at 0 to 40 degrees, two laws, and a drag.

Solves the presses of `cases` that OUT does not hold yet (one to five minutes of one core each;
needs CalculiX: apt-get install calculix-ccx), then presses the gel the same way with the same
constants. With `--minutes` no press is begun after so long: the next run resumes from there, and
the failures name what it lacks. With `--solved-only` nothing is solved and the presses that OUT
holds are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import (
    Indenter,
    IndenterKind,
    IndenterMesh,
    flat_punch,
    load_indenter,
    sphere,
)
from dotsim_ros.geometry.surface import indenter_surface
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.specification import (
    ContactSpecification,
    MaterialSpecification,
    SensorSpecification,
    load_sensor,
)
from studies.reference.axisymmetric import AxisymmetricSettings
from studies.reference.comparison import compare, implicit_step
from studies.reference.press import ReferencePress, ReferenceSettings
from studies.reference.results import FINE_STEP_M, SolvedPress, read_solved_presses, solved_press
from studies.reference.run import CalculixError, calculix_version

TARGET_SKIN_RMS_MM = 0.08
TARGET_FORCE_ERROR = 0.05

FRICTION = 0.3
LAWS = {
    "neo_hookean": MaterialSpecification(youngs_modulus_pa=3.0e5, poisson_ratio=0.48),
    "yeoh": MaterialSpecification(
        law="yeoh", c10_pa=5.0e4, c20_pa=5.0e3, c30_pa=5.0e2, bulk_modulus_pa=2.5e6
    ),
}
DEPTH_M = 2.0e-3
FRAME_COUNT = 2
SPACING_M = 1.5e-3
FINE_SPACING_M = 1.2e-3
SECTION_FRAME_COUNT = 4
SHEAR_M = 1.0e-3


@dataclass(frozen=True)
class Method:
    """Resolution of the gel: spacing of its grid, with or without the refinement."""

    name: str
    spacing_m: float
    refined: bool


DEFAULT = Method("2.4 mm, refined (default)", 2.4e-3, True)
OTHERS = (
    Method("1.8 mm, refined", 1.8e-3, True),
    Method("2.4 mm", 2.4e-3, False),
    Method("1.2 mm", 1.2e-3, False),
)


def two_bumps() -> Indenter:
    """Return two balls side by side along x."""
    ball = indenter_surface(sphere(2.0e-3), 0.15e-3)
    aside = np.array([2.6e-3, 0.0, 0.0])
    vertices = np.concatenate([ball.vertices_m - aside, ball.vertices_m + aside])
    triangles = np.concatenate([ball.triangles, ball.triangles + len(ball.vertices_m)])
    mesh = IndenterMesh(vertices, triangles.astype(np.int32))
    return Indenter(IndenterKind.MESH, (), mesh=mesh, name="two_bumps")


def indenters() -> list[Indenter]:
    """Return one of each kind that a data set presses with."""
    packaged = [load_indenter(name) for name in ("sphere_4mm", "cone", "lying_cylinder", "torus")]
    punch = replace(flat_punch(4.0e-3, 9.0e-3, 1.5e-3), name="round_punch")
    return [*packaged, two_bumps(), punch]


def sensor(law: str) -> SensorSpecification:
    """Return the default sensor with one of LAWS."""
    return replace(
        load_sensor("densetact2"),
        name=law,
        material=LAWS[law],
        contact=ContactSpecification(friction_coefficient=FRICTION),
    )


def cases() -> list[ReferencePress]:
    """Return the presses, those first that a short run should have: bodies of revolution at the
    apex in two dimensions, every indenter in three, the law taking turns; a sphere dragged; and
    the same on other meshes, which tell the reference's own error."""
    flat = AxisymmetricSettings()
    coarse, fine = (ReferenceSettings(spacing_m=m) for m in (SPACING_M, FINE_SPACING_M))
    every = {indenter.name: indenter for indenter in indenters()}
    sections = [
        ReferencePress(sensor(law), every[name], DEPTH_M, SECTION_FRAME_COUNT, settings=flat)
        for law, names in (
            ("neo_hookean", ("sphere_4mm", "cone", "torus", "round_punch")),
            ("yeoh", ("sphere_4mm", "cone")),
        )
        for name in names
    ]
    aside = [
        ReferencePress(
            sensor(law),
            indenter,
            DEPTH_M,
            FRAME_COUNT,
            tilt_deg=tilt_deg,
            # A tip of 1 mm needs the finer mesh.
            settings=fine if indenter.name == "cone" else coarse,
        )
        for tilt_deg, law in ((20.0, "yeoh"), (40.0, "neo_hookean"))
        for indenter in every.values()
    ]
    ball = ReferencePress(
        sensor("neo_hookean"), every["sphere_4mm"], DEPTH_M, FRAME_COUNT, settings=coarse
    )
    # The cones' meshes take five times as long as the others.
    soon = [press for press in aside[: len(every)] if press.indenter.name != "cone"]
    soon += [press for press in aside[len(every) :] if press.indenter.name == "sphere_4mm"]
    chosen = {press.name for press in soon}
    doubled = AxisymmetricSettings(spacing_m=2.0 * flat.spacing_m)
    return [
        *sections,
        *(replace(press, settings=doubled) for press in sections[:4]),
        *(replace(ball, indenter=every[name]) for name in ("lying_cylinder", "two_bumps")),
        *soon,
        replace(ball, shear_m=SHEAR_M),
        *(press for press in aside if press.name not in chosen),
        replace(ball, settings=fine),
    ]


def solve_missing(
    directory: Path, presses: Sequence[ReferencePress], *, longest_s: float = float("inf")
) -> list[str]:
    """Solve the presses that the data set does not hold; return what failed or was not begun.

    Args:
        directory: of the data set.
        presses: in this order.
        longest_s: no press is begun after so long.
    """
    begun = monotonic()
    version = calculix_version()
    skin = skin_of(load_sensor("densetact2").gel)
    data_set = DataSetWriter(directory, skin, indenter_step_m=FINE_STEP_M)
    failures = []
    for press in presses:
        notes = press.notes() | {"calculix": version}
        if data_set.holds(press.name, notes):
            continue
        if monotonic() - begun >= longest_s:
            failures.append(f"{press.name}: not begun, the run's time was over")
            continue
        try:
            trajectory, solution = solved_press(press, skin)
        except CalculixError as error:
            failures.append(f"{press.name}: {error}")
            print(failures[-1], flush=True)
            continue
        data_set.add(trajectory, press.indenter, notes, failure=solution.failure)
        effort = sum(step.iterations for step in solution.steps)
        spent = f"{effort} iterations, {monotonic() - begun:.0f} s into the run"
        print(f"{press.name}: {spent} {solution.failure}", flush=True)
        if solution.failure:
            failures.append(f"{press.name}: {solution.failure}")
    return failures


def rows_of(press: SolvedPress, method: Method) -> list[dict[str, Any]]:
    """Return a row a frame."""
    assert press.trajectory.pose is not None
    own = press.specification
    solver = replace(own.solver, grid_spacing_m=method.spacing_m, refined=method.refined)
    specification = replace(own, solver=solver)
    skin, request = skin_of(own.gel), press.notes["press"]
    step = implicit_step(specification, skin, press.indenter)
    tips = [pose.position_m for pose in press.trajectory.pose.poses()]
    pressed = own.gel.outer_radius_m - np.linalg.norm(tips, axis=1)
    return [
        {
            "trajectory": press.trajectory.name,
            "law": own.material.law,
            "indenter": press.notes["indenter"],
            "tilt_deg": request["tilt_deg"],
            "depth_mm": round(1e3 * float(min(pressed[row["frame"]], request["depth_m"])), 3),
            "drag_mm": round(1e3 * _dragged_m(tips, row["frame"], request["frame_count"]), 3),
            "method": method.name,
            **row,
        }
        for row in compare(step, skin, press.indenter, press.trajectory)
    ]


def _dragged_m(tips: Sequence[FloatArray], frame: int, press_frame_count: int) -> float:
    if frame <= press_frame_count:
        return 0.0
    return float(np.linalg.norm(tips[frame] - tips[press_frame_count]))


def finest(presses: Sequence[SolvedPress]) -> list[SolvedPress]:
    """Return the presses but for those that were solved on a finer mesh as well."""
    return [
        press
        for press in presses
        if not any(
            _question(press) == _question(other) and _spacing_m(press) > _spacing_m(other)
            for other in presses
        )
    ]


def own_errors(presses: Sequence[SolvedPress]) -> list[dict[str, Any]]:
    """Return how far the reference's frames are apart where the same press was solved on two
    meshes, the finer one's taken as true."""
    found = []
    for press in presses:
        for other in presses:
            if _question(press) == _question(other) and _spacing_m(press) > _spacing_m(other):
                found += _own_error(press, other)
    return found


def _question(press: SolvedPress) -> tuple[Any, ...]:
    """Return what two solutions of one press have in common."""
    request = {key: press.notes["press"][key] for key in ("depth_m", "tilt_deg", "shear_m")}
    return press.notes["sensor"], press.notes["indenter"], request


def _spacing_m(press: SolvedPress) -> float:
    return float(press.notes["settings"]["spacing_m"])


def _own_error(coarse: SolvedPress, fine: SolvedPress) -> list[dict[str, Any]]:
    rows = []
    mine, true = coarse.trajectory, fine.trajectory
    assert mine.skin is not None
    assert true.skin is not None
    assert mine.wrench is not None
    assert true.wrench is not None
    assert mine.pose is not None
    assert true.pose is not None
    for frame, position in enumerate(mine.pose.position_m):
        same = np.flatnonzero(np.linalg.norm(true.pose.position_m - position, axis=1) < 1e-9)
        if frame == 0 or len(same) == 0:
            continue
        apart = np.linalg.norm(
            mine.skin.position_m[frame] - true.skin.position_m[same[0]], axis=1
        ).astype(np.float64)
        area = skin_of(coarse.specification.gel).rest_area_m2
        force = true.wrench.force_n[same[0]]
        difference = mine.wrench.force_n[frame] - force
        rows.append(
            {
                "coarse": mine.name,
                "fine": true.name,
                "frame": frame,
                "force_error": float(np.linalg.norm(difference) / np.linalg.norm(force)),
                "signed_error": float(difference @ force / (force @ force)),
                "skin_rms_mm": 1e3 * float(np.sqrt((area * apart**2).sum() / area.sum())),
                "skin_max_mm": 1e3 * float(apart.max()),
            }
        )
    return rows


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return how many frames meet the targets, and the worst ones."""
    force = np.array([row["force_error"] for row in rows])
    skin = np.array([row["skin_rms_mm"] for row in rows])
    return {
        "frames": len(rows),
        "force_met": int((force <= TARGET_FORCE_ERROR).sum()),
        "skin_met": int((skin <= TARGET_SKIN_RMS_MM).sum()),
        "force_error_median": float(np.median(force)),
        "force_error_worst": float(force.max()),
        "skin_rms_worst_mm": float(skin.max()),
    }


def reference(
    *,
    out: Path = Path("out/reference"),
    minutes: float = float("inf"),
    solved_only: bool = False,
    resolutions: tuple[str, ...] = (),
) -> dict[str, Any]:
    """The gel against CalculiX: every kind of indenter at 0 to 40 degrees, two laws, and a drag.

    Args:
        out: folder of the solved presses.
        minutes: begin no press after so long.
        solved_only: run no CalculiX.
        resolutions: parts of the names of trajectories that are compared at other resolutions too.
    """
    failures: list[str] = []
    if not solved_only:
        failures = solve_missing(out, cases(), longest_s=60.0 * minutes)
    _, presses = read_solved_presses(out)
    if solved_only:
        stopped = {p.trajectory.name: p.notes["failure"] for p in presses if "failure" in p.notes}
        missing = {p.name for p in cases()} - {p.trajectory.name for p in presses}
        failures = [f"{name}: {failure}" for name, failure in stopped.items()]
        failures += [f"{name}: not solved" for name in sorted(missing)]
    rows = [
        row
        for method in (DEFAULT, *OTHERS)
        for press in finest(presses)
        if method is DEFAULT or any(part in press.trajectory.name for part in resolutions)
        for row in rows_of(press, method)
    ]
    summaries = {
        name: summary([row for row in rows if row["method"] == name])
        for name in dict.fromkeys(row["method"] for row in rows)
    }
    whole = summaries[DEFAULT.name]
    return {
        "calculix": calculix_version(),
        "targets": {"skin_rms_mm": TARGET_SKIN_RMS_MM, "force_error": TARGET_FORCE_ERROR},
        "summary": summaries,
        "frames": whole["frames"],
        "within_force_target": whole["force_met"],
        "skin_rms_max_mm": whole["skin_rms_worst_mm"],
        "presses_solved": sum("failure" not in press.notes for press in presses),
        "presses_asked": len(cases()),
        "rows": rows,
        "own_errors": own_errors(presses),
        "failures": failures,
    }
