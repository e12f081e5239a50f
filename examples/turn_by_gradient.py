# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Find the push that turns a box by 10 degrees, by the derivatives of the gel's wrench.

You learn how to plan with `dotsim_ros.differentiable.press`: a box hangs on a hinge with a spring,
and a pad presses its face and twists. The derivatives of force and torque by the poses say how much
deeper to press and farther to twist, until the pad presses with 2 N and holds the box at its angle.

python examples/turn_by_gradient.py [STEPS]
"""

import math
import sys
from dataclasses import replace

import numpy as np
import torch

from dotsim_ros import Pose, load_indenter, load_sensor
from dotsim_ros.differentiable import press

ANGLE_RAD = math.radians(10.0)
SPRING_NM_RAD = 0.008
FORCE_N = 2.0
SHARES = (0.0, 1.0)
"""Of the twist, in the frames after the one in the air."""


def main(steps: int) -> None:
    sensor = load_sensor("flat_pad")
    # An unrefined gel is solved in a fraction of the time.
    sensor = replace(sensor, solver=replace(sensor.solver, refined=False))
    box = load_indenter("box_face")
    top_m = sensor.gel.pad_size_m[2]
    depth_m, twist_rad = 0.3e-3, math.radians(2.0)
    wanted = np.array([FORCE_N, SPRING_NM_RAD * ANGLE_RAD])
    for step in range(steps):
        poses = [Pose(np.array([0.0, 0.0, top_m + 1e-3]))]
        for share in SHARES:
            half = 0.5 * share * twist_rad
            turn = np.array([0.0, 0.0, math.sin(half), math.cos(half)])
            poses.append(Pose(np.array([0.0, 0.0, top_m - depth_m]), turn))
        moved = torch.zeros(len(poses), 6, dtype=torch.float64, requires_grad=True)
        touch = press(sensor, box, poses, pose_twist=moved)
        # The gel pushes the box away, and resists its turn.
        felt = torch.stack([touch.force_n[-1, 2], -touch.torque_nm[-1, 2]])
        rows = [torch.autograd.grad(one, moved, retain_graph=True)[0].numpy() for one in felt]
        by_depth = [-row[1:, 2].sum() for row in rows]
        by_twist = [row[1:, 5] @ SHARES for row in rows]
        off = felt.detach().numpy() - wanted
        turned_deg = math.degrees(felt[1].item() / SPRING_NM_RAD)
        print(
            f"step {step}: {1e3 * depth_m:.3f} mm deep, twisted by {math.degrees(twist_rad):.2f} "
            f"degrees on the box: {felt[0]:.3f} N, the box turns by {turned_deg:.2f} degrees",
            flush=True,
        )
        change = np.linalg.solve(np.column_stack([by_depth, by_twist]), -off)
        depth_m += float(np.clip(change[0], -0.2e-3, 0.2e-3))
        twist_rad += float(np.clip(change[1], -0.03, 0.03))
    turn_deg = math.degrees(ANGLE_RAD + twist_rad)
    print(f"push: {1e3 * depth_m:.3f} mm deep, and turn the pad by {turn_deg:.2f} degrees")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
