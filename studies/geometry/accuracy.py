# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Error of the fast gel against its cost, for grids of 2.4, 1.8 and 1.2 mm.

The batched gel is in it on its default and on its fine grid, which is that of the reference: one
gel for each shape, all in one batch. Times are those of the processor, for each gel.

The reference is the same model on a grid of 1.2 mm, solved until no marker moves by more than 1 um,
with contact at every marker.
Its compliance at rest is inverted once, which takes some ten minutes and 6 GB; then a motion of an
indenter takes one to five minutes. It is kept next to the tables that are computed once, so that a
second run needs seconds. Penetration of the reference itself is a figure too: a sharp edge sinks in
whatever the solver does.

Each indenter presses straight in, and then slides at 10 mm/s at one depth.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gel.batched.memory import Grid
from dotsim_ros.gel.implicit.contact_points import ContactPoints
from dotsim_ros.gel.implicit.gel import GelState, ImplicitGel
from dotsim_ros.gel.make import body_of, material_of, skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.cache import content_key, load_arrays, store_arrays
from dotsim_ros.io.files import cache_directory, whole_file
from dotsim_ros.nodes.tactile_sim.profiles import REALTIME
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.geometry.batched_model import GelsOfBatch, OneState
from studies.run import expect_known

INDENTERS = ("sphere_4mm", "flat_punch", "box_edge", "cone", "box_face")
STEP_M = 0.25e-3
DEPTHS_M = (0.5e-3, 1.0e-3, 1.5e-3, 2.0e-3, 2.5e-3, 3.0e-3)
SLIDE_DEPTH_M = 1.5e-3
SLIDE_STEP_M = 0.4e-3
"""In a frame at 10 mm/s."""
MOTIONS = ("press", "slide")
MARKS = "osD^vP"
"""Of the methods in the picture."""
SLIDES_M = (0.8e-3, 1.6e-3, 2.4e-3)
DIRECTION = (0.3, 0.15, 1.0)
FRAME_S = 0.04
REPORTED_S = 1.0
"""Steps that take longer are printed."""
DECIDED_BY = (
    "gel/elastic_kernels.py",
    "gel/elasticity.py",
    "gel/implicit/contact.py",
    "gel/implicit/contact_points.py",
    "gel/material.py",
    "geometry",
)
"""What decides a reference that is solved to the end: the physics, not the way to it."""


@dataclass(frozen=True)
class Method:
    """One row: a grid, with or without the refinement, and the solver's effort where it is not the
    sensor's own: tolerance, and most iterations; or the grid of the batched gel."""

    name: str
    spacing_m: float
    refined: bool
    effort: tuple[float, int] | None = None
    batched: Grid | None = None


DEFAULT = Method("2.4 mm, refined (default)", 2.4e-3, True)
METHODS = (
    Method(
        "2.4 mm, refined, real time",
        2.4e-3,
        True,
        (REALTIME.smallest_tolerance_m, REALTIME.largest_iterations),
    ),
    DEFAULT,
    Method("2.4 mm", 2.4e-3, False),
    Method("1.8 mm", 1.8e-3, False),
    Method("2.4 mm, refined, batched", 2.4e-3, True, batched="default"),
    Method("1.2 mm, batched", 1.2e-3, False, batched="fine"),
)
METHOD_NAMES = tuple(method.name for method in METHODS)
REFERENCE = Method("1.2 mm (reference)", 1.2e-3, False, (1e-6, 60))


def press_pose(outer_radius_m: float, depth_m: float) -> Pose:
    """Return the pose of an indenter pressed straight in along DIRECTION."""
    axis = np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    half = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    return Pose(axis * (outer_radius_m - depth_m), half / np.linalg.norm(half))


def make(specification: SensorSpecification, method: Method, indenter: str) -> ImplicitGel:
    """Return the implicit gel of one row."""
    solver = replace(specification.solver, grid_spacing_m=method.spacing_m, refined=method.refined)
    if method.effort is not None:
        tolerance_m, iterations = method.effort
        solver = replace(solver, tolerance_m=tolerance_m, iterations=iterations)
    return ImplicitGel(
        body_of(specification.gel),
        skin_of(specification.gel),
        material_of(specification.material),
        contact=specification.contact,
        solver=solver,
        indenter=load_indenter(indenter),
    )


