"""Error of the fast gel against its cost, for grids of 2.4, 1.8 and 1.2 mm.

python benchmarks/accuracy.py --json docs/results/accuracy.json

The reference is the same model on a grid of 1.2 mm, with the whole stiffness factored anew in every
iteration and solved until no marker moves by more than 1 um: about ten minutes an indenter. It is
kept beside the tables that are computed once, so that a second run needs seconds. Penetration of
the reference itself is printed too: a sharp edge sinks in whatever the solver does.
"""

from __future__ import annotations

import argparse
import hashlib
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.files import cache_directory, write_json
from dotsim_ros.gel.implicit.gel import GelState, ImplicitGel
from dotsim_ros.gel.make import body_of, material_of, skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.provenance import provenance
from dotsim_ros.specification import SensorSpecification, load_sensor

INDENTERS = ("sphere_4mm", "flat_punch", "box_edge")
STEP_M = 0.25e-3
DEPTHS_M = (0.5e-3, 1.0e-3, 1.5e-3, 2.0e-3, 2.5e-3)
DIRECTION = (0.3, 0.15, 1.0)
FRAME_S = 0.04


@dataclass(frozen=True)
class Method:
    """One row: a grid, with or without the refinement, solved exactly or fast."""

    name: str
    spacing_m: float
    refined: bool
    exact: bool


METHODS = (
    Method("2.4 mm, refined (default)", 2.4e-3, True, False),
    Method("2.4 mm", 2.4e-3, False, False),
    Method("1.8 mm", 1.8e-3, False, False),
)
REFERENCE = Method("1.2 mm, exact (reference)", 1.2e-3, False, True)


def press_pose(outer_radius_m: float, depth_m: float) -> Pose:
    """Return the pose of an indenter pressed straight in along DIRECTION."""
    axis = np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    half = np.array([-axis[1], axis[0], 0.0, 1.0 + axis[2]])
    return Pose(axis * (outer_radius_m - depth_m), half / np.linalg.norm(half))


def make(specification: SensorSpecification, method: Method, indenter: str) -> ImplicitGel:
    """Return the gel of one row."""
    solver = replace(
        specification.solver,
        grid_spacing_m=method.spacing_m,
        refined=method.refined,
        tolerance_m=1e-6 if method.exact else specification.solver.tolerance_m,
        iterations=40 if method.exact else specification.solver.iterations,
    )
    return ImplicitGel(
        body_of(specification.gel),
        skin_of(specification.gel),
        material_of(specification.material),
        contact=specification.contact,
        solver=solver,
        indenter=load_indenter(indenter),
        exact=method.exact,
    )


def presses(
    gel: ImplicitGel, outer_radius_m: float, name: str
) -> tuple[dict[float, GelState], list[float]]:
    """Press step by step; return the states at DEPTHS_M and the seconds of every step."""
    states, seconds = {}, []
    for depth_m in np.arange(STEP_M, DEPTHS_M[-1] + 1e-9, STEP_M):
        begun = time.perf_counter()
        state = gel.step([press_pose(outer_radius_m, float(depth_m))], FRAME_S)[0]
        seconds.append(time.perf_counter() - begun)
        for wanted in DEPTHS_M:
            if abs(depth_m - wanted) < 1e-9:
                states[wanted] = state
        if gel.exact:
            print(f"  {name} {1e3 * depth_m:.2f} mm: {seconds[-1]:.0f} s", flush=True)
    return states, seconds


def reference(
    specification: SensorSpecification, indenter: str
) -> dict[float, dict[str, NDArray[np.float64]]]:
    """Return skin, wrench, penetration and convergence of the reference at every depth."""
    described = repr((specification, indenter, STEP_M, DEPTHS_M, DIRECTION, REFERENCE))
    key = hashlib.sha256(described.encode()).hexdigest()[:16]
    path = cache_directory() / f"accuracy-{key}.npz"
    if not path.exists():
        gel = make(specification, REFERENCE, indenter)
        states, _ = presses(gel, specification.gel.outer_radius_m, indenter)
        arrays = {}
        for depth_m, state in states.items():
            arrays[f"{depth_m}/skin"] = state.skin_position_m
            arrays[f"{depth_m}/force"] = state.wrench.force_n
            arrays[f"{depth_m}/penetration"] = np.array(state.max_penetration_m)
            arrays[f"{depth_m}/converged"] = np.array(state.converged)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part.npz")
        np.savez(part, **arrays)
        part.replace(path)
    with np.load(path) as stored:
        parts = ("skin", "force", "penetration", "converged")
        return {d: {part: stored[f"{d}/{part}"] for part in parts} for d in DEPTHS_M}


def compare(
    state: GelState, truth: dict[str, NDArray[np.float64]], seconds: list[float]
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


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures here")
    parser.add_argument("--indenters", nargs="+", default=INDENTERS, help="names or files")
    arguments = parser.parse_args()
    specification = load_sensor("densetact2")
    rows: list[dict[str, Any]] = []
    for indenter in arguments.indenters:
        truth = reference(specification, indenter)
        for method in METHODS:
            gel = make(specification, method, indenter)
            states, seconds = presses(gel, specification.gel.outer_radius_m, indenter)
            for depth_m, state in states.items():
                row = {
                    "indenter": indenter,
                    "method": method.name,
                    "depth_mm": round(1e3 * depth_m, 2),
                    **compare(state, truth[depth_m], seconds),
                    "reference_penetration_um": round(
                        1e6 * float(truth[depth_m]["penetration"]), 1
                    ),
                    "reference_converged": bool(truth[depth_m]["converged"]),
                }
                rows.append(row)
                print(" ".join(f"{key}={value}" for key, value in row.items()), flush=True)
    if arguments.json is not None:
        write_json(arguments.json, {**provenance(), "rows": rows})


if __name__ == "__main__":
    main()
