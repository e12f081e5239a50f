# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""In how many frames an indenter that follows a force is there: `control: force` of `tactile_sim`.

    python benchmarks/force_control.py

For each sensor and indenter, in the middle of the skin, solved exactly: the frames until a step of
force stays within 5 % and within 1 %, and the largest force on the way over the one asked for.
"""

from __future__ import annotations

import numpy as np

from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.tactile_sim.force_drive import ForceDrive
from dotsim_ros.sensor import TactileSensor

INDENTERS = ("sphere_4mm", "flat_punch", "cone", "box_edge")
SENSORS = {"densetact2": (0.3, 1.0), "gelsight_mini": (1.0, 5.0)}
"""The forces, in newtons, between which the steps go."""
FRAME_COUNT = 8


def step_of(sensor: TactileSensor, drive: ForceDrive, above: Pose, asked_n: float) -> str:
    """Follow one step of force and return how, in words."""
    forces_n = []
    for _ in range(FRAME_COUNT):
        pose = drive.pose(above)
        force_n = sensor.press(pose).wrench.force_n
        drive.answer(pose, force_n)
        forces_n.append(float(force_n[2]))
    share = np.array(forces_n) / asked_n
    counts = [_frames_until(np.abs(share - 1.0) <= limit) for limit in (0.05, 0.01)]
    return f"{asked_n} N: {counts[0]}, {counts[1]}, {share.max():.2f}"


def _frames_until(is_near: np.ndarray) -> str:
    """Return after which frame all are near."""
    far = np.flatnonzero(~is_near)
    count = 1 if len(far) == 0 else int(far[-1]) + 2
    return str(count) if count <= len(is_near) else f"more than {len(is_near)}"


def main() -> None:
    """Print a line for each sensor and indenter."""
    print("sensor, indenter: step: frames to 5 %, to 1 %, largest share of the force")
    for name, (low_n, high_n) in SENSORS.items():
        sensor = TactileSensor.load(name)
        above = Pose(sensor.skin.apex_m + np.array([0.0, 0.0, 0.003]))
        for indenter in INDENTERS:
            sensor.set_indenter(load_indenter(indenter))
            asked = [low_n]
            drive = ForceDrive(sensor, lambda _, asked=asked: asked[0])
            found = []
            for asked[0] in (low_n, high_n, low_n):
                found.append(step_of(sensor, drive, above, asked[0]))
            print(f"{name}, {indenter}: {'; '.join(found)}", flush=True)


if __name__ == "__main__":
    main()
