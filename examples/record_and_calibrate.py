# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Record presses on a unit whose constants nobody knows, and calibrate a twin on them.

Writes the data set measured/, the sensor calibrated.yaml and the report calibrated_report/.

python examples/record_and_calibrate.py [FOLDER]
"""

import sys
from dataclasses import replace
from pathlib import Path

import dotsim_ros
from dotsim_ros import Pose, TactileSensor

TWIN = dotsim_ros.load_sensor(Path(__file__).with_name("coarse_sensor.yaml"))
# Depth, and how far aside: a press, then a slide, from which friction is identified.
WAY_M = ((0.0008, 0.0), (0.0016, 0.0), (0.0016, 0.0008), (0.0016, 0.0016))


def main(folder: Path) -> None:
    # A softer and more slippery simulated unit stands in for the real one.
    unit = replace(TWIN, material=replace(TWIN.material, youngs_modulus_pa=2.2e5))
    unit = replace(unit, contact=replace(unit.contact, friction_coefficient=0.3))
    sensor = TactileSensor.load(unit)
    data = dotsim_ros.DataSetWriter(folder / "measured", sensor.skin)
    for number, x_m in enumerate((0.0, 0.003)):
        sensor.reset()
        frames = [sensor.step(Pose.above_apex(depth, x_m=x_m + aside)) for depth, aside in WAY_M]
        press = dotsim_ros.trajectory_of_frames(frames, name=f"press_{number}")
        data.add(press, sensor.indenter)
    out, fit = folder / "calibrated.yaml", ("E", "friction")
    found = dotsim_ros.calibrate(data.directory, sensor=TWIN, out=out, fit=fit, solves=8)
    print(f"E {found.values.youngs_modulus_pa:.3g} Pa, friction {found.values.friction:.3f}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/record_and_calibrate"))
