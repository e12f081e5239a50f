# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Solve presses with finite elements (CalculiX) and write them as a data set.

Writes dataset.yaml, skin_mesh.npz, bags/ and indenters/ in the layout of measured data, one
trajectory for each indenter and tilt, and prints for each frame how far our own gel, pressed the
same way, is off. Trajectories that OUT already holds, solved to their end with the same constants,
are left as they are, so an interrupted run resumes where it stopped; others are solved anew. Needs
CalculiX: apt-get install calculix-ccx

example:
  dotsim_ros reference --sensor densetact2 --indenter sphere_4mm --out out/reference
  dotsim_ros reference --indenter cone torus --tilt-deg 0 20 40 --shear-mm 0.5 --out out/reference
  dotsim_ros reference --indenter cone --axisymmetric --depth-mm 2 --out out/reference
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any


def _positive(text: str) -> float:
    value = float(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def _tilt(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 40.0:
        raise argparse.ArgumentTypeError(f"{text} is not an angle from 0 to 40 degrees")
    return value


def _count(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 100:
        raise argparse.ArgumentTypeError(f"{text} is not a number from 1 to 100")
    return value


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--sensor", default="densetact2", help="name or YAML file of the sensor (densetact2)")
    add(
        "--indenter",
        nargs="+",
        default=["sphere_4mm"],
        help="names or definitions (sphere_4mm)",
    )
    add("--out", type=Path, default=Path("out/reference"), help="the data set (out/reference)")
    add(
        "--depth-mm",
        type=_positive,
        default=1.0,
        help="depth of the tip below the skin at rest (1)",
    )
    add("--frames", type=_count, default=4, help="equal moves to that depth, one a frame (4)")
    add(
        "--tilt-deg",
        type=_tilt,
        nargs="+",
        default=[0.0],
        help="angles of the place from the apex (0)",
    )
    add("--azimuth-deg", type=float, default=0.0, help="azimuth of the place, from +x (0)")
    add("--shear-mm", type=float, default=0.0, help="drag along the indenter's +x at the end (0)")
    add("--friction", type=float, help="coefficient of friction (the sensor's)")
    add("--spacing-mm", type=_positive, help="element size at the press (1; 0.25 axisymmetric)")
    add("--axisymmetric", action="store_true", help="solve in two dimensions: at the apex alone")
    add("--threads", type=_count, default=1, help="threads of CalculiX (1)")
    add("--time-limit-s", type=_positive, help="time limit of each trajectory (none)")
    add("--keep", type=Path, help="folder for CalculiX's own files")
    add("--json", type=Path, help="write the table to this file")
    add("--seed", type=int, default=0, help="accepted; nothing here is random")


def run(arguments: argparse.Namespace) -> int:
    """Solve, write and compare; 1 where a press did not come to its end."""
    from dataclasses import replace

    from dotsim_ros.files import write_json
    from dotsim_ros.gel.make import skin_of
    from dotsim_ros.geometry.indenter import load_indenter
    from dotsim_ros.measured.data_set_writer import DataSetWriter
    from dotsim_ros.provenance import provenance
    from dotsim_ros.reference.axisymmetric import AxisymmetricSettings
    from dotsim_ros.reference.comparison import compare
    from dotsim_ros.reference.data_set import FINE_STEP_M
    from dotsim_ros.reference.press import ReferencePress, ReferenceSettings
    from dotsim_ros.reference.results import solved_press
    from dotsim_ros.reference.run import CalculixError, calculix_version
    from dotsim_ros.specification import load_sensor

    version = calculix_version()
    specification = load_sensor(arguments.sensor)
    if arguments.friction is not None:
        contact = replace(specification.contact, friction_coefficient=arguments.friction)
        specification = replace(specification, contact=contact)
    skin = skin_of(specification.gel)
    data_set = DataSetWriter(arguments.out, skin, indenter_step_m=FINE_STEP_M)
    settings: ReferenceSettings | AxisymmetricSettings = (
        AxisymmetricSettings() if arguments.axisymmetric else ReferenceSettings()
    )
    if arguments.spacing_mm is not None:
        settings = replace(settings, spacing_m=1e-3 * arguments.spacing_mm)
    rows: list[dict[str, Any]] = []
    failures = []
    print(_HEADER)
    for source in arguments.indenter:
        indenter = load_indenter(source)
        for tilt_deg in arguments.tilt_deg:
            press = ReferencePress(
                specification,
                indenter,
                depth_m=1e-3 * arguments.depth_mm,
                frame_count=arguments.frames,
                tilt_deg=tilt_deg,
                azimuth_deg=arguments.azimuth_deg,
                shear_m=1e-3 * arguments.shear_mm,
                settings=settings,
            )
            notes = press.notes() | {"calculix": version}
            there = data_set.notes(press.name)
            if there is not None and "calculix" not in there:
                raise ValueError(
                    f"{arguments.out} holds a trajectory {press.name} that was not solved here, "
                    "expected a folder of solved presses; name another with --out"
                )
            if data_set.holds(press.name, notes):
                print(f"{press.name}: there already")
                continue
            try:
                trajectory, solution = solved_press(
                    press,
                    skin,
                    thread_count=arguments.threads,
                    keep=None if arguments.keep is None else arguments.keep / press.name,
                    time_limit_s=arguments.time_limit_s,
                )
            except CalculixError as error:
                failures.append(f"{press.name}: {error}")
                print(failures[-1])
                continue
            data_set.add(trajectory, indenter, notes, failure=solution.failure)
            for row in compare(specification, skin, indenter, trajectory):
                figures = {
                    "trajectory": press.name,
                    "iterations": solution.steps[row.frame - 1].iterations,
                    **row.figures(),
                }
                rows.append(figures)
                print(_ROW.format(**figures), flush=True)
            if solution.failure:
                failures.append(f"{press.name}: {solution.failure}")
                print(failures[-1])
    if arguments.json is not None:
        origin = provenance() | {"calculix": version}
        write_json(arguments.json, {"origin": origin, "frames": rows, "failures": failures})
    return 1 if failures else 0


_HEADER = (
    "frame  normal N  tangential N  normal error  tangential error  skin RMS mm  max mm  "
    "contact RMS mm  iterations  trajectory"
)
_ROW = (
    "{frame:5d}  {normal_n:8.4f}  {tangential_n:12.4f}  {normal_error:+12.1%}  "
    "{tangential_error:16.1%}  {skin_rms_mm:11.3f}  {skin_max_mm:6.3f}  {contact_rms_mm:14.3f}  "
    "{iterations:10d}  {trajectory}"
)
