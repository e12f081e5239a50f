# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Press the sensor with a ball, print what it feels, and save what its camera sees.

Writes press.png, the image, its change and the distance to the skin, and press.npz, all arrays of
the frame.

python examples/press_and_save.py [FOLDER]
"""

import sys
from pathlib import Path

import numpy as np

from dotsim_ros import Pose, TactileSensor


def main(folder: Path) -> None:
    sensor = TactileSensor.load("densetact2", indenter="sphere_4mm")
    frame = sensor.step(Pose.above_apex(depth_m=0.002))
    print(frame)
    print(f"nearest skin that the camera sees: {1e3 * np.nanmin(frame.depth_m):.2f} mm away")
    frame.save(folder / "press.png")
    frame.save(folder / "press.npz")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/press_and_save"))