def motions_of(outer_radius_m: float) -> dict[str, tuple[list[Pose], dict[int, float]]]:
    """Return the poses of each motion, and the length in metres that those to be judged stand for,
    by their number: depth of a press, way of a slide."""
    depths = np.arange(STEP_M, DEPTHS_M[-1] + 1e-9, STEP_M)
    down = [press_pose(outer_radius_m, float(depth_m)) for depth_m in depths]
    judged = {int(np.argmin(np.abs(depths - depth_m))): depth_m for depth_m in DEPTHS_M}
    first = down[: round(SLIDE_DEPTH_M / STEP_M)]
    # Across the axis, along the indenter's own y: over the edge of a box, not along it.
    aside = first[-1].rotation()[:, 1]
    ways = np.arange(SLIDE_STEP_M, SLIDES_M[-1] + 1e-9, SLIDE_STEP_M)
    along = [
        Pose(first[-1].position_m + way_m * aside, first[-1].quaternion_xyzw) for way_m in ways
    ]
    slid = {len(first) + int(np.argmin(np.abs(ways - way_m))): way_m for way_m in SLIDES_M}
    return {"press": (down, judged), "slide": (first + along, slid)}


def moved(
    gels: ImplicitGel | GelsOfBatch, poses: list[Pose], judged: dict[int, float], names: list[str]
) -> tuple[list[dict[float, GelState | OneState]], list[float]]:
    """Go through a motion; return the judged states of each gel by their length, and the
    processor's seconds for a gel in each step."""
    gels.reset()
    found: list[dict[float, GelState | OneState]] = [{} for _ in names]
    seconds: list[float] = []
    for number, pose in enumerate(poses):
        begun = time.process_time()
        states: Sequence[GelState | OneState] = gels.step([pose] * len(names), FRAME_S)
        seconds.append((time.process_time() - begun) / len(names))
        if number in judged:
            for of_one, state in zip(found, states, strict=True):
                of_one[judged[number]] = state
        if seconds[-1] > REPORTED_S:
            print(f"  {', '.join(names)}, step {number + 1}: {seconds[-1]:.0f} s", flush=True)
    return found, seconds


def reference(
    gels: Callable[[], ImplicitGel],
    specification: SensorSpecification,
    indenter: str,
    poses: list[Pose],
    judged: dict[int, float],
) -> dict[float, dict[str, NDArray[np.float64]]]:
    """Return skin, wrench, penetration and convergence of the reference at every judged length;
    its gel is asked for where they are not kept."""
    shape = load_indenter(indenter)
    key = content_key(DECIDED_BY, specification, shape, poses, judged, REFERENCE, FRAME_S)
    # Apart from the tables, of which the cache drops those that were not read for long.
    path = cache_directory() / "accuracy" / f"{key}.npz"
    stored = load_arrays(path)
    if stored is None:
        gel = gels()
        gel.points = ContactPoints(gel.skin, 0.0)
        gel.set_indenter(shape)
        [states], _ = moved(gel, poses, judged, [indenter])
        stored = {}
        for length_m, state in states.items():
            stored[f"{length_m}/skin"] = state.skin_position_m
            stored[f"{length_m}/force"] = state.wrench.force_n
            stored[f"{length_m}/penetration"] = np.array(state.max_penetration_m)
            stored[f"{length_m}/converged"] = np.array(state.converged)
        store_arrays(path, stored)
    parts = ("skin", "force", "penetration", "converged")
    return {d: {part: stored[f"{d}/{part}"] for part in parts} for d in judged.values()}


def compare(
    state: GelState | OneState, truth: dict[str, NDArray[np.float64]], seconds: list[float]
) -> dict[str, Any]:
    """Return the errors of one state and the cost of the steps."""
    error = np.linalg.norm(state.skin_position_m - truth["skin"], axis=1)
    force = float(np.linalg.norm(truth["force"]))
    return {
        "skin_max_um": round(1e6 * float(error.max()), 1),
        "skin_rms_um": round(1e6 * float(np.sqrt(np.mean(error**2))), 1),
        "force_error": round(
            float(np.linalg.norm(state.wrench.force_n - truth["force"])) / force, 4
        ),
        "penetration_um": round(1e6 * state.max_penetration_m, 1),
        "converged": state.converged,
        "step_p50_ms": round(1e3 * float(np.median(seconds)), 1),
    }


