# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Press many sensors at once, each with its own friction, and read tensors for a learner.

python examples/many_sensors.py [COUNT]
"""

import sys

import torch

from dotsim_ros import TactileArray


def main(count: int) -> None:
    friction = torch.linspace(0.1, 0.8, count)
    array = TactileArray("densetact2", count, "sphere_4mm", friction=friction, image_size=(64, 64))
    rest = array.step(*poses(array, count, depth_m=-0.001))
    array.step(*poses(array, count, depth_m=0.001))
    frame = array.step(*poses(array, count, depth_m=0.001, aside_m=0.0005))
    # A network's input: how far the skin came nearer, zero where no skin is seen.
    indented_m = (rest.depth_m - frame.depth_m).nan_to_num()
    print(f"input of shape {tuple(indented_m.shape)}")
    for number in range(count):
        along_n, _, normal_n = frame.force_n[number].tolist()
        print(
            f"friction {friction[number]:.2f}: {normal_n:.3f} N normal, {-along_n:.3f} N aside, "
            f"indented by {1e3 * indented_m[number].max():.2f} mm"
        )


def poses(
    array: TactileArray, count: int, depth_m: float, aside_m: float = 0.0
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return positions (B, 3) above the middle of the gel and quaternions (B, 4)."""
    height_m = float(array.rest_position_m[:, 2].max()) - depth_m
    position_m = torch.tensor([aside_m, 0.0, height_m]).repeat(count, 1)
    return position_m, torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(count, 1)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 4)
