# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Press, slide sideways and let go; plot the force over time to slide.png.

python examples/slide_force.py [FOLDER]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from dotsim_ros import Pose, TactileSensor


def main(folder: Path) -> None:
    sensor = TactileSensor.load("densetact2", indenter="sphere_4mm")
    depth_m = np.concatenate([np.linspace(0.0, 0.0015, 10), np.full(20, 0.0015), [0.0]])
    x_m = np.concatenate([np.zeros(10), np.linspace(0.0, 0.003, 20), [0.003]])
    frames = [sensor.step(Pose.above_apex(d, x_m=x)) for d, x in zip(depth_m, x_m, strict=True)]
    time_s = [frame.time_s for frame in frames]
    force_n = np.stack([frame.wrench.force_n for frame in frames])
    plt.figure(figsize=(6.0, 3.5), layout="constrained")
    plt.plot(time_s, force_n, label=["x, along the slide", "y", "z, out of the dome"])
    plt.xlabel("time, s")
    plt.ylabel("force on the ball, N")
    plt.legend()
    folder.mkdir(parents=True, exist_ok=True)
    plt.savefig(folder / "slide.png")
    print(f"friction holds back with up to {-force_n[:, 0].min():.2f} N")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/slide_force"))
