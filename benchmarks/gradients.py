# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of the implicit gel: error against finite differences, and the time they take.

    python benchmarks/gradients.py --json gradients.json

Errors are of a random linear loss of skin and wrench over a press and a slide, without refinement,
on a grid of 3.6 mm; steps are small, since a difference across the instant at which a marker
begins to slip is none. Times are of the sensor's own grid. With --refined also what derivatives by
Poisson's ratio lose when the refinement counts as constant in it (two refinements: minutes).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.files import write_json
from dotsim_ros.gel.adjoint.backward import trajectory_gradient
from dotsim_ros.gel.adjoint.gradient import Gradient, LossGradient
from dotsim_ros.gel.adjoint.recorder import Recorder
from dotsim_ros.gel.adjoint.refinement_rate import poisson_rate
from dotsim_ros.gel.body import Dome
from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.make import material_of, skin_of
from dotsim_ros.gel.reshape import ReshapedDome
from dotsim_ros.geometry.indenter import Indenter, sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.provenance import provenance
from dotsim_ros.specification import SensorSpecification, load_sensor

COARSE_M = 3.6e-3
COARSE_SKIN_M = 0.8e-3
STEP_S = 0.02
RELAXATION = ((0.2, 0.1), (0.05, 0.5))
# Tip of the indenter from the apex, m: outside, a press, then a slide.
PATH = (
    (0.0, 0.0, 0.0005),
    (0.0, 0.0, -0.0006),
    (0.0, 0.0, -0.0011),
    (0.0004, 0.0, -0.0011),
    (0.0008, 0.0, -0.0011),
)
Change = Callable[[SensorSpecification, float], SensorSpecification]


def make_gel(
    specification: SensorSpecification, indenter: Indenter, reference: Dome | None = None
) -> ImplicitGel:
    """Return the gel, with the moved points of a reference dome where one is given."""
    shape = specification.gel
    skin = skin_of(shape)
    body = Dome(shape.outer_radius_m, shape.core_radius_m)
    if reference is not None:
        ratio = shape.outer_radius_m / reference.outer_radius_m
        skin = skin_of(replace(shape, outer_radius_m=reference.outer_radius_m))
        skin = replace(
            skin,
            rest_position_m=skin.rest_position_m * ratio,
            rest_area_m2=skin.rest_area_m2 * ratio**2,
        )
        body = ReshapedDome(shape.outer_radius_m, shape.core_radius_m, reference)
    return ImplicitGel(
        body,
        skin,
        material_of(specification.material),
        contact=specification.contact,
        solver=specification.solver,
        indenter=indenter,
    )


def make_poses(apex_m: float, twist: np.ndarray) -> list[Pose]:
    """Return the path with a common small motion about the base's origin."""
    turn = Pose(np.zeros(3), [*(0.5 * twist[3:]), 1.0])
    points = [turn.apply([x, y, apex_m + z]) + twist[:3] for x, y, z in PATH]
    return [Pose(point, turn.quaternion_xyzw) for point in points]


def make_losses(vertex_count: int) -> list[LossGradient]:
    """Return a loss that is linear in all that the steps return, with random weights."""
    random = np.random.default_rng(0)
    return [
        LossGradient(
            random.normal(size=(vertex_count, 3)) * 100.0,
            random.normal(size=3),
            random.normal(size=3) * 100.0,
        )
        for _ in PATH
    ]


def record(gel: ImplicitGel, poses: list[Pose]) -> tuple[Recorder, float]:
    """Return the recorded steps and their loss."""
    recorder, loss = Recorder(gel), 0.0
    for pose, weight in zip(poses, make_losses(gel.skin.vertex_count), strict=True):
        state = recorder.step([pose], STEP_S)[0]
        loss += float(np.vdot(weight.skin, state.skin_position_m))  # type: ignore[arg-type]
        loss += float(weight.force @ state.wrench.force_n + weight.torque @ state.wrench.torque_nm)
    return recorder, loss


def vary(section: str, name: str) -> Change:
    """Return what sets an entry of a section."""
    return lambda s, value: replace(s, **{section: replace(getattr(s, section), **{name: value})})


def vary_prony(name: str, index: int) -> Change:
    """Return what sets a share or a time of the Prony series."""

    def change(specification: SensorSpecification, value: float) -> SensorSpecification:
        values = list(getattr(specification.material, name))
        values[index] = value
        return vary("material", name)(specification, tuple(values))  # type: ignore[arg-type]

    return change


def parameters(
    specification: SensorSpecification, gradient: Gradient, gel: ImplicitGel
) -> dict[str, tuple[Change, float, float, float]]:
    """Return for each parameter how to set it, its value, a step, and the adjoint's derivative."""
    m, c, g = specification.material, specification.contact, specification.gel
    by_law = gradient.by_law(gel.material.law)
    rows: dict[str, tuple[Change, float, float, float]] = {
        name: (vary("material", name), getattr(m, name), share * getattr(m, name), by_law[name])
        for name, share in (("youngs_modulus_pa", 1e-4), ("poisson_ratio", 1e-6))
    }
    for name, derivative in (
        ("friction_coefficient", gradient.friction_coefficient),
        ("stiffness", gradient.contact_stiffness),
        ("tangential_ratio", gradient.tangential_ratio),
    ):
        value = getattr(c, name)
        rows[name] = (vary("contact", name), value, 1e-4 * value, derivative)
    for name, derivative in gradient.geometry.items():
        value = getattr(g, name)
        rows[name] = (vary("gel", name), value, 1e-6 * value, derivative)
    for i in range(len(m.prony_shares)):
        for name, values in (
            ("prony_shares", gradient.prony_shares),
            ("prony_times_s", gradient.prony_times_s),
        ):
            value = getattr(m, name)[i]
            rows[f"{name}[{i}]"] = (vary_prony(name, i), value, 1e-4 * value, float(values[i]))
    value = m.density_kg_m3
    rows["density_kg_m3"] = (
        vary("material", "density_kg_m3"),
        value,
        1e-2 * value,
        gradient.density_kg_m3,
    )
    return rows


