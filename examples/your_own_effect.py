# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hide an effect of your own, examples/effects/crosstalk.py, in recorded presses, and find it.

python examples/your_own_effect.py [FOLDER]   writes FOLDER/measured and FOLDER/report
"""

import sys
from dataclasses import replace
from pathlib import Path

import dotsim_ros
from dotsim_ros import Frame, Pose, TactileSensor, Wrench, find_gap

TWIN = dotsim_ros.load_sensor(Path(__file__).with_name("coarse_sensor.yaml"))
EFFECTS = [Path(__file__).with_name("effects")]


def with_crosstalk(frame: Frame) -> Frame:
    """Return a frame whose gauge reads 0.3 of the force along z on its x axis, too."""
    force_n = frame.wrench.force_n.copy()
    force_n[0] += 0.3 * force_n[2]
    return replace(frame, wrench=Wrench(force_n, frame.wrench.torque_nm))


def main(folder: Path) -> None:
    sensor = TactileSensor.load(TWIN)
    data = dotsim_ros.DataSetWriter(folder / "measured", sensor.skin)
    for x_m in (0.0, 0.004, -0.004):
        sensor.reset()
        way = [Pose.above_apex(depth, x_m=x_m) for depth in (0.0, 0.0006, 0.0012, 0.0018, 0.0006)]
        frames = [with_crosstalk(sensor.step(pose)) for pose in way]
        press = dotsim_ros.trajectory_of_frames(frames, name=f"at_{1e3 * x_m:.0f}_mm")
        data.add(press, sensor.indenter)
    names, out = ["crosstalk", "force_drift"], folder / "report"
    found = find_gap(data.directory, sensor=TWIN, out=out, effects=EFFECTS, candidates=names)
    print(found.sentence)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/your_own_effect"))