def cases_of(rows: list[dict[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the errors of the default's presses by indenter and depth in mm."""
    kept = ("skin_max_um", "skin_rms_um", "force_error", "penetration_um")
    cases: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        if (row["method"], row["motion"]) == (DEFAULT.name, "press"):
            errors = {name: row[name] for name in kept}
            cases.setdefault(row["indenter"], {})[str(row["depth_mm"])] = errors
    return cases


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the largest error of each shape and method against the time of a step."""
    import matplotlib.pyplot as plt

    figure, (skin, force) = plt.subplots(1, 2, figsize=(11, 4.5), sharex=True)
    methods = list(dict.fromkeys(row["method"] for row in rows))
    indenters = list(dict.fromkeys(row["indenter"] for row in rows))
    colours = {name: f"C{number}" for number, name in enumerate(indenters)}
    for indenter in indenters:
        worst = []
        for method in methods:
            mine = [r for r in rows if (r["indenter"], r["method"]) == (indenter, method)]
            cost_ms = float(np.median([row["step_p50_ms"] for row in mine]))
            errors = (max(r["skin_max_um"] for r in mine), max(r["force_error"] for r in mine))
            worst.append((cost_ms, *errors))
        cost, skin_um, share = np.array(worst).T
        for axis, error in ((skin, skin_um), (force, 100.0 * share)):
            axis.plot(cost, error, color=colours[indenter], alpha=0.4)
            for x, y, marker in zip(cost, error, MARKS, strict=False):
                axis.plot(x, y, marker, color=colours[indenter])
    skin.axhline(60.0, color="grey", linestyle=":")
    force.axhline(2.0, color="grey", linestyle=":")
    skin.set(ylabel="largest error of the skin, um", xscale="log", yscale="log")
    force.set(ylabel="largest error of the force, %", xscale="log", yscale="log")
    for axis in (skin, force):
        axis.set_xlabel("processor time of a step, ms (median)")
    lines = [plt.Line2D([], [], color=colours[name], label=name) for name in indenters]
    lines += [
        plt.Line2D([], [], color="black", marker=marker, linestyle="", label=method)
        for method, marker in zip(methods, MARKS, strict=False)
    ]
    figure.legend(handles=lines, loc="outside lower center", ncols=5, fontsize=8)
    figure.tight_layout(rect=(0.0, 0.12, 1.0, 1.0))
    with whole_file(path) as part:
        figure.savefig(part, dpi=110, format="png")


def accuracy(
    *,
    figure: Path | None = Path("docs/images/gel_error_cost.png"),
    indenters: tuple[str, ...] = INDENTERS,
    motions: tuple[str, ...] = MOTIONS,
    methods: tuple[str, ...] = METHOD_NAMES,
) -> dict[str, Any]:
    """Error of the fast gel against its cost, for grids of 2.4, 1.8 and 1.2 mm.

    Args:
        figure: picture (PNG) of error against cost.
        indenters: names or files.
        motions: of press, slide.
        methods: of the gel, by their names in the record.
    """
    expect_known("motion", motions, MOTIONS)
    expect_known("method", methods, METHOD_NAMES)
    chosen = [method for method in METHODS if method.name in methods]
    specification = load_sensor("densetact2")
    all_motions = motions_of(specification.gel.outer_radius_m)
    found = []
    for motion in motions:
        poses, judged = all_motions[motion]
        for method in chosen:
            for names in [[*indenters]] if method.batched else [[name] for name in indenters]:
                shapes = [load_indenter(name) for name in names]
                gels = (
                    GelsOfBatch(specification, method.batched, shapes)
                    if method.batched
                    else make(specification, method, names[0])
                )
                of_gels, seconds = moved(gels, poses, judged, names)
                for indenter, states in zip(names, of_gels, strict=True):
                    found.append((motion, method, indenter, states, seconds))
    reference_gel = cache(lambda: make(specification, REFERENCE, INDENTERS[0]))
    truths = {
        (motion, indenter): reference(reference_gel, specification, indenter, *all_motions[motion])
        for motion in motions
        for indenter in indenters
    }
    rows: list[dict[str, Any]] = []
    for motion, method, indenter, states, seconds in found:
        for length_m, state in states.items():
            truth = truths[motion, indenter][length_m]
            rows.append(
                {
                    "indenter": indenter,
                    "method": method.name,
                    "motion": motion,
                    "depth_mm" if motion == "press" else "way_mm": round(1e3 * length_m, 2),
                    **compare(state, truth, seconds),
                    "reference_penetration_um": round(1e6 * float(truth["penetration"]), 1),
                    "reference_converged": bool(truth["converged"]),
                }
            )
    if figure is not None:
        draw(rows, figure)
    return {"cases": cases_of(rows), "rows": rows}
