# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presses that finite elements (CalculiX) solve, as a data set, and our own gel against them.

OUT has dataset.yaml, skin_mesh.npz, bags/ and indenters/ in the layout of measured data, one
trajectory for each indenter and tilt. Trajectories that it already holds, solved to their end with
the same constants, are left as they are, so an interrupted run resumes where it stopped; others are
solved again.

    python -m studies reference_presses --indenters cone torus --tilts-deg 0 20 40 --shear-mm 0.5
    python -m studies reference_presses --indenters cone --axisymmetric --depth-mm 2
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.specification import load_sensor
from studies.reference.axisymmetric import AxisymmetricSettings
from studies.reference.comparison import compare, implicit_step
from studies.reference.press import ReferencePress, ReferenceSettings
from studies.reference.results import FINE_STEP_M, solved_press
from studies.reference.run import CalculixError, calculix_version


def reference_presses(
    *,
    sensor: str = "densetact2",
    indenters: tuple[str, ...] = ("sphere_4mm",),
    out: Path = Path("out/reference"),
    depth_mm: float = 1.0,
    frames: int = 4,
    tilts_deg: tuple[float, ...] = (0.0,),
    azimuth_deg: float = 0.0,
    shear_mm: float = 0.0,
    friction: float | None = None,
    spacing_mm: float | None = None,
    axisymmetric: bool = False,
    threads: int = 1,
    time_limit_s: float | None = None,
    keep: Path | None = None,
) -> dict[str, Any]:
    """Solve presses with CalculiX, write them as a data set and compare our own gel.

    Args:
        sensor: name or file of the sensor.
        indenters: names or definitions.
        out: folder of the data set.
        depth_mm: depth of the tip below the skin at rest.
        frames: equal moves to that depth, one a frame.
        tilts_deg: angles of the place from the apex, 0 to 40.
        azimuth_deg: azimuth of the place, from +x.
        shear_mm: drag along the indenter's +x at the end.
        friction: coefficient of friction (the sensor's).
        spacing_mm: element size at the press (1; 0.25 axisymmetric).
        axisymmetric: solve in two dimensions, at the apex alone.
        threads: of CalculiX.
        time_limit_s: of each trajectory (none).
        keep: folder for CalculiX's own files.

    Raises:
        CalculixMissingError: CalculiX is not installed.
        ValueError: a value is out of range, or the folder holds other data.
    """
    numbers = {
        "depth_mm": depth_mm,
        "frames": frames,
        "spacing_mm": spacing_mm,
        "threads": threads,
        "time_limit_s": time_limit_s,
    }
    for name, value in numbers.items():
        if value is not None and not 0.0 < value < math.inf:
            raise ValueError(f"{name} is {value:g}, expected a positive number")
    if wrong := [tilt for tilt in tilts_deg if not 0.0 <= tilt <= 40.0]:
        raise ValueError(f"tilts_deg has {wrong[0]:g}, expected 0 to 40")
    version = calculix_version()
    specification = load_sensor(sensor)
    if friction is not None:
        contact = replace(specification.contact, friction_coefficient=friction)
        specification = replace(specification, contact=contact)
    skin = skin_of(specification.gel)
    data_set = DataSetWriter(out, skin, indenter_step_m=FINE_STEP_M)
    settings: ReferenceSettings | AxisymmetricSettings = (
        AxisymmetricSettings() if axisymmetric else ReferenceSettings()
    )
    if spacing_mm is not None:
        settings = replace(settings, spacing_m=1e-3 * spacing_mm)
    rows: list[dict[str, Any]] = []
    failed: dict[str, str] = {}
    for source in indenters:
        indenter = load_indenter(source)
        for tilt_deg in tilts_deg:
            press = ReferencePress(
                specification,
                indenter,
                depth_m=1e-3 * depth_mm,
                frame_count=frames,
                tilt_deg=tilt_deg,
                azimuth_deg=azimuth_deg,
                shear_m=1e-3 * shear_mm,
                settings=settings,
            )
            notes = press.notes() | {"calculix": version}
            there = data_set.notes(press.name)
            if there is not None and "calculix" not in there:
                raise ValueError(
                    f"{out} holds a trajectory {press.name} that was not solved here, expected a "
                    "folder of solved presses; name another with --out"
                )
            if data_set.holds(press.name, notes):
                print(f"{press.name}: there already")
                continue
            try:
                trajectory, solution = solved_press(
                    press,
                    skin,
                    thread_count=threads,
                    keep=None if keep is None else keep / press.name,
                    time_limit_s=time_limit_s,
                )
            except CalculixError as error:
                failed[press.name] = str(error)
                print(f"{press.name}: {error}")
                continue
            data_set.add(trajectory, indenter, notes, failure=solution.failure)
            step = implicit_step(specification, skin, indenter)
            for row in compare(step, skin, indenter, trajectory):
                iterations = solution.steps[row["frame"] - 1].iterations
                rows.append({"trajectory": press.name, "iterations": iterations, **row})
            if solution.failure:
                failed[press.name] = solution.failure
            print(f"{press.name}: {solution.failure or 'solved'}")
    return {"calculix": version, "frames": rows, "failed": failed}
