# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Solve several worlds of one gel together: a ball presses each in another place.

python examples/batch.py [WORLDS]
"""

import sys

import numpy as np

from dotsim_ros import Pose, load_indenter, load_sensor, make_gel_batch


def main(count: int) -> None:
    gel = make_gel_batch(
        load_sensor("densetact2"),
        indenter=load_indenter("sphere_4mm"),
        environment_count=count,
    )
    place_m = np.linspace(0.0, 0.004, count)
    for depth_m in (0.0, 0.0005, 0.001):
        poses = [Pose.above_apex(depth_m, x_m=x).on(gel.skin.apex_m) for x in place_m]
        worlds = gel.step(poses, 0.04)
    for x, world in zip(place_m, worlds, strict=True):
        moved = np.linalg.norm(world.skin_position_m - gel.skin.rest_position_m, axis=1)
        print(f"{1e3 * x:.1f} mm aside: {world.wrench.force_n[2]:.3f} N, ", end="")
        print(f"the skin moves by up to {1e3 * moved.max():.2f} mm")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