def measure_errors(specification: SensorSpecification) -> dict[str, float]:
    """Return the relative error of each derivative, of a dynamic gel that relaxes."""
    specification = replace(
        specification,
        gel=replace(specification.gel, skin_spacing_m=COARSE_SKIN_M),
        material=replace(
            specification.material, prony_shares=RELAXATION[0], prony_times_s=RELAXATION[1]
        ),
        solver=replace(specification.solver, grid_spacing_m=COARSE_M, refined=False, dynamic=True),
    )
    apex = specification.gel.outer_radius_m
    reference = Dome(apex, specification.gel.core_radius_m)
    indenter, still = sphere(0.004), np.zeros(6)

    def loss(changed: SensorSpecification, shape: Indenter, twist: np.ndarray) -> float:
        gel = make_gel(changed, shape, reference)
        return record(gel, make_poses(apex, twist))[1]

    gel = make_gel(specification, indenter, reference)
    recorder, _ = record(gel, make_poses(apex, still))
    losses = make_losses(gel.skin.vertex_count)
    gradient = trajectory_gradient(gel, recorder.trajectories[0], losses)
    errors = {}
    for name, (change, value, step, derivative) in parameters(specification, gradient, gel).items():
        upper, lower = (
            loss(change(specification, value + sign * step), indenter, still) for sign in (1, -1)
        )
        errors[name] = relative_error(derivative, (upper - lower) / (2.0 * step))
    step = 4.0e-9
    upper, lower = (loss(specification, sphere(0.004 + s * step), still) for s in (1, -1))
    difference = (upper - lower) / (2.0 * step)
    errors["sphere_radius_m"] = relative_error(gradient.indenter_parameters[0], difference)
    for i, name in enumerate(("x_m", "y_m", "z_m", "about_x", "about_y", "about_z")):
        twist = np.zeros(6)
        twist[i] = 1e-8 if i < 3 else 1e-6
        upper, lower = (loss(specification, indenter, sign * twist) for sign in (1, -1))
        difference = (upper - lower) / (2.0 * twist[i])
        errors[f"indenter_{name}"] = relative_error(gradient.indenter_twist[i], difference)
    return errors


def relative_error(derivative: float, difference: float) -> float:
    """Return the error of a derivative, relative to a finite difference."""
    return abs(float(derivative) - difference) / abs(difference)


def measure_times(specification: SensorSpecification) -> dict[str, float]:
    """Return the seconds of a plain substep, a recorded one, and its way back."""
    gel = make_gel(specification, sphere(0.004))
    poses = make_poses(specification.gel.outer_radius_m, np.zeros(6))
    losses = make_losses(gel.skin.vertex_count)
    record(gel, poses)
    gel.reset()
    clock = time.perf_counter()
    for pose in poses:
        gel.step([pose], STEP_S)
    plain = time.perf_counter() - clock
    clock = time.perf_counter()
    recorder, _ = record(gel, poses)
    forward = time.perf_counter() - clock
    trajectory = recorder.trajectories[0]
    trajectory_gradient(gel, trajectory, losses)
    clock = time.perf_counter()
    trajectory_gradient(gel, trajectory, losses)
    back = time.perf_counter() - clock
    count = len(trajectory.substeps)
    return {"step_s": plain / count, "recorded_step_s": forward / count, "adjoint_s": back / count}


def measure_poisson(specification: SensorSpecification) -> dict[str, float]:
    """Return what the derivative by Poisson's ratio loses with a constant refinement."""
    gel = make_gel(specification, sphere(0.004))
    recorder, _ = record(gel, make_poses(specification.gel.outer_radius_m, np.zeros(6)))
    clock = time.perf_counter()
    rate = poisson_rate(gel)
    seconds = time.perf_counter() - clock
    trajectory = recorder.trajectories[0]
    errors = {}
    every = make_losses(gel.skin.vertex_count)
    for name, losses in (
        ("skin", [LossGradient(loss.skin) for loss in every]),
        ("force", [LossGradient(force=loss.force) for loss in every]),
    ):
        constant, complete = (
            trajectory_gradient(gel, trajectory, losses, by_poisson=given).by_law(gel.material.law)
            for given in (None, rate)
        )
        errors[f"loss_of_{name}"] = relative_error(
            constant["poisson_ratio"], complete["poisson_ratio"]
        )
    return errors | {"poisson_rate_s": seconds}


def main() -> None:
    """Print the figures, and write them as JSON where asked."""
    parser = argparse.ArgumentParser(
        description="Measure error and time of the implicit gel's derivatives.",
        epilog="example: python benchmarks/gradients.py --json gradients.json",
    )
    parser.add_argument("--sensor", default="densetact2", help="name or YAML file of the sensor")
    parser.add_argument("--refined", action="store_true", help="measure the refinement too")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    specification = load_sensor(arguments.sensor)
    plain = replace(specification, solver=replace(specification.solver, refined=False))
    figures: dict[str, Any] = {"relative_error": measure_errors(specification)}
    figures["seconds_per_substep"] = measure_times(plain)
    if arguments.refined:
        figures["seconds_per_substep_refined"] = measure_times(specification)
        figures["refinement_constant_in_poisson_ratio"] = measure_poisson(specification)
    for title, values in figures.items():
        print(title)
        for name, value in values.items():
            print(f"  {name:<24}{value:10.2e}")
    if arguments.json:
        write_json(arguments.json, provenance() | figures)


if __name__ == "__main__":
    main()
