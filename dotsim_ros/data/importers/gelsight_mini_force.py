# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The force of a GelSight Mini under a steel sphere (feats-ai/feats, arXiv 2411.03315, MIT).

`force_depth.csv` holds the normal force at some depths of one press on the middle of the pad. Not
recorded: times, the pose across the pad, how depth was zeroed, what holds the sensor, repeats.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from dotsim_ros.data.data_set import DataSet
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.importers.force_depth import (
    ForceDepth,
    check_stiffness,
    check_within,
    read_force_table,
    upright_press,
)
from dotsim_ros.data.trajectory import Trajectory
from dotsim_ros.geometry.indenter import Indenter, sphere
from dotsim_ros.io.arrays import FloatArray

TABLE = "force_depth.csv"
PAD_SIZE_M = (0.02075, 0.02525, 0.004)
"""Along x and y, and the thickness; its base is fixed."""
BALL_RADIUS_M = 7.5e-3
CLEARANCE_M = 0.5e-3
"""Height of the frame without contact that is put before the first depth."""
STEP_S = 1.0
"""From one frame to the next: the times were not recorded."""


def read_gelsight_mini_force(directory: str | Path) -> ForceDepth:
    """Read the press of a folder that holds force_depth.csv.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is no such table, or its numbers are those of no press on this pad.
    """
    path = Path(directory) / TABLE
    press = read_force_table(path)
    check_within(str(path), float(press.depth_m[-1]), PAD_SIZE_M[2])
    if not press.depth_m[0] > 0.0:
        raise ValueError(
            f"{path}: the first depth is {1e3 * press.depth_m[0]:g} mm, expected depths below the "
            "skin at rest, above 0"
        )
    for depth, force in zip(press.depth_m, press.force_n, strict=True):
        # Hertz, "Ueber die Beruehrung fester elastischer Koerper", 1881, nu of 1/2.
        modulus = 0.75 * 0.75 * force / np.sqrt(BALL_RADIUS_M * depth**3)
        check_stiffness(f"{path}, {1e3 * depth:g} mm", float(modulus))
    return press


def ball() -> Indenter:
    """Return the sphere."""
    return replace(sphere(BALL_RADIUS_M), name="sphere_7_5mm")


def trajectory_of(depth_m: FloatArray, force_n: FloatArray, name: str) -> Trajectory:
    """Return a press on the middle of the pad, by depths (N,) and forces (N,) along z, behind a
    frame without contact."""
    heights = PAD_SIZE_M[2] - np.array([-CLEARANCE_M, *depth_m])
    count = len(heights)
    stamp_ns = np.round(1e9 * STEP_S * np.arange(1, count + 1)).astype(np.int64)
    return upright_press(stamp_ns, heights, np.concatenate([[0.0], force_n]), name)


def import_gelsight_mini_force(source: Path, out: Path) -> DataSet:
    """Write the press as a data set; the base frame lies in the middle of the pad's base.

    Raises:
        FileExistsError, FileNotFoundError, ValueError: as `read_gelsight_mini_force` and
            `write_data_set`.
    """
    press = read_gelsight_mini_force(source)
    made = trajectory_of(press.depth_m, press.force_n, "press_sphere_7_5mm_0")
    return write_data_set(out, [(made, ball())])
