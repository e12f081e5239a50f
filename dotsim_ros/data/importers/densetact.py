# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real presses on two DenseTact gels (armlabstanford/tensor-touch, MIT): poses alone.

`presses.npz` is read by `shipped_presses`, which says what is known of the stage. Neither force nor
times nor the indenter's shape were recorded: a ball of 4 mm radius is consistent with the poses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from dotsim_ros.data.data_set import DataSet
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.shipped_presses import FIRST_CONTACT_RADIUS_M, ShippedPress, read_presses
from dotsim_ros.data.trajectory import PoseChannel, Trajectory
from dotsim_ros.geometry.indenter import Indenter, sphere

PRESSES = "presses.npz"
BALL_RADIUS_M = 4.0e-3
STEP_S = 0.1
"""From one of the stage's steps of 0.1 mm to the next: the times were not recorded."""


def _trajectories(
    presses: tuple[ShippedPress, ...],
) -> Iterator[tuple[Trajectory, Indenter]]:
    tip = replace(sphere(BALL_RADIUS_M), name="sphere_4mm")
    for press in presses:
        poses = press.poses(
            outer_radius_m=FIRST_CONTACT_RADIUS_M - BALL_RADIUS_M, indenter_radius_m=BALL_RADIUS_M
        )
        stamp_ns = np.round(1e9 * STEP_S * np.arange(1, len(poses) + 1)).astype(np.int64)
        pose = PoseChannel.of(stamp_ns, poses)
        yield Trajectory(pose=pose, name=f"{press.gel}_{press.index}"), tip


def import_densetact(source: Path, out: Path) -> DataSet:
    """Write the presses as a data set, in the base frame of the real gel of 16.1 mm radius.

    Raises:
        FileExistsError, FileNotFoundError, ValueError: as `read_presses` and `write_data_set`.
    """
    return write_data_set(out, _trajectories(read_presses(Path(source) / PRESSES)))
