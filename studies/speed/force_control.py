# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""In how many frames an indenter that follows a force is there: `control: force` of `tactile_sim`.

For each sensor and indenter, in the middle of the skin, solved exactly: the frames until a step of
force stays within 5 % and within 1 %, and the largest force on the way over the one asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.tactile_sim.force_drive import ForceDrive
from dotsim_ros.sensor import TactileSensor

INDENTERS = ("sphere_4mm", "flat_punch", "cone", "box_edge")
SENSORS = {"densetact2": (0.3, 1.0), "gelsight_mini": (1.0, 5.0)}
"""The forces, in newtons, between which the steps go."""
FRAME_COUNT = 8


def followed(sensor: TactileSensor, steps_n: tuple[float, ...]) -> list[dict[str, Any]]:
    """Return how an indenter follows steps of force, one after the other."""
    above = Pose(sensor.skin.apex_m + np.array([0.0, 0.0, 0.003]))
    asked_n = steps_n[0]
    drive = ForceDrive(sensor, lambda _: asked_n)
    rows = []
    for asked_n in steps_n:
        shares = []
        for _ in range(FRAME_COUNT):
            pose = drive.pose(above)
            force_n = sensor.press(pose).wrench.force_n
            drive.answer(pose, force_n)
            shares.append(float(force_n[2]) / asked_n)
        error = np.abs(np.array(shares) - 1.0)
        rows.append(
            {
                "asked_n": asked_n,
                "frames_to_5_percent": _frames_until(error <= 0.05),
                "frames_to_1_percent": _frames_until(error <= 0.01),
                "largest_share": round(max(shares), 3),
            }
        )
    return rows


def _frames_until(is_near: np.ndarray) -> int | None:
    """Return after which frame all are near; None where the last one is not."""
    far = np.flatnonzero(~is_near)
    count = 1 if len(far) == 0 else int(far[-1]) + 2
    return count if count <= len(is_near) else None


def force_control(*, indenters: tuple[str, ...] = INDENTERS) -> dict[str, Any]:
    """In how many frames an indenter that follows a force is there.

    Args:
        indenters: names or files.
    """
    rows = []
    for name, (low_n, high_n) in SENSORS.items():
        sensor = TactileSensor.load(name)
        for indenter in indenters:
            sensor.set_indenter(load_indenter(indenter))
            rows += [
                {"sensor": name, "indenter": indenter, **row}
                for row in followed(sensor, (low_n, high_n, low_n))
            ]
    return {"rows": rows}
